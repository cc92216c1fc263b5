# SPDX-License-Identifier: Apache-2.0
"""The package as it is installed: versions, messages, executables, each kind of installation."""

from __future__ import annotations

import importlib.metadata
import itertools
import os
import re
import subprocess
import sys
import sysconfig
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import smallwheel_ros
from smallwheel_ros.bags.types import message_definitions, message_directory

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MESSAGES = {"WheelSinkage", "SoilEstimate", "MobilityEstimate", "VehicleMobility"}


def run(
    *command: str | Path, cwd: Path, timeout: float = 300.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a command in another folder, with the environment variables of the tests."""
    return subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def test_versions_agree(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    manifest = ElementTree.parse(repository / "package.xml").getroot()
    assert manifest.findtext("version") == smallwheel_ros.__version__
    assert f"version: {smallwheel_ros.__version__}\n" in (repository / "CITATION.cff").read_text()
    assert manifest.findtext("name") == project["name"] == "smallwheel_ros"


def test_files_state_where_the_repository_lives(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The address that stands in tools/repository.py, or none; and what would be written of one."""
    monkeypatch.syspath_prepend(str(repository / "tools"))
    from repository import PLACES, REPOSITORY, stated

    for name in PLACES:
        text = (repository / name).read_text(encoding="utf-8")
        assert stated(text, name, REPOSITORY) == text, "run `python tools/repository.py`"
        made = stated(text, name, "https://example.org/a/b")
        assert made.count("https://example.org/a/b") == 2
        assert stated(made, name, "") == stated(text, name, "")
        if name == "pyproject.toml":
            urls = tomllib.loads(made)["project"]["urls"]
            assert urls["Issues"] == "https://example.org/a/b/issues"
        if name == "package.xml":
            kinds = [url.get("type") for url in ElementTree.fromstring(made).iter("url")]
            assert kinds == ["repository", "bugtracker"]


def test_installed_metadata_has_the_version() -> None:
    pytest.importorskip("smallwheel_ros.msg", reason="the package is not installed here")
    assert importlib.metadata.version("smallwheel_ros") == smallwheel_ros.__version__


def test_code_under_test_is_that_of_the_checkout(repository: Path) -> None:
    assert Path(smallwheel_ros.__file__) == repository / "smallwheel_ros" / "__init__.py"


def names_in(text: str) -> set[str]:
    """Names of the packages that lines begin with."""
    found = (re.match(r"[A-Za-z0-9._-]+", line) for line in text.splitlines())
    return {re.sub(r"[-_.]+", "-", match[0]).lower() for match in found if match}


def pinned_in(lock: Path) -> dict[str, str]:
    """By name, the line of each package; each with its version, followed by its hashes."""
    lines = lock.read_text().splitlines()
    pinned = [line for line in lines if line and not line.startswith(("#", "    --hash=sha256:"))]
    assert not [line for line in pinned if not re.match(r"[a-z0-9-]+==[0-9].* \\$", line)]
    followed = [after for line, after in itertools.pairwise(lines) if line in pinned]
    assert all(after.startswith("    --hash=sha256:") for after in followed)
    return {line.partition("==")[0]: line for line in pinned}


def test_lock_files_pin_every_package_that_is_asked_for(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    asked = names_in("\n".join(project["dependencies"] + extras["parquet"] + extras["test"]))
    asked |= names_in((repository / "tools" / "environment.in").read_text())
    whole = pinned_in(repository / "tools" / "environment.lock")
    assert not asked - whole.keys()
    for name in ("lint", "docs"):
        more = pinned_in(repository / "tools" / f"{name}.lock")
        asked = names_in((repository / "tools" / f"{name}.in").read_text())
        assert not asked - more.keys()
        # They are installed into the environment: what is in both has one version.
        assert {package: more[package] for package in more.keys() & whole.keys()} == {
            package: whole[package] for package in more.keys() & whole.keys()
        }
        assert not asked & whole.keys()  # or it need not be there
    assert (
        names_in("\n".join(extras["cluster"]))
        <= pinned_in(repository / "tools" / "lint.lock").keys()
    )


def test_definitions_come_from_the_one_copy(repository: Path) -> None:
    assert message_directory() == repository / "msg"
    definitions = message_definitions()
    assert set(definitions) == {f"smallwheel_ros/msg/{name}" for name in MESSAGES}
    text = (repository / "msg" / "WheelSinkage.msg").read_text()
    assert definitions["smallwheel_ros/msg/WheelSinkage"] == text


def test_every_field_is_documented(repository: Path) -> None:
    """Each number says its unit in brackets, in its line or in the comment above its block."""
    for file in (repository / "msg").glob("*.msg"):
        comment = ""
        for line in file.read_text().splitlines():
            code, _, remark = line.partition("#")
            if not code.strip():
                comment = comment + remark if line.strip() else ""
                continue
            assert comment or remark, f"{file.name}: {line}"
            if code.startswith("float64"):
                assert re.search(r"\[[^]]+\]", comment + remark) or "Units:" in comment, line


class TestInstalledWithRos:
    """What CMake has installed into this environment, seen from another folder."""

    @pytest.fixture(autouse=True)
    def _needs_installation(self) -> None:
        pytest.importorskip("smallwheel_ros.msg", reason="messages are not generated here")

    def test_installed_init_is_ours(self, repository: Path, tmp_path: Path) -> None:
        result = run(
            *(sys.executable, "-c"),
            "import smallwheel_ros as s; print(s.__file__); print(s.__version__)",
            cwd=tmp_path,
        )
        assert result.returncode == 0, result.stderr
        file, version = result.stdout.splitlines()
        assert not Path(file).is_relative_to(repository / "smallwheel_ros")
        assert Path(file).read_text() == (repository / "smallwheel_ros/__init__.py").read_text()
        assert version == smallwheel_ros.__version__

    @pytest.mark.parametrize("place", ["checkout", "elsewhere"])
    def test_messages_and_package_are_one(
        self, place: str, repository: Path, tmp_path: Path
    ) -> None:
        code = (
            "from smallwheel_ros.msg import WheelSinkage, SoilEstimate, MobilityEstimate, VehicleMobility\n"
            "from smallwheel_ros.bags.types import message_definitions\n"
            "import smallwheel_ros.common.errors\n"
            "m = WheelSinkage(sinkage=0.01, variance=1e-6)\n"
            "m.header.frame_id = 'front_left'\n"
            "assert len(SoilEstimate().covariance) == 9\n"
            "assert MobilityEstimate.STATUS_OK == MobilityEstimate().status == 0\n"
            "assert VehicleMobility.LEVEL_UNKNOWN == VehicleMobility().level == 0\n"
            "print(len(message_definitions()), m.sinkage)\n"
        )
        cwd = repository if place == "checkout" else tmp_path
        result = run(sys.executable, "-c", code, cwd=cwd)
        assert (result.returncode, result.stdout) == (0, "4 0.01\n"), result.stderr

    def test_messages_survive_the_wire_format(self) -> None:
        from rclpy.serialization import deserialize_message, serialize_message
        from smallwheel_ros.msg import MobilityEstimate, SoilEstimate

        soil = SoilEstimate(k=1.6e6, n=0.8, m=0.39, status_text="m not determined")
        soil.covariance = [float(i) for i in range(9)]
        soil.measurements_accepted = 2**40
        mobility = MobilityEstimate(status=MobilityEstimate.STATUS_SUNK_TO_AXLE, load_valid=True)
        for message in (soil, mobility):
            assert deserialize_message(serialize_message(message), type(message)) == message

    @pytest.mark.parametrize("name", ["mobility_estimator", "smallwheel"])
    def test_executables_are_where_ros2_run_looks(self, name: str) -> None:
        program = Path(sys.prefix) / "lib" / "smallwheel_ros" / name
        if not program.exists() and "AMENT_PREFIX_PATH" in os.environ:
            prefixes = os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)
            programs = [Path(prefix) / "lib" / "smallwheel_ros" / name for prefix in prefixes]
            program = next(path for path in programs if path.exists())
        assert os.access(program, os.X_OK)
        interpreter = re.search(r"/[^'\"\n]*python[0-9.]*", program.read_text())
        assert interpreter
        assert Path(interpreter[0]).resolve() == Path(sys.executable).resolve()

    def test_command_line_starts_from_anywhere(self, tmp_path: Path) -> None:
        program = Path(sysconfig.get_path("scripts")) / "smallwheel"
        if not program.exists():
            pytest.skip("not an environment made by make")
        result = run(program, "--help", cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert "Usage: smallwheel" in result.stdout


@pytest.mark.dds
def test_a_message_of_ours_crosses_dds(repository: Path, tmp_path: Path) -> None:
    """A publisher in another process, started elsewhere, is heard here with its values."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from smallwheel_ros.msg import WheelSinkage

    code = (
        "import rclpy, time\n"
        "from smallwheel_ros.msg import WheelSinkage\n"
        "rclpy.init()\n"
        "node = rclpy.create_node('wheel')\n"
        "publisher = node.create_publisher(WheelSinkage, 'sinkage', 10)\n"
        "for _ in range(2400):\n"
        "    publisher.publish(WheelSinkage(sinkage=0.0123, variance=4e-6))\n"
        "    time.sleep(0.05)\n"
    )
    received: list[WheelSinkage] = []
    context = rclpy.Context()
    rclpy.init(context=context)
    executor = SingleThreadedExecutor(context=context)
    node = rclpy.create_node("listener", context=context)
    node.create_subscription(WheelSinkage, "sinkage", received.append, 10)
    executor.add_node(node)
    publisher = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    try:
        deadline = time.monotonic() + 60.0
        while not received and publisher.poll() is None and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
    finally:
        publisher.terminate()
        publisher.wait(10)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert received, "no message came within 60 s"
    assert (received[0].sinkage, received[0].variance) == (0.0123, 4e-6)


# Empty: what would lead a Python without ROS to the ROS of the tests.
NO_ROS = {"PYTHONPATH": "", "_ROS_WHEELS_BOOTSTRAP_COMPLETE": ""}


@pytest.fixture(scope="module")
def pip_environment(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment without ROS, with this package installed by pip."""
    venv = tmp_path_factory.mktemp("pip") / "venv"
    made = run(sys.executable, "-m", "venv", venv, cwd=source)
    assert made.returncode == 0, made.stderr
    # With their hashes, pip would want one of this package too.
    pinned = (source / "tools" / "environment.lock").read_text().splitlines()
    versions = venv / "versions.txt"
    versions.write_text("\n".join(line.rstrip(" \\") for line in pinned if "==" in line))
    result = run(
        *(venv / "bin" / "python", "-m", "pip", "install", "--no-input", "-c", versions, "."),
        cwd=source,
        timeout=600,
        **NO_ROS,
    )
    assert result.returncode == 0, result.stderr
    return venv


@pytest.mark.slow
class TestInstalledByPip:
    """`pip install .` into an environment without ROS."""

    def test_library_and_definitions_without_ros(
        self, pip_environment: Path, tmp_path: Path
    ) -> None:
        code = (
            "import importlib.util, smallwheel_ros\n"
            "from smallwheel_ros.bags.types import message_definitions, message_directory\n"
            "assert importlib.util.find_spec('rclpy') is None\n"
            "assert importlib.util.find_spec('smallwheel_ros.msg') is None\n"
            "assert message_directory().name == 'definitions'\n"
            "from smallwheel_ros.views.page import Page, html_of\n"
            "assert '.callout' in html_of(Page('a page has its style', []))\n"
            "print(sorted(message_definitions()), smallwheel_ros.__version__)\n"
        )
        result = run(pip_environment / "bin" / "python", "-c", code, cwd=tmp_path, **NO_ROS)
        names = sorted(f"smallwheel_ros/msg/{name}" for name in MESSAGES)
        assert result.stdout == f"{names} {smallwheel_ros.__version__}\n", result.stderr

    def test_command_line_without_ros(self, pip_environment: Path, tmp_path: Path) -> None:
        result = run(pip_environment / "bin" / "smallwheel", "--help", cwd=tmp_path, **NO_ROS)
        assert result.returncode == 0, result.stderr
        assert "Usage: smallwheel" in result.stdout

    @pytest.mark.parametrize("page", ["../README", "first_hour"])
    def test_pages_print_what_they_say(
        self, page: str, pip_environment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """As a reader types them, in a folder elsewhere: parquet and ROS are not installed."""
        import test_tutorials

        path = f"{pip_environment / 'bin'}{os.pathsep}{os.environ['PATH']}"

        def output(command: str) -> list[str]:
            done = run("bash", "-c", f"({command}) 2>&1", cwd=tmp_path, PATH=path, **NO_ROS)
            assert done.returncode == 0, f"{command}\n{done.stdout}"
            lines = done.stdout.rstrip().splitlines()
            return [part for line in lines for part in test_tutorials.folded(line.rstrip())]

        monkeypatch.chdir(tmp_path)
        test_tutorials.set_up(tmp_path)
        text = test_tutorials.text_of(page).partition("\n## The node\n")[0]
        test_tutorials.check(text, output)


@pytest.mark.slow
def test_installed_by_cmake_as_copies(source: Path, tmp_path: Path) -> None:
    """A plain `colcon build` copies files instead of linking them: ours must win there too."""
    pytest.importorskip("smallwheel_ros.msg", reason="needs ROS 2")
    tools = Path(sysconfig.get_path("scripts"))
    if not (tools / "ninja").exists():
        pytest.skip("not an environment made by make")
    prefix = {"AMENT_PREFIX_PATH": sys.prefix, "CMAKE_PREFIX_PATH": sys.prefix}
    build, install = tmp_path / "build", tmp_path / "install"
    configured = run(
        *(tools / "cmake", "-S", source, "-B", build, "-G", "Ninja"),
        f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}",
        f"-DCMAKE_INSTALL_PREFIX={install}",
        f"-DPython3_EXECUTABLE={sys.executable}",
        "-DPython3_FIND_VIRTUALENV=ONLY",
        "-DBUILD_TESTING=OFF",
        cwd=tmp_path,
        **prefix,
    )
    assert configured.returncode == 0, configured.stderr
    built = run(
        *(tools / "cmake", "--build", build, "--target", "install"),
        cwd=tmp_path,
        timeout=300,
        **prefix,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (package,) = install.glob("lib/python*/site-packages/smallwheel_ros")
    assert not [path for path in package.rglob("*") if path.is_symlink()]
    ours = source / "smallwheel_ros"
    for file in ours.rglob("*"):
        if file.is_file() and "__pycache__" not in file.parts:
            assert (package / file.relative_to(ours)).read_bytes() == file.read_bytes()
    result = run(
        *(sys.executable, "-c"),
        "from smallwheel_ros.bags.types import message_directory as d; print(d())",
        cwd=tmp_path,
        PYTHONPATH=str(package.parent),
    )
    assert result.stdout.strip() == str(package / "definitions"), result.stderr
