# SPDX-License-Identifier: Apache-2.0
"""`make env`: what is missing is said in one sentence, before anything is downloaded or made."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

BAD_C_COMPILER = "#!/bin/sh\necho 'ld: cannot find -lc' >&2\nexit 1\n"


@pytest.fixture
def tool(repository: Path) -> ModuleType:
    file = repository / "tools" / "environment.py"
    spec = importlib.util.spec_from_file_location("environment", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def checkout(source: Path, tmp_path: Path) -> Path:
    """What `make env` needs, in a folder without environment."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    for name in ("Makefile", "CMakeLists.txt", "package.xml"):
        shutil.copy(source / name, folder)
    for name in ("tools", "msg", "scripts"):
        shutil.copytree(source / name, folder / name)
    return folder


def make_env(checkout: Path, *options: str, **environment: str) -> tuple[int, list[str]]:
    """Run `make env`; return its exit code and the lines on standard error but make's own."""
    return make_env_saying(checkout, *options, **environment)[:2]


def make_env_saying(
    checkout: Path, *options: str, **environment: str
) -> tuple[int, list[str], str]:
    """Do the same; return standard output too."""
    outer = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")  # of the make that may have started the tests
    variables = {k: v for k, v in os.environ.items() if k not in outer}
    result = subprocess.run(
        ["make", "--no-print-directory", "env", f"PYTHON={sys.executable}", *options],
        cwd=checkout,
        env=variables | environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    lines = [line for line in result.stderr.splitlines() if not line.startswith("make: ")]
    return result.returncode, lines, result.stdout


def test_this_machine_is_fit(tool: ModuleType) -> None:
    if platform.machine() != "x86_64" or platform.system() != "Linux":
        pytest.skip("ROS from the package registry is for Linux on x86_64")
    assert tool.problem() is None


@pytest.mark.parametrize("version", [(2, 7, 18), (3, 9, 18), (3, 14, 0)])
def test_wrong_python(
    version: tuple[int, int, int], tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    assert "Python 3.10 to 3.13 is needed" in tool.problem()
    assert "make PYTHON=" in tool.problem()


def test_wrong_processor(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert "x86_64 only, found Linux on aarch64" in tool.problem()


def test_wrong_system(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    assert "found Darwin" in tool.problem()


@pytest.mark.parametrize("found", [("glibc", "2.17"), ("", "")])
def test_wrong_c_library(
    found: tuple[str, str], tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "libc_ver", lambda: found)
    assert tool.problem().startswith("glibc 2.28 or newer is needed")


def test_no_python_of_that_name(checkout: Path) -> None:
    code, lines = make_env(checkout, "PYTHON=python3.99")
    assert code != 0
    assert len(lines) == 1
    assert "no python3.99 found" in lines[0]


@pytest.mark.parametrize(("variable", "language"), [("CC", "a C "), ("CXX", "a C++ ")])
def test_no_compiler(variable: str, language: str, checkout: Path) -> None:
    code, lines = make_env(checkout, **{variable: "no-such-compiler"})
    assert code != 0
    assert len(lines) == 1
    assert f"{language}compiler is needed" in lines[0]
    assert "apt install build-essential" in lines[0]
    assert not (checkout / ".venv").exists()


def test_compiler_that_does_not_work(checkout: Path, tmp_path: Path) -> None:
    compiler = tmp_path / "bad-cc"
    compiler.write_text(BAD_C_COMPILER)
    compiler.chmod(0o755)
    code, lines = make_env(checkout, CC=str(compiler))
    assert code != 0
    assert len(lines) == 1
    assert "ld: cannot find -lc" in lines[0]
    assert not (checkout / ".venv").exists()


def test_an_environment_of_the_users_own_is_left_alone(checkout: Path) -> None:
    (checkout / ".venv").mkdir()
    (checkout / ".venv" / "precious.txt").write_text("mine")
    code, lines = make_env(checkout)
    assert code != 0
    assert len(lines) == 1
    assert "was not made by `make`" in lines[0]
    assert (checkout / ".venv" / "precious.txt").read_text() == "mine"


def test_a_path_that_rosidl_cannot_build_in(checkout: Path) -> None:
    folder = checkout.rename(checkout.with_name("Straße"))
    code, lines = make_env(folder)
    assert code != 0
    assert len(lines) == 1
    assert "plain ASCII" in lines[0]
    assert not (folder / ".venv").exists()


@pytest.mark.slow
def test_a_failed_download_leaves_nothing_that_is_believed(checkout: Path) -> None:
    """Twice the same failure: the second run must not take the half-made environment for whole."""
    for _ in range(2):
        code, lines = make_env(
            checkout, PIP_CONFIG_FILE=os.devnull, PIP_NO_INDEX="1", PIP_EXTRA_INDEX_URL=""
        )
        assert code != 0
        assert lines[0].startswith("smallwheel_ros: Installing the packages failed")
        assert "Run make again" in lines[-1]
        assert not any("Traceback" in line for line in lines)


@pytest.fixture
def uv_variables(source: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., object]:
    monkeypatch.syspath_prepend(str(source / "tools"))
    function: Callable[..., object] = importlib.import_module("environment_uv").uv_variables
    return function


def test_uv_looks_where_pip_does(uv_variables: Callable[..., object]) -> None:
    listed = (
        "global.index-url='https://a/simple'\nglobal.constraint='c.txt'\n"
        "global.extra-index-url='https://b/simple\\nhttps://c/simple'\n"
        "install.index-url='https://d/simple'\n:env:.no-index='0'\n:env:.find-links='/w'\n"
    )
    assert uv_variables(listed, {}) == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_DEFAULT_INDEX": "https://d/simple",
        "UV_INDEX": "https://b/simple https://c/simple",
        "UV_FIND_LINKS": "/w",
    }
    assert "UV_FIND_LINKS" not in uv_variables(listed, {"UV_FIND_LINKS": "/v"})  # type: ignore[operator]


def test_what_uv_cannot_follow_is_left_to_pip(uv_variables: Callable[..., object]) -> None:
    assert uv_variables("install.no-binary=':all:'\n", {}) == "no-binary"
    assert uv_variables("global.index-url=broken\n", {}) == "index-url"


@pytest.mark.slow
def test_where_uv_fails_pip_goes_on_and_it_is_said(checkout: Path, tmp_path: Path) -> None:
    """This uv writes down what it was asked, and fails; pip then fails too, of no index."""
    asked = tmp_path / "asked"
    uv = tmp_path / "bin" / "uv"
    uv.parent.mkdir()
    uv.write_text(f'#!/bin/sh\necho "$UV_NO_INDEX $@" > {asked}\necho "no such wheel"\nexit 3\n')
    uv.chmod(0o755)
    code, lines, printed = make_env_saying(
        checkout,
        PATH=f"{uv.parent}:{os.environ['PATH']}",
        PIP_CONFIG_FILE=os.devnull,
        PIP_NO_INDEX="1",
        PIP_EXTRA_INDEX_URL="",
        PIP_FIND_LINKS="",
    )
    assert code != 0
    assert asked.read_text().startswith("1 pip install")
    assert "--require-hashes" in asked.read_text()
    assert "by pip, which is slower: uv failed (no such wheel)" in printed
    assert lines[0].startswith("smallwheel_ros: Installing the packages failed")
