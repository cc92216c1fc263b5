# SPDX-License-Identifier: Apache-2.0
"""A simulated drive played into the node, and the node's estimates."""
