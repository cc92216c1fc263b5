# SPDX-License-Identifier: Apache-2.0
"""A real browser for tests of pages: headless Chromium, told what to do through its debugging pipe."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)  # fmt: skip
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium found: apt-get install chromium"
)


class Browser:
    """Headless Chromium, told what to do through its debugging pipe: messages that end in NUL."""

    def __init__(self, folder: Path) -> None:
        ours, theirs = os.pipe(), os.pipe()
        self._out, self._in = os.fdopen(ours[1], "wb", 0), os.fdopen(theirs[0], "rb", 0)
        # Chromium reads from 3 and writes to 4, whatever numbers the pipes have here.
        wires = f'exec "$0" "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
                   "--disable-background-networking", "--hide-scrollbars",
                   "--window-size=1400,1000",
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
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True,
                           awaitPromise=True)  # fmt: skip
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

    def open(self, url: str) -> None:
        """Go to a page and wait until its script has run."""
        self.call("Page.navigate", url=url)
        self.wait(
            f"document.readyState === 'complete' && location.href.startsWith({json.dumps(url)})"
        )

    def look(self, width: int = 1400, dark: bool = False, print_it: bool = False) -> None:
        """See the page at that width, in light or in dark colours, on the screen or on paper."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=1000,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="print" if print_it else "screen",
                  features=[scheme])  # fmt: skip

    def press(self, key: str) -> None:
        """Press and release a key where the focus is."""
        code = {"Space": " "}.get(key, key)
        text = {"text": " "} if key == "Space" else {"text": "\r"} if key == "Enter" else {}
        numbers = {
            "Space": 32,
            "Tab": 9,
            "Enter": 13,
            "ArrowRight": 39,
            "ArrowLeft": 37,
            "Escape": 27,
        }
        for kind in ("keyDown", "keyUp"):
            more = text if kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=code, code=key,
                      windowsVirtualKeyCode=numbers.get(key, 0), **more)  # fmt: skip

    def picture(self, path: Path, whole: bool = False) -> None:
        """Take a picture of what is seen, or of the whole page."""
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def paper(self, path: Path) -> None:
        """Print to a PDF file."""
        self.call("Emulation.setEmulatedMedia", media="")
        path.write_bytes(base64.b64decode(self.call("Page.printToPDF", paperWidth=8.27,
                         paperHeight=11.69)["data"]))  # fmt: skip

    @property
    def requests(self) -> list[str]:
        """Addresses asked for since the beginning, without data in addresses."""
        asked = [e["params"]["request"]["url"] for e in self.events
                 if e.get("method") == "Network.requestWillBeSent"]  # fmt: skip
        return [url for url in asked if not url.startswith("data:")]

    @property
    def complaints(self) -> list[Any]:
        """What the page wrote to the console, and its errors."""
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled")
        return [e["params"] for e in self.events if e.get("method") in kinds]

    def close(self) -> None:
        self.call("Page.close")
        self._process.terminate()
        self._process.wait(60)
        self._out.close()
        self._in.close()
