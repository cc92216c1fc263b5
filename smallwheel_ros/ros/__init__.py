# SPDX-License-Identifier: Apache-2.0
"""The node; only the modules of this folder import rclpy and the generated messages.

The functions here need ROS only when they run: `smallwheel node` runs the node in this process,
`NodeProcess` in one of its own, for demo, examples and tests.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from smallwheel_ros.common.errors import SmallwheelError


class NodeProcessError(SmallwheelError):
    """The node cannot be started here."""


def check_ros() -> None:
    """Raise NodeProcessError unless this Python has ROS 2 and the generated messages of this package."""
    lacking = {"rclpy": "no ROS 2 (rclpy)", "smallwheel_ros.msg": "no messages of smallwheel_ros"}
    for module, words in lacking.items():
        if importlib.util.find_spec(module) is None:
            raise NodeProcessError(
                f"this Python has {words}: run `make env` in a checkout, which puts ROS 2 and this package "
                "into its .venv, or source an installation of ROS 2 Jazzy in which smallwheel_ros is built"
            )


@click.command()
@click.option(
    "--params-file",
    "files",
    type=click.Path(path_type=Path, exists=True, dir_okay=False, readable=True),
    multiple=True,
    required=True,
    metavar="ROVER.yaml",
    help="Parameters, as `smallwheel init` writes them; of several files later ones win.",
)
@click.option(
    "--remap",
    "remaps",
    multiple=True,
    metavar="NAME:=TOPIC",
    help="The node's name of a topic, then the robot's: odom:=/rover/odom.",
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="[-- ROS_ARGUMENTS...]")
def node(files: tuple[Path, ...], remaps: tuple[str, ...], arguments: tuple[str, ...]) -> None:
    """Run the node mobility_estimator until Ctrl-C; it needs ROS 2.

    Further arguments of ROS come after --, such as `-- -p use_sim_time:=true -r __ns:=/robot1`. Exit
    code 2: a parameter or argument is wrong; the last line names it.
    """
    check_ros()
    from smallwheel_ros.ros.mobility_estimator import main

    given = [word for file in files for word in ("--params-file", str(file))]
    given += [word for remap in remaps for word in ("-r", remap)]
    raise SystemExit(main(["--ros-args", *given, *arguments]))


def config_file(name: str) -> Path:
    """Return the path of a parameter file of this package, in the checkout or in the installation.

    Raises NodeProcessError if there is none of that name.
    """
    prefixes = [
        *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep),
        sysconfig.get_path("data"),
    ]
    folders = [
        Path(__file__).resolve().parents[2],
        *(Path(prefix) / "share" / "smallwheel_ros" for prefix in prefixes if prefix),
    ]
    for folder in folders:
        path = folder / "config" / name
        if path.is_file():
            return path
    places = ", ".join(str(folder / "config") for folder in folders)
    raise NodeProcessError(f"there is no parameter file {name} in {places}")


class NodeProcess:
    """The node as a separate process, which a `with` statement starts and ends.

    Parameters
    ----------
    parameters
        Parameter files; later ones take precedence.
    log
        File for the node's output.
    overrides
        Further parameters in ROS notation, which take precedence over the files, such as
        {"use_sim_time": "true"}.
    environment
        Environment variables that differ from those of this process, by name.

    Attributes
    ----------
    process_id
        Number of the process, once it is started.
    """

    def __init__(
        self,
        parameters: Sequence[Path],
        log: Path,
        overrides: Mapping[str, str] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._command = [
            sys.executable,
            "-m",
            "smallwheel_ros.ros.mobility_estimator",
            "--ros-args",
        ]
        for path in parameters:
            self._command += ["--params-file", str(path)]
        for name, value in (overrides or {}).items():
            self._command += ["-p", f"{name}:={value}"]
        self._log = log
        self._environment = {**os.environ, **(environment or {})}

    def __enter__(self) -> NodeProcess:
        check_ros()
        with self._log.open("w") as stream:
            self._process = subprocess.Popen(
                self._command, stdout=stream, stderr=subprocess.STDOUT, env=self._environment
            )
        self.process_id = self._process.pid
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def death(self) -> str | None:
        """Return how the process ended, with its last output; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return f"exit code {code}; {self._log} ends with: {' | '.join(lines[-3:])}"
