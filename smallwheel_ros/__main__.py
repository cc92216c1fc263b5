# SPDX-License-Identifier: Apache-2.0
"""`python -m smallwheel_ros` is the command `smallwheel`."""

from __future__ import annotations

from smallwheel_ros.cli import main

if __name__ == "__main__":
    main(prog_name="smallwheel")
