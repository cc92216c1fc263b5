# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML reports: one file that opens without a network and prints well."""
