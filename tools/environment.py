# SPDX-License-Identifier: Apache-2.0
"""Make the environment that `make test` and `make demo` run in, once; quick when it is there.

--lint, --docs: with the packages of `make lint`, `make docs`. --keep-python: with the Python that it has.

This file checks the Python that runs it, so its syntax must stay readable by any Python.
The work is done in environment_build.py.
"""

# ruff: noqa: UP031, RUF005

import json
import os
import platform
import sys
import sysconfig

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
STATE = os.path.join(ROOT, ".venv", "smallwheel.json")
INSTALL_ANOTHER = (
    "install one (on Ubuntu 24.04: apt install python3.12 python3.12-venv python3.12-dev) and run"
    " `make PYTHON=python3.12`"
)


def recorded_python():
    """Return the interpreter that the present environment was made with, or None."""
    try:
        with open(STATE) as stream:
            return json.load(stream)["python"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def problem():
    """Return what makes this interpreter or machine unfit, in one sentence, or None."""
    found = "%s %s, %s" % (
        platform.python_implementation(),
        platform.python_version(),
        sys.executable,
    )
    if not (3, 10) <= sys.version_info[:2] <= (3, 13):
        return "Python 3.10 to 3.13 is needed, found %s: %s" % (found, INSTALL_ANOTHER)
    if platform.python_implementation() != "CPython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
        return "CPython with its global lock is needed, found %s: %s" % (found, INSTALL_ANOTHER)
    if platform.system() != "Linux" or platform.machine() != "x86_64" or sys.maxsize < 2**32:
        return (
            "ROS 2 from the package registry exists for 64-bit Linux on x86_64 only, found %s on"
            " %s: use such a machine, or install ROS 2 Jazzy and run `colcon build`"
            % (platform.system(), platform.machine())
        )
    library, version = platform.libc_ver()
    if library != "glibc" or tuple(int(part) for part in version.split(".")[:2]) < (2, 28):
        return (
            "glibc 2.28 or newer is needed (Debian 10, Ubuntu 20.04 and later), found %s: use a"
            " newer system" % ("%s %s" % (library, version) if library else "another C library")
        )
    return None


def main():
    """Check the interpreter, then make or update the environment."""
    if "--keep-python" in sys.argv:
        # Nobody asked for a certain Python: an environment that is there keeps its own.
        python = recorded_python()
        if python and os.path.exists(python) and python != os.path.realpath(sys.executable):
            others = [option for option in sys.argv[1:] if option != "--keep-python"]
            os.execv(python, [python, os.path.abspath(__file__)] + others)
    found = problem()
    if found:
        sys.exit("smallwheel_ros: " + found)
    import environment_build

    environment_build.main([name for name in ("lint", "docs") if "--" + name in sys.argv])


if __name__ == "__main__":
    main()
