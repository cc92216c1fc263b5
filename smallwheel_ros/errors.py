# SPDX-License-Identifier: Apache-2.0
"""The base of every error that this package raises on purpose."""

from __future__ import annotations


class SmallwheelError(Exception):
    """Something the user can mend: the message says what was found, where, and what to do.

    Each module derives one class of its own from it. The command line prints the message and
    ends with exit code 2; the node reports it in its diagnostics. Anything else that is raised
    is a defect of this package.
    """
