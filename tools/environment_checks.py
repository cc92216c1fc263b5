# SPDX-License-Identifier: Apache-2.0
"""What the environment needs of the machine, checked before anything is downloaded."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


class CannotBuild(Exception):
    """The environment cannot be made; the message says why and what to do."""


def interpreter() -> Path:
    """Return the interpreter outside any virtual environment."""
    return Path(os.path.realpath(getattr(sys, "_base_executable", sys.executable)))


def compilers() -> list[list[str]]:
    """Return the commands of the C and the C++ compiler, as CMake would choose them."""
    chosen = []
    for variable, names in (("CC", ("cc", "gcc", "clang")), ("CXX", ("c++", "g++", "clang++"))):
        asked = shlex.split(os.environ.get(variable, ""))
        command = asked or next(([name] for name in names if shutil.which(name)), [])
        if not command or not shutil.which(command[0]):
            language = "C" if variable == "CC" else "C++"
            wanted = f"{variable}={command[0]} does not exist" if command else "none was found"
            raise CannotBuild(
                f"a {language} compiler is needed to build the ROS messages ({wanted}): install"
                " one (Debian, Ubuntu: apt install build-essential; Fedora: dnf install gcc-c++)"
            )
        chosen.append(command)
    return chosen


def check_machine() -> None:
    """Find what is missing before anything is downloaded.

    Raises
    ------
    CannotBuild
        With one sentence that says what to install.
    """
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if not str(ROOT).isascii() or ";" in str(ROOT):
        raise CannotBuild(
            f"CMake and rosidl cannot build in {ROOT}: move the checkout to a path of plain ASCII"
            " letters, without semicolon"
        )
    with tempfile.TemporaryDirectory() as folder:
        programs = (("t.c", "#include <stdio.h>"), ("t.cpp", "#include <string>"))
        for command, (name, line) in zip(compilers(), programs, strict=True):
            file = Path(folder) / name
            file.write_text(line + "\nint main() { return 0; }\n")
            result = subprocess.run(
                [*command, str(file), "-o", str(file.with_suffix(""))],
                capture_output=True,
                text=True,
            )
            if result.returncode:
                raise CannotBuild(
                    f"the compiler {command[0]} cannot build a program of one line"
                    f" ({last_line(result.stderr)}): install it whole (Debian, Ubuntu: apt install"
                    " build-essential)"
                )
    if importlib.util.find_spec("ensurepip") is None or importlib.util.find_spec("venv") is None:
        raise CannotBuild(
            f"{interpreter()} cannot make virtual environments: install the module venv (Debian,"
            f" Ubuntu: apt install python{version}-venv)"
        )
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    if not header.is_file():
        raise CannotBuild(
            f"{header} is missing, which the ROS messages are built with: install Python's headers"
            f" (Debian, Ubuntu: apt install python{version}-dev; Fedora: dnf install"
            " python3-devel)"
        )


def last_line(text: str) -> str:
    """Return the last line that says something."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it gave no reason"
