# SPDX-License-Identifier: Apache-2.0
"""Start the node in a process of its own, for demo, examples and tests; needs ROS only there."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from smallwheel_ros.common.errors import SmallwheelError

_MODULE = "smallwheel_ros.ros.mobility_estimator"
_LOG_LINES = 3


class NodeProcessError(SmallwheelError):
    """The node cannot be started here."""


def check_ros() -> None:
    """Raise NodeProcessError unless this Python has ROS, and the messages of this package."""
    lacking = {"rclpy": "no ROS 2 (rclpy)", "smallwheel_ros.msg": "no messages of smallwheel_ros"}
    for module, words in lacking.items():
        if importlib.util.find_spec(module) is None:
            raise NodeProcessError(
                f"this Python has {words}: run `make env` in a checkout, which puts both into its .venv, or"
                " source an installation of ROS 2 Jazzy in which smallwheel_ros is built"
            )


def config_file(name: str) -> Path:
    """Return a parameter file of this package, in the checkout or in the installation.

    Raises NodeProcessError where there is none of that name.
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


def own_ros(log_folder: Path) -> dict[str, str]:
    """Return environment variables for a ROS of one's own on this machine.

    The domain is the one of ROS_DOMAIN_ID where that is set, otherwise one by the process number.
    """
    return {
        "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID") or str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(log_folder),
    }


class NodeProcess:
    """The node in a process of its own; use it in a `with` statement, which ends it.

    Parameters
    ----------
    parameters
        Parameter files, later ones win.
    log
        File for what it prints.
    overrides
        Further parameters as ROS writes them, such as {"use_sim_time": "true"}.
    environment
        Variables that differ from this process's.
    """

    def __init__(
        self,
        parameters: Sequence[Path],
        log: Path,
        overrides: Mapping[str, str] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        arguments = ["--ros-args"]
        for path in parameters:
            arguments += ["--params-file", str(path)]
        for name, value in (overrides or {}).items():
            arguments += ["-p", f"{name}:={value}"]
        self.log = log
        self._command = [sys.executable, "-m", _MODULE, *arguments]
        self._environment = {**os.environ, **(environment or {})}

    def __enter__(self) -> NodeProcess:
        check_ros()
        with self.log.open("w") as stream:
            self._process = subprocess.Popen(
                self._command, stdout=stream, stderr=subprocess.STDOUT, env=self._environment
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def process_id(self) -> int:
        """Number of the process."""
        return self._process.pid

    def death(self) -> str | None:
        """Say how it ended, with its last words; None while it lives."""
        code = self._process.poll()
        if code is None:
            return None
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return f"exit code {code}; {self.log} ends with: {' | '.join(lines[-_LOG_LINES:])}"
