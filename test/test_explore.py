"""`smallwheel explore`: the session, its server over real HTTP, and the page in a real browser."""

from __future__ import annotations

import base64
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import click
import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner

from smallwheel_ros import cli
from smallwheel_ros.diagnosis.apply import base_of
from smallwheel_ros.diagnosis.held_out import refitted
from smallwheel_ros.diagnosis.workbench import Base
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.explore import ExploreError, ExploreServer, Session
from smallwheel_ros.explore.page import view_html
from smallwheel_ros.measurements.table import read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

EVIL = '<img src=x onerror="document.title=1"> $x^{ "&\''
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)  # fmt: skip


def open_session(path: Path, base: Base | None = None) -> Session:
    return Session(read_measurements(path), base or Base(), default_registry())


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated table with hidden slip sinkage; a column and the soil have hostile names."""
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    table["soil"] = "sand" + EVIL
    generator = np.random.default_rng(1)
    wet = generator.uniform(0.1, 0.9, table["run"].nunique())
    table["wet" + EVIL] = wet[np.unique(table["run"], return_inverse=True)[1]]
    path = tmp_path_factory.mktemp("rig") / "rig<b>.csv"
    write_table(table, path)
    return path


@pytest.fixture(scope="module")
def session(rig: Path) -> Session:
    return open_session(rig)


# The session


def test_an_effect_that_is_hidden_in_the_data_takes_the_error_to_the_floor(
    session: Session,
) -> None:
    base, full = session.view([]), session.view(["slip_sinkage"])
    assert base.before.rmse() == base.after.rmse() == full.before.rmse()
    for channel, before in base.after.rmse().items():
        assert full.after.rmse()[channel] < 0.5 * before
        # Seen from the base its misfit would pass for scatter: the floor must not be made of it.
        assert full.floor[channel] < 0.5 * before
        assert base.floor[channel] == full.floor[channel]
        assert full.floor[channel] > session.repeats[channel]
    assert full.fall > 0.5
    assert base.worth["slip_sinkage"] > 50
    assert full.worth["slip_sinkage"] > 50
    assert full.worth["penetration_rate"] < base.worth["slip_sinkage"] / 5
    fitted = {p.full_name: p for p in full.fit.parameters}
    assert any(name.startswith("slip_sinkage.") and p.std for name, p in fitted.items())


def test_what_was_looked_at_before_does_not_matter(rig: Path, session: Session) -> None:
    names = ["multipass", "slip_sinkage"]
    session.view(["multipass"])
    session.view(["slip_sinkage", "load_dependent_modulus"])
    one, other = session.view(names), open_session(rig).view(names[::-1])
    assert one.after.rmse() == other.after.rmse()
    assert one.floor == other.floor
    assert one.worth == other.worth
    assert [p.value for p in one.fit.parameters] == [p.value for p in other.fit.parameters]


def test_the_error_is_that_of_fits_without_each_run(session: Session) -> None:
    view = session.view(["slip_sinkage"])
    again = refitted(session.workbench, view.explanation)
    np.testing.assert_array_equal(view.after.error, again.error)
    left = session.workbench.observations.value - view.explanation.fit.solution.predicted
    assert np.sqrt(np.mean(view.after.error**2)) > np.sqrt(np.mean(left**2))


def test_the_saved_model_is_the_one_shown_and_can_be_explored_again(
    rig: Path, session: Session, tmp_path: Path
) -> None:
    view = session.view(["multipass", "slip_sinkage"])
    saved = tmp_path / "model.yaml"
    saved.write_bytes(session.model_file(["slip_sinkage", "multipass"]))
    known = read_model(saved)
    assert {e.id for e in known.model.effects} == {"multipass", "slip_sinkage"}
    for parameter in view.fit.parameters:
        if parameter.owner == "slip_sinkage":
            effect = next(e for e in known.model.effects if e.id == parameter.owner)
            assert getattr(effect, parameter.name) == pytest.approx(parameter.value)
            assert known.standard_deviation(parameter.full_name) == pytest.approx(parameter.std)
    assert known.provenance["held_out_rmse"] == pytest.approx(view.after.rmse())
    again = open_session(rig, base_of(known, session.measurements))
    assert set(again.chosen) == {"multipass", "slip_sinkage"}
    assert again.view([]).after.rmse()["sinkage"] > again.view(again.chosen).after.rmse()["sinkage"]


def test_what_the_data_cannot_test_is_refused_with_the_reason(session: Session) -> None:
    for name, reason in {
        "grouser": "no column 'grouser_height'",
        "skid_sinkage": "no row has a wheel that skids",
        "slip_sinkge": "did you mean 'slip_sinkage'",
    }.items():
        with pytest.raises(ExploreError, match=reason):
            session.view([name])
    with pytest.raises(ExploreError, match="did you mean 'speed'"):
        session.covariate("sped")
    assert session.covariate(None) == "slip"  # what the strongest lead follows
    assert session.covariate("wet" + EVIL) == "wet" + EVIL


@pytest.mark.parametrize(("rows", "message"), [(1, "of one run"), (3, "of one run")])
def test_one_run_is_refused(rows: int, message: str, tmp_path: Path) -> None:
    write_table(simulate_rig(RigSettings(seed=3, runs=6)).table.iloc[:rows], tmp_path / "few.csv")
    with pytest.raises(ExploreError, match=message):
        open_session(tmp_path / "few.csv")


def test_of_a_few_runs_it_is_said_that_they_are_few(tmp_path: Path) -> None:
    write_table(simulate_rig(RigSettings(seed=3, runs=6)).table.iloc[:6], tmp_path / "few.csv")
    opened = open_session(tmp_path / "few.csv")
    view = opened.view([])
    assert np.isfinite(view.after.error).all()
    assert all(np.isfinite(v) for v in view.floor.values())
    assert "2 runs: under 6 nothing can be told" in view_html(opened, view, "load")


def test_without_repeats_no_noise_floor_is_claimed(tmp_path: Path) -> None:
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    write_table(table.groupby("run").head(1), tmp_path / "once.csv")
    opened = open_session(tmp_path / "once.csv")
    view = opened.view(["slip_sinkage"])
    assert view.floor == {}
    assert opened.repeats == {}
    assert "not known here, since no setting was repeated" in view_html(opened, view, "slip")


# The server, over real HTTP


@pytest.fixture(scope="module")
def server(session: Session) -> Iterator[ExploreServer]:
    with ExploreServer(session) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def ask(
    server: ExploreServer, path: str, method: str = "GET", **headers: str
) -> tuple[http.client.HTTPResponse, str]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=120)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer, text


def test_the_page_shows_effects_errors_and_pictures(server: ExploreServer) -> None:
    answer, html = ask(server, "/")
    assert answer.status == 200
    assert "default-src 'none'" in str(answer.getheader("Content-Security-Policy"))
    assert "rig&lt;b&gt;.csv" in html
    assert EVIL not in html  # only escaped
    assert html.count("<img ") == 1  # the picture, not the evil name
    assert "no column &#x27;grouser_height&#x27;" in html
    assert 'value="slip" selected' in html
    assert re.search(r"checked>", html) is None
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', html)


def test_a_view_is_drawn_for_what_is_set(server: ExploreServer, session: Session) -> None:
    answer, text = ask(server, "/view?effects=slip_sinkage&over=load")
    assert answer.status == 200
    found = json.loads(text)
    assert found["worth"] == session.view(["slip_sinkage"]).worth
    picture = re.search(r'src="data:image/svg\+xml;base64,([^"]*)"', found["html"])
    assert picture is not None
    assert base64.b64decode(picture[1]).rstrip().endswith(b"</svg>")
    after = 1e3 * session.view(["slip_sinkage"]).after.rmse()["sinkage"]
    assert f"→ {after:.3g}" in found["html"]
    assert "With slip sinkage" in found["html"]
    assert re.search(r"\bnan\b", re.sub(r'src="[^"]*"', "", found["html"])) is None
    other = json.loads(ask(server, "/view?effects=slip_sinkage&over=slip")[1])["html"]
    assert other != found["html"]


def test_a_column_with_a_hostile_name_can_be_set_and_drawn(server: ExploreServer) -> None:
    name = quote("wet" + EVIL)
    answer, text = ask(server, f"/view?effects=covariate%3A{name}&over={name}")
    assert answer.status == 200, text
    assert EVIL not in json.loads(text)["html"]


@pytest.mark.parametrize(
    ("path", "status", "message"),
    [
        ("/view?effects=slip_sinkge", 400, "did you mean 'slip_sinkage'"),
        ("/?effects=nonsense", 400, "no effect 'nonsense'"),
        ("/view?effects=grouser&over=slip", 400, "no column 'grouser_height'"),
        ("/view?over=sped", 400, "did you mean 'speed'"),
        ("/view?over=slip_angle", 400, "no covariate 'slip_angle'"),
        ("/view?effects=", 400, "no effect ''"),
        ("/model.yaml?effects=nonsense", 400, "no effect 'nonsense'"),
        ("/view?what=1", 400, "no setting 'what'"),
        ("/view?effects=%00%ff%3Cb%3E", 400, "no effect"),
        ("/../../etc/passwd", 404, "no page"),
        ("/nothing", 404, "no page"),
    ],
)
def test_a_bad_question_gets_a_message(
    server: ExploreServer, path: str, status: int, message: str
) -> None:
    answer, text = ask(server, path)
    assert answer.status == status
    assert message in text
    assert str(answer.getheader("Content-Type")).startswith("text/plain")
    assert "Traceback" not in text


def test_other_ways_to_ask_are_refused(server: ExploreServer) -> None:
    assert ask(server, "/", "POST")[0].status == 501
    answer, text = ask(server, "/", Host="evil.example:80")  # a name that leads to this machine
    assert answer.status == 403
    assert "expected 127.0.0.1" in text
    assert ask(server, "/explore.js", Host="localhost:9")[0].status == 200
    with socket.create_connection(server.server_address[:2]) as line:
        line.sendall(b"rubbish\r\n\r\n")
        assert b"400" in line.recv(4096)
    assert ask(server, "/explore.js")[0].status == 200  # still there


def test_a_model_file_is_offered_for_download(server: ExploreServer, tmp_path: Path) -> None:
    answer, text = ask(server, "/model.yaml?effects=slip_sinkage&over=slip")
    assert answer.status == 200
    assert answer.getheader("Content-Disposition") == (
        'attachment; filename="rig_b__slip_sinkage.yaml"'
    )
    (tmp_path / "saved.yaml").write_text(text)
    assert [e.id for e in read_model(tmp_path / "saved.yaml").model.effects] == ["slip_sinkage"]


CRUMBLING = """
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects import Effect, parameter


@dataclass(frozen=True)
class Crumbling(Effect):
    id = "crumbling"
    summary = "<b>Soil that crumbles under slip, by a law that gives up too early.</b>"
    needs = ("slip",)
    a: float = parameter(0.1, (0.0, 8.0), "loss of ln k")

    def modulus_factor(self, conditions):
        if self.a > 0.5:
            raise ValueError("<i>more than I can bear</i>")
        return np.exp(-self.a * np.maximum(conditions["slip"], 0.0))
"""


def test_a_fit_that_fails_is_said_in_the_page(rig: Path, tmp_path: Path) -> None:
    (tmp_path / "crumbling.py").write_text(CRUMBLING)
    registry = default_registry().with_file(tmp_path / "crumbling.py")
    with ExploreServer(Session(read_measurements(rig), Base(), registry)) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        try:
            for path in ("/view?effects=crumbling&over=slip", "/?effects=crumbling&over=slip"):
                answer, text = ask(running, path)
                assert answer.status == 200
                shown = json.loads(text)["html"] if path.startswith("/view") else text
                assert "This cannot be shown" in shown
                assert "more than I can bear" in shown
                assert "<i>" not in shown
                assert "Traceback" not in shown
            assert ask(running, "/model.yaml?effects=crumbling")[0].status == 400
            assert "With slip sinkage" in ask(running, "/?effects=slip_sinkage")[1]
        finally:
            running.shutdown()
            thread.join()


def test_only_this_machine_is_served(server: ExploreServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    port = server.server_address[1]
    # In /proc/net/tcp an address is hexadecimal and turned round; 0A is a socket that listens.
    listening = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        if not Path(table).is_file():
            pytest.skip(f"no {table} here to look at")
        for line in Path(table).read_text().splitlines()[1:]:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.rpartition(":")[2], 16) == port:
                listening.append(address.rpartition(":")[0])
    assert listening == ["0100007F"]


# The command


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["none.csv"], "none.csv"),
        (["rig.csv", "--model", "none.yaml"], "none.yaml"),
        (["rig.csv", "--effects", "none.py"], "none.py"),
        (["rig.csv", "--port", "70000"], "70000"),
        (["rig.csv", "--port", "seven"], "seven"),
        (["empty.csv"], "empty.csv"),
        ([], "DATA"),
    ],
)
def test_bad_input_gives_one_message(
    options: list[str], message: str, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.csv").write_bytes(rig.read_bytes())
    Path("empty.csv").write_text("")
    done = CliRunner().invoke(cli.main, ["explore", "--no-browser", *options])
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert done.stdout == ""


def test_a_port_that_is_taken_is_said(session: Session) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ExploreError, match=f"port {port} cannot be had .*--port"):
            ExploreServer(session, port)


def test_the_command_prints_the_address_and_ends_with_ctrl_c(rig: Path, repository: Path) -> None:
    command = [sys.executable, "-m", "smallwheel_ros.cli", "explore", str(rig), "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=environment)  # fmt: skip
    assert running.stdout is not None
    try:
        url = running.stdout.readline().strip()
        port = int(re.fullmatch(r"http://127\.0\.0\.1:(\d+)/", url)[1])  # type: ignore[index]
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
        connection.request("GET", "/?effects=slip_sinkage&over=slip")
        assert "With slip sinkage" in connection.getresponse().read().decode()
        running.send_signal(signal.SIGINT)
        rest, errors = running.communicate(timeout=60)
    finally:
        running.kill()
    assert running.returncode == 0, errors
    assert rest == ""
    assert "Traceback" not in errors


def test_what_the_page_of_documentation_says_to_type_can_be_typed(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (repository / "docs" / "explore.md").read_text()
    typed = re.findall(r"^\$ (?:ssh .* )?smallwheel (.*)$", text, re.MULTILINE)
    assert {line.split()[0] for line in typed} == {"simulate", "explore", "diagnose", "report"}
    monkeypatch.chdir(tmp_path)
    for line in typed:
        name, *arguments = line.split()
        command = cli.main.get_command(click.Context(cli.main), name)
        assert command is not None
        if name == "simulate":
            assert CliRunner().invoke(cli.main, [name, *arguments]).exit_code == 0
            assert Path("rig.csv").is_file()
        else:
            command.make_context(name, list(arguments))  # refuses what it does not know
    options = set(re.findall(r"`(--[a-z-]+)", text.split("## Options")[1].split("## ")[0]))
    explore = cli.main.get_command(click.Context(cli.main), "explore")
    assert explore is not None
    assert options == {o for p in explore.params for o in p.opts if o.startswith("--")}
    picture = repository / "docs" / re.findall(r"\]\((images/.*?)\)", text)[0]
    assert 20e3 < picture.stat().st_size < 200e3


# In a browser


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
    assert "The base model, without any effect" in browser.run("document.body.innerText")
    before = browser.picture(tmp_path / "before.png")
    first = browser.run("document.querySelector('main img').src")
    browser.run("document.querySelector('input[value=slip_sinkage]').click()")
    browser.wait("document.querySelector('main').innerText.includes('With slip sinkage')")
    assert browser.run("location.search") == "?effects=slip_sinkage&over=slip"
    assert browser.run("document.querySelector('main img').src") != first
    worth = int(browser.run("document.querySelector('[data-effect=slip_sinkage]').innerText"))
    assert worth == round(server.session.view(["slip_sinkage"]).worth["slip_sinkage"])
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
        "?effects=sinkage_offset&effects=slip_sinkage&over=load"
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
