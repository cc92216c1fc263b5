# SPDX-License-Identifier: Apache-2.0
"""A drive as node and replay go through it: messages in, statements, events and the map out."""
