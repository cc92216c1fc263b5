# SPDX-License-Identifier: Apache-2.0
"""The commands of `smallwheel`, each a thin shell over a function of the library."""
