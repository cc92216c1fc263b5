# SPDX-License-Identifier: Apache-2.0
"""What is not to be believed, from which stamp on, and what is learnt of the sources of motion."""
