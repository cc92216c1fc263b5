# SPDX-License-Identifier: Apache-2.0
"""Steps that make the environment: virtual environment, wheels, patched CMake files, messages.

``.venv`` becomes a complete ROS prefix with this package in it. ``.venv/smallwheel.json`` says
what it was made from, and is written only when a step is complete: an environment that was
interrupted half-way is made anew, never believed.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from environment_checks import ROOT, CannotBuild, check_machine, interpreter, last_line
from environment_uv import uv_variables

VENV = ROOT / ".venv"
VENV_PYTHON = VENV / "bin" / "python"
STATE = VENV / "smallwheel.json"
BUILD = VENV / "build"
LOG = VENV / "make.log"
LOCK = ROOT / "tools" / "environment.lock"
# What `make lint` and `make docs` install besides.
MORE = {name: ROOT / "tools" / f"{name}.lock" for name in ("lint", "docs")}
UV = ROOT / "tools" / "uv.txt"
# A quarter of all code, which neither this package nor its tests import, or hardly any of it.
NOT_COMPILED = r"/(tests?|pip|setuptools|fontTools|distributed|mpmath|docutils)/"
# Change it when the steps below change so that environments made before must be made anew.
RECIPE = 1

# Another ROS installation, or another environment, must not leak into this one.
FOREIGN_VARIABLES = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "PYTHONHOME",
    "PYTHONPATH",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)


def say(text: str) -> None:
    """Print one line of progress at once."""
    print(text, flush=True)


def digest(*parts: str | bytes) -> str:
    """Return a hash over the parts."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(b"%d:" % len(data) + data)
    return total.hexdigest()


def environment_key() -> str:
    """Return what the wheels in the environment depend on."""
    return digest(
        str(RECIPE), LOCK.read_bytes(), str(VENV), str(interpreter()), platform.python_version()
    )


def key_of_more(name: str) -> str:
    """Return what the packages of ``make lint`` or ``make docs`` depend on."""
    return digest(environment_key(), MORE[name].read_bytes())


def installation_key() -> str:
    """Return what the installed package depends on: contents for CMake, names for the rest.

    Python and configuration files are installed as links, so their contents do not count.
    """
    built = [ROOT / "CMakeLists.txt", ROOT / "package.xml"]
    built += sorted([*(ROOT / "msg").glob("*.msg"), *(ROOT / "scripts").glob("*.in")])
    parts: list[str | bytes] = [environment_key()]
    for path in built:
        parts += [str(path.relative_to(ROOT)), path.read_bytes()]
    for folder in ("smallwheel_ros", "config", "launch"):
        parts += sorted(
            str(path.relative_to(ROOT))
            for path in (ROOT / folder).rglob("*")
            if "__pycache__" not in path.parts and path.is_file()
        )
    return digest(*parts)


def read_state() -> dict[str, str]:
    """Return what ``.venv`` was made from; empty if it does not say."""
    try:
        state = json.loads(STATE.read_text())
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) else {}


def write_state(**state: str) -> None:
    """Replace the state file in one step."""
    state = {"note": "made by `make`, safe to delete with its folder", **state}
    new = STATE.with_suffix(".new")
    new.write_text(json.dumps(state, indent=1))
    new.replace(STATE)


def run(step: str, command: list[str | Path], advice: str, **environment: str) -> None:
    """Run a command with its output in the log file.

    Raises
    ------
    CannotBuild
        If it fails: with its last lines, and the advice.
    """
    variables = {k: v for k, v in os.environ.items() if k not in FOREIGN_VARIABLES}
    with LOG.open("ab") as log:
        log.write(f"\n$ {shlex.join(map(str, command))}\n".encode())
        log.flush()
        start = log.tell()
        result = subprocess.run(
            command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=variables | environment
        )
    if result.returncode:
        with LOG.open("rb") as log:
            log.seek(start)
            tail = log.read().decode(errors="replace").splitlines()[-15:]
        raise CannotBuild(
            f"{step} failed. Its last lines (all of them are in {LOG}):\n  "
            + "\n  ".join(tail)
            + f"\n{advice}"
        )


def empty_venv() -> None:
    """Make ``.venv`` an empty folder that is marked as ours and unfinished.

    Raises
    ------
    CannotBuild
        If a ``.venv`` is there that `make` has not made.
    """
    if VENV.is_symlink() or (VENV.exists() and any(VENV.iterdir()) and not read_state()):
        raise CannotBuild(
            f"{VENV} is there but was not made by `make`: move it away, or delete it, and run make"
            " again"
        )
    VENV.mkdir(exist_ok=True)
    # Marked before anything else happens, so that an interrupted run is recognised as ours.
    write_state(python=str(interpreter()))
    for path in VENV.iterdir():
        if path == STATE:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def patch_cmake_files() -> None:
    """Put this machine's paths into the CMake files of the wheels.

    They carry the include folders of the machine that built them.

    Raises
    ------
    CannotBuild
        If nothing is left to replace, or something else of that machine remains.
    """
    numpy = subprocess.run(
        [VENV_PYTHON, "-c", "import numpy; print(numpy.get_include())"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    major, minor = sys.version_info[:2]
    built_in = f"/opt/python/cp{major}{minor}-cp{major}{minor}"
    site = f"{built_in}/lib/python{major}.{minor}/site-packages"
    replacements = {
        f"{site}/numpy/_core/include": numpy,
        f"{built_in}/include/python{major}.{minor}": sysconfig.get_paths()["include"],
    }
    for file in VENV.glob("share/*/cmake/*.cmake"):
        text = file.read_text()
        if "/opt/python/" not in text:
            continue
        for old, new in replacements.items():
            text = text.replace(old, new)
        if "/opt/python/" in text:
            raise CannotBuild(
                f"{file} names a folder of the machine that built it, in a form that"
                " tools/environment_build.py does not know: has tools/environment.lock changed?"
            )
        # Not into the file that is there: it may be a link into uv's cache.
        new = file.with_suffix(".new")
        new.write_text(text)
        new.replace(file)


def make_venv() -> None:
    """Make the virtual environment with everything in the lock file."""
    check_machine()
    empty_venv()
    say(f"[1/3] virtual environment with Python {platform.python_version()} in {VENV.name}")
    run(
        "Making the virtual environment",
        [interpreter(), "-m", "venv", VENV],
        "Does this Python come whole, and is there room on the disk?",
    )
    say(f"[2/3] ROS 2 Jazzy and {packages_in(LOCK)} packages in all; about a minute, once")
    install_packages(LOCK, "--ignore-installed")  # what uv may have left half done does not count
    compile_packages()
    patch_cmake_files()
    write_state(python=str(interpreter()), environment=environment_key())


def packages_in(lock: Path) -> int:
    """Return how many packages a lock file has."""
    return sum("==" in line for line in lock.read_text().splitlines())


def install_packages(file: Path, *of_pip: str) -> None:
    """Install a lock file's packages by uv, or by pip where uv is not to be had or fails.

    Both refuse a file whose hash the lock does not have, so it does not matter which did it. of_pip: further
    options for pip.
    """
    pip: list[str | Path] = [VENV_PYTHON, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    advice = "Is the package registry within reach, and room for 1 GB on the disk? Run make again."
    # The lock file is complete, so nothing has to be resolved.
    lock: list[str | Path] = ["--no-deps", "--require-hashes", "-r", file]
    try:
        uv, variables = find_uv(pip)
        to: list[str | Path] = ["pip", "install", "--verify-hashes", "--python", VENV_PYTHON]
        run("uv", [uv, *to, *lock], advice, **variables)
    except (CannotBuild, OSError) as problem:
        say(f"      by pip, which is slower: {first_lines(problem)}")
        run("Installing the packages", [*pip, "install", "--no-compile", *of_pip, *lock], advice)


def find_uv(pip: list[str | Path]) -> tuple[str | Path, dict[str, str]]:
    """Return uv, that of the PATH or from the registry, and the variables it is to run with.

    Raises
    ------
    CannotBuild
        If it cannot be had, or pip has a setting that uv cannot follow.
    """
    listed = subprocess.run(
        [*pip, "config", "list"], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if listed.returncode:
        raise CannotBuild(f"pip does not say its settings ({last_line(listed.stderr)})")
    variables = uv_variables(listed.stdout, os.environ)
    if isinstance(variables, str):
        raise CannotBuild(f"uv does not know pip's setting {variables}")
    there = shutil.which("uv")
    if there:
        return there, variables
    run(
        "uv's installation",
        [*pip, "install", "--no-deps", "--require-hashes", "-r", UV],
        "Left out.",
    )
    return VENV / "bin" / "uv", variables


def first_lines(problem: Exception) -> str:
    """Return what failed and the last line that it said, in one line."""
    first, *rest = str(problem).splitlines()
    said = [line.strip() for line in rest[:-1] if line.strip()]
    return f"{first.partition('. Its last lines')[0]}" + (f" ({said[-1]})" if said else "")


def compile_packages() -> None:
    """Compile what was installed, but not its tests, nor what is hardly ever imported.

    Where PYTHONDONTWRITEBYTECODE is set, as in many containers, each command would otherwise
    compile what it imports, scipy and pandas among it, and take 7 s instead of 2 s to start.
    """
    paths = VENV / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    command = [VENV_PYTHON, "-m", "compileall", "-qq", "-j", "0", "-x", NOT_COMPILED, paths]
    # A file of another Python's syntax does not compile, and is not needed either.
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)


def install_more(name: str) -> None:
    """Install what ``make lint`` or ``make docs`` needs, unless it is there."""
    state, key = read_state(), key_of_more(name)
    if state.get(name) == key:
        return
    say(f"{packages_in(MORE[name])} packages for make {name}, once")
    install_packages(MORE[name])
    compile_packages()
    write_state(**{**state, name: key})


def remove_dangling_links() -> None:
    """Remove links to files that are gone from the checkout, so that no stale module stays."""
    package = Path(f"lib/python{sys.version_info[0]}.{sys.version_info[1]}/site-packages")
    for folder in (package / "smallwheel_ros", Path("share/smallwheel_ros")):
        for path in (VENV / folder).rglob("*"):
            if path.is_symlink() and not path.exists():
                path.unlink()
    for path in sorted((VENV / package / "smallwheel_ros").rglob("*"), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def install_package(key: str) -> None:
    """Generate the messages and install this package into the environment."""
    say("[3/3] messages and package smallwheel_ros")
    state = {name: value for name, value in read_state().items() if name != "installation"}
    write_state(**state)
    remove_dangling_links()
    cmake = VENV / "bin" / "cmake"
    prefix = {"AMENT_PREFIX_PATH": str(VENV), "CMAKE_PREFIX_PATH": str(VENV)}
    advice = "If messages or CMakeLists.txt were changed, the reason is above."
    configure: list[str | Path] = [cmake, "-S", ROOT, "-B", BUILD, "-G", "Ninja"]
    configure += [
        f"-DCMAKE_MAKE_PROGRAM={VENV / 'bin' / 'ninja'}",
        f"-DCMAKE_INSTALL_PREFIX={VENV}",
        f"-DPython3_EXECUTABLE={VENV_PYTHON}",
        "-DPython3_FIND_VIRTUALENV=ONLY",
        # As `colcon build --symlink-install`: an edited .py file is in force at once.
        "-DAMENT_CMAKE_SYMLINK_INSTALL=ON",
        "-DBUILD_TESTING=OFF",
    ]
    run("Configuring the package", configure, advice, **prefix)
    run("Building the package", [cmake, "--build", BUILD, "--target", "install"], advice, **prefix)
    write_state(**state, installation=key)


@contextlib.contextmanager
def only_one() -> Iterator[None]:
    """Let one `make` at a time work on the environment."""
    with (ROOT / "tools" / "environment.lock").open() as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another make is working on .venv: waiting for it")
            fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def is_whole() -> bool:
    """Tell whether the pieces that everything needs are still there."""
    return VENV_PYTHON.exists() and (VENV / "bin" / "smallwheel").exists() and (BUILD.is_dir())


def bring_up_to_date() -> None:
    """Make what is missing of the environment, or is of another checkout or Python."""
    key = installation_key()
    if read_state().get("installation") == key and is_whole():
        return
    start = time.monotonic()
    if read_state().get("environment") != environment_key() or not VENV_PYTHON.exists():
        make_venv()
    install_package(key)
    say(f"environment ready in {time.monotonic() - start:.0f} s")


def main(more: Sequence[str]) -> None:
    """Bring the environment up to date; exit with one clear message when that fails.

    more: which of `MORE` to install, too.
    """
    try:
        with only_one():
            bring_up_to_date()
            for name in more:
                install_more(name)
    except CannotBuild as problem:
        sys.exit(f"smallwheel_ros: {problem}")
    except KeyboardInterrupt:
        sys.exit("smallwheel_ros: interrupted; run make again, it starts where it is safe")
    except OSError as problem:
        sys.exit(f"smallwheel_ros: cannot make {VENV}: {problem}")
