# SPDX-License-Identifier: Apache-2.0
"""Fixtures that tests share: recorded data that is not in the repository, and a ROS of one's own.

Mark a test that talks over DDS with ``@pytest.mark.dds``: it then has a ROS domain that no other
test on this machine uses, does not look beyond this machine, and logs into its own folder. The
same environment variables are in ``os.environ``, so processes that it starts inherit them.
"""

from __future__ import annotations

import gc
import os
import random
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from node_peer import Peer

ROOT = Path(__file__).resolve().parent.parent

# For helpers that several tests share: `from node_peer import Peer`. Those of a room's own tests stand in
# its folder.
sys.path[:0] = [
    str(folder)
    for folder in (
        ROOT / "test",
        *sorted(p for p in (ROOT / "test").rglob("*/") if p.name != "__pycache__"),
    )
]

# Never a window, whatever the machine has.
os.environ.setdefault("MPLBACKEND", "Agg")

# Examples of hypothesis. Fast tests: a third of hypothesis's own number, the same in each run, so that
# what passes once passes again. Slow tests (--hypothesis-profile=free): others in each run and ten times
# hypothesis's own number, also where a test names its own by `examples`; those that failed are kept in
# .hypothesis/ and tried first.
settings.register_profile("fast", max_examples=33, derandomize=True, database=None, deadline=None)
settings.register_profile("free", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("fast")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what talks over DDS: it takes longest, mostly waiting."""
    items.sort(key=lambda item: item.get_closest_marker("dds") is None)


def pytest_collection_finish() -> None:
    """Let the garbage collector leave alone what was imported for all tests: a fifth of the processor's time.

    Each of its full passes goes through every object of every module, some hundred thousand; tests make few
    that are in circles.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


@pytest.hookimpl(optionalhook=True)  # without pytest-xdist nobody calls it
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker whole modules, so that what a module's tests share is made once.

    Those of the node are one group: several nodes at a time would compete for the processor. (Groups
    by the mark xdist_group are lost with pytest 9.2: pytest-xdist #1386.)
    """
    from xdist.scheduler import LoadFileScheduling

    class ModuleScheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module: str = super()._split_scope(nodeid)
            return "node" if "_node" in module else module

    if config.getvalue("dist") != "loadfile":
        return None
    config.option.loadscopereorder = False  # keep the order of collection
    return ModuleScheduling(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Of several workers, those that compute give way to the one that talks over DDS in real time."""
    if "PYTEST_XDIST_WORKER" in os.environ and item.get_closest_marker("dds") is None:
        os.nice(max(0, 10 - os.nice(0)))


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def source(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the source without what was made in it, to build in."""
    if not (repository / ".git").exists():
        pytest.skip("not a git checkout: what is source cannot be told from what was built")
    copy = tmp_path_factory.mktemp("source")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=repository, capture_output=True, check=True, text=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (repository / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(repository / name, copy / name)
    assert (copy / "pyproject.toml").is_file()
    return copy


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with recorded data, which is not part of the repository; skips without it."""
    folder = Path(os.environ.get("SMALLWHEEL_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is missing (set SMALLWHEEL_SHARED)")
    return folder


@pytest.fixture(scope="session")
def shared_tools() -> Path:
    """The folder with tools that come with the recorded data; skips without it."""
    folder = Path(os.environ.get("SMALLWHEEL_SHARED", ROOT.parent / "shared")) / "tools"
    if not folder.is_dir():
        pytest.skip(f"no tools for recorded data: {folder} is missing (set SMALLWHEEL_SHARED)")
    return folder


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[int]:
    """A ROS domain that no other test process on this machine uses meanwhile.

    Domains above 101 have ports in the range that Linux gives to outgoing connections.
    """
    domains = list(range(1, 102))
    random.shuffle(domains)
    for domain in domains:
        # A name that begins with 0 is in Linux's abstract namespace: no file, and gone with the process.
        with socket.socket(socket.AF_UNIX) as taken:
            try:
                taken.bind(f"\0smallwheel_ros_domain_{domain}")
            except OSError:
                continue
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
            monkeypatch.delenv("ROS_LOCALHOST_ONLY", raising=False)
            yield domain
            return
    pytest.fail("all 101 ROS domains of this machine are in use by other tests")


@pytest.fixture(autouse=True)
def _own_ros(request: pytest.FixtureRequest) -> None:
    if request.node.get_closest_marker("dds"):
        pytest.importorskip("rclpy", reason="needs ROS 2 (rclpy)")
        request.getfixturevalue("ros_domain")


@pytest.fixture
def peer() -> Iterator[Peer]:
    """The node's other side; use it only in tests over DDS."""
    from node_peer import Peer

    made = Peer()
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def one_wheel(tmp_path: Path) -> Path:
    """A parameter file of the vehicle that `Peer` publishes for."""
    from node_peer import ONE_WHEEL

    path = tmp_path / "one_wheel.yaml"
    path.write_text(ONE_WHEEL)
    return path
