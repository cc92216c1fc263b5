# SPDX-License-Identifier: Apache-2.0
"""What people see: a page of blocks for each result, shown as text, HTML and PNG; one kind of plot."""
