"""The page of `smallwheel explore` in a real browser: a click draws everything anew."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import CHROMIUM, Browser

from smallwheel_ros.diagnosis import Base
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.explore import ExploreServer, Session
from smallwheel_ros.measurements.table import read_measurements
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

EVIL = '<img src=x onerror="document.title=1"> $x^{ "&\''


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
