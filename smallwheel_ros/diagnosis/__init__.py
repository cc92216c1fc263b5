# SPDX-License-Identifier: Apache-2.0
"""Find out which physical effect a model is missing, and what the data cannot tell."""
