# SPDX-License-Identifier: Apache-2.0
"""From "something unknown is missing" to a drafted law in a file."""
