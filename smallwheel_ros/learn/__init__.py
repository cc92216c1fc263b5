# SPDX-License-Identifier: Apache-2.0
"""From "something unknown is missing" to a law in a file."""
