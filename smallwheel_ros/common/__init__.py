# SPDX-License-Identifier: Apache-2.0
"""What every package needs: errors, files written whole, tables, results and their views."""
