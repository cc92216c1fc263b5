# SPDX-License-Identifier: Apache-2.0
"""What every room needs: errors, files written whole, tables, results and who shows them."""
