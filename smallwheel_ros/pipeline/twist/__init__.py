# SPDX-License-Identifier: Apache-2.0
"""The vehicle's twist with a covariance that grows with slip; nothing else in the pipeline needs it."""
