# SPDX-License-Identifier: Apache-2.0
"""What is believed, put together: a row of each wheel at each instant."""
