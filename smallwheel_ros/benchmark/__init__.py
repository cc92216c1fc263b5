# SPDX-License-Identifier: Apache-2.0
"""The public measured benchmark: laws of sinkage on data that anybody may have, parts left out in turn."""
