"""The page of `smallwheel explore` in a real browser: a click draws everything anew."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from smallwheel_ros.diagnosis import Base
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.explore import ExploreServer, Session
from smallwheel_ros.measurements.table import read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

EVIL = '<img src=x onerror="document.title=1"> $x^{ "&\''
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)  # fmt: skip


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ExploreServer]:
    """Serves a table with hidden slip sinkage and a hostile name of the soil and of the file."""
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    table["soil"] = "sand" + EVIL
    write_table(table, tmp_path / "rig<b>.csv")
    measurements = read_measurements(tmp_path / "rig<b>.csv")
    with ExploreServer(Session(measurements, Base(), default_registry())) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


class Browser:
    """Headless Chromium, told what to do through its debugging pipe: messages that end in NUL."""

    def __init__(self, folder: Path) -> None:
        ours, theirs = os.pipe(), os.pipe()
        self._out, self._in = os.fdopen(ours[1], "wb", 0), os.fdopen(theirs[0], "rb", 0)
        # Chromium reads from 3 and writes to 4, whatever numbers the pipes have here.
        wires = f'exec "$0" "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
                   "--disable-background-networking", "--window-size=1280,1250",
                   "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
                   "--remote-debugging-pipe", f"--user-data-dir={folder}", "about:blank"]  # fmt: skip
        self._process = subprocess.Popen(
            ["bash", "-c", wires, str(CHROMIUM), *options],
            pass_fds=(ours[0], theirs[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._number, self._page = 0, ""
        self.events: list[dict[str, Any]] = []
        pages = self.call("Target.getTargets")["targetInfos"]
        target = next(p["targetId"] for p in pages if p["type"] == "page")
        self._page = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Do one thing; what happens meanwhile is kept in `events`."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._page:
            message["sessionId"] = self._page
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            heard = json.loads(self._read())
            if heard.get("id") == self._number:
                assert "error" not in heard, heard
                return dict(heard["result"])
            self.events.append(heard)

    def _read(self) -> bytes:
        found = bytearray()
        while not found.endswith(b"\0"):
            part = self._in.read(1)
            assert part, "the browser has ended"
            found += part
        return bytes(found[:-1])

    def run(self, script: str) -> Any:
        """Give the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, script: str) -> None:
        """Wait until an expression is true in the page."""
        for _ in range(600):
            if self.run(script):
                return
            time.sleep(0.1)
        raise AssertionError(
            f"never true: {script}; the page: {self.run('document.body.innerText')}"
        )

    def picture(self, path: Path) -> Any:
        """Take a picture of what is seen."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))
        return matplotlib.image.imread(path)[..., :3]

    def close(self) -> None:
        self.call("Page.close")
        self._process.terminate()
        self._process.wait(60)
        self._out.close()
        self._in.close()


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium found: apt-get install chromium")
def test_a_click_draws_everything_anew(server: ExploreServer, tmp_path: Path) -> None:
    browser = Browser(tmp_path / "profile")
    browser.call("Page.navigate", url=server.url)
    browser.wait("document.querySelector('main img')?.complete && !!window.show")
    assert "The base model. Missing: slip sinkage" in browser.run("document.body.innerText")
    before = browser.picture(tmp_path / "before.png")
    first = browser.run("document.querySelector('main img').src")
    browser.run("document.querySelector('input[value=slip_sinkage]').click()")
    browser.wait("document.querySelector('main').innerText.includes('With slip sinkage')")
    assert browser.run("location.search") == "?effects=slip_sinkage&over=slip"
    assert browser.run("document.querySelector('main img').src") != first
    second = browser.run("document.querySelector('main img').src")
    browser.run("const s = document.querySelector('select'); s.value = 'load';"
                "s.dispatchEvent(new Event('change', {bubbles: true}))")  # fmt: skip
    browser.wait("location.search.endsWith('over=load') && !document.querySelector('.busy')")
    assert browser.run("document.querySelector('main img').src") != second
    after = browser.picture(tmp_path / "after.png")
    browser.run("for (const name of ['multipass', 'sinkage_offset', 'multipass'])"
                "document.querySelector(`input[value=${name}]`).click()")  # fmt: skip
    browser.wait(
        "document.querySelector('main').innerText.includes('With sinkage offset and slip sinkage')"
    )
    assert browser.run("location.search") == (
        "?effects=slip_sinkage&effects=sinkage_offset&over=load"
    )
    blue = np.array([0x00, 0x72, 0xB2]) / 255
    drawn = [int((np.abs(p - blue).max(axis=-1) < 0.02).sum()) for p in (before, after)]
    assert drawn[1] > drawn[0] + 300, "the curves of the model with the effect are not there"
    assert browser.run("document.title") == "rig<b>.csv: explore"  # not what the evil name wants
    assert browser.run("document.querySelector('input[value=grouser]')") is None
    complaints = [e for e in browser.events
                  if e.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded",
                                         "Runtime.consoleAPICalled")]  # fmt: skip
    assert not complaints
    asked = {e["params"]["request"]["url"] for e in browser.events
             if e.get("method") == "Network.requestWillBeSent"}  # fmt: skip
    assert all(url.startswith((server.url, "data:")) for url in asked), asked
    assert any("/view?" in url for url in asked)  # so requests are seen at all
    browser.close()
