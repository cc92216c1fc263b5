# SPDX-License-Identifier: Apache-2.0
"""`smallwheel explore`: the session, its server over real HTTP, and the page in a real browser."""

from __future__ import annotations

import copy
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote, unquote

import click
import numpy as np
import pytest
from click.testing import CliRunner

from smallwheel_ros import cli
from smallwheel_ros.diagnosis import Base, base_of
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.explore import ExploreError, ExploreServer, Session
from smallwheel_ros.explore.data import SessionData
from smallwheel_ros.explore.session import View
from smallwheel_ros.fitting.held_out import Comparison
from smallwheel_ros.measurements.display import shown_value
from smallwheel_ros.measurements.wheels import read_measurements
from smallwheel_ros.model.model_file import read_model
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

EVIL = '<img src=x onerror="document.title=1"> $x^{ "&\''


def open_session(path: Path, base: Base | None = None) -> Session:
    return Session.of(read_measurements(path), base or Base(), default_registry())


def said(session: Session, view: View) -> str:
    """All that the page shows of a view, as text."""
    return json.dumps(SessionData(session).view(view), ensure_ascii=False)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated table with hidden slip sinkage; a column and the soil have hostile names."""
    table = simulate_rig(RigSettings(seed=3, runs=12, hidden=("slip_sinkage",))).table
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


def test_the_page_and_the_diagnosis_say_the_same(session: Session) -> None:
    document = session.document
    assert document["missing_effects"] == ["slip_sinkage"]
    base, full = session.view([]), session.view(["slip_sinkage"])
    for view, step in zip((base, full), document["steps"], strict=True):
        assert view.after.rmse() == pytest.approx(step["held_out_rmse"], rel=1e-5)
        assert view.before.rmse() == base.after.rmse()
    assert full.change.helps
    assert all(fall > 0.0 for fall in full.change.reduction.values())
    fitted = {p.full_name: p for p in full.fit.parameters}
    assert any(name.startswith("slip_sinkage.") and p.std for name, p in fitted.items())
    named = said(session, full)
    assert "This is what the diagnosis names." in named
    assert "not recommended" not in named
    for channel in document["channels"].values():
        assert channel["noise_floor"] is not None


def test_what_the_diagnosis_does_not_name_is_not_recommended(session: Session) -> None:
    other = said(session, session.view(["multipass"]))
    assert "multipass: probability" in other
    assert "not recommended" in other
    assert "Slip sinkage is left out." in other
    assert "the model lacks slip sinkage" in other
    assert "An effect that is not testable" not in said(session, session.view([]))


def test_a_channel_whose_error_rises_is_said(session: Session) -> None:
    view = session.view(["multipass", "slip_sinkage"])
    rises = Comparison({"sinkage": -0.3, "resistance": 0.5}, {"sinkage": -1.1, "resistance": 3.0})
    html = said(session, replace(view, change=rises))
    assert "The held-out error of sinkage rises." in html
    assert "error of resistance rises" not in html


def test_an_error_of_the_instrument_is_told_from_an_effect_of_the_soil(session: Session) -> None:
    page = SessionData(session).page([()]).block().html()
    soil, instrument = page.split("Errors of the instrument")
    assert 'value="sinkage_offset"' in instrument
    assert 'value="sinkage_offset"' not in soil
    assert 'value="slip_sinkage"' in soil
    assert "instrument)" in said(session, session.view(["sinkage_offset"]))


def test_what_was_looked_at_before_does_not_matter(rig: Path, session: Session) -> None:
    names = ["multipass", "slip_sinkage"]
    session.view(["multipass"])
    session.view(["slip_sinkage", "load_dependent_modulus"])
    one, other = session.view(names), open_session(rig).view(names[::-1])
    assert one.after.rmse() == other.after.rmse()
    assert [p.value for p in one.fit.parameters] == [p.value for p in other.fit.parameters]


def test_the_error_is_that_of_fits_without_each_run(session: Session) -> None:
    view = session.view(["multipass"])
    for channel, error in view.after.error.items():
        known = np.isfinite(session.measurements.channels[channel])
        known[session.problem.outliers] = False
        np.testing.assert_array_equal(np.isfinite(error), known)
        assert view.after.rmse()[channel] > view.fit.errors.rmse()[channel]


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
    assert again.view(again.chosen).after.rmse() == pytest.approx(
        again.document["steps"][0]["held_out_rmse"], rel=1e-5
    )
    assert again.view([]).after.rmse()["sinkage"] > again.view(again.chosen).after.rmse()["sinkage"]
    assert {e.id for e in again.view(["slip_sinkage"]).fit.model.effects} == {"slip_sinkage"}


def test_what_the_data_cannot_test_is_refused_with_the_reason(session: Session) -> None:
    for name, reason in {
        "grouser": "no column 'grouser_height'",
        "skid_sinkage": "no row has slip under 0",
        "slip_sinkge": "did you mean 'slip_sinkage'",
    }.items():
        with pytest.raises(ExploreError, match=reason):
            session.view([name])
    with pytest.raises(ExploreError, match="did you mean 'speed'"):
        session.setting("sped")
    assert session.setting(None) == "slip"  # over which the base fails most
    assert session.setting("wet" + EVIL) == "wet" + EVIL


@pytest.mark.parametrize(("rows", "message"), [(1, "of one run"), (3, "of one run")])
def test_one_run_is_refused(rows: int, message: str, tmp_path: Path) -> None:
    write_table(simulate_rig(RigSettings(seed=3, runs=6)).table.iloc[:rows], tmp_path / "few.csv")
    with pytest.raises(ExploreError, match=message):
        open_session(tmp_path / "few.csv")


def test_of_a_few_runs_it_is_said_that_they_are_few(tmp_path: Path) -> None:
    write_table(simulate_rig(RigSettings(seed=3, runs=6)).table.iloc[:6], tmp_path / "few.csv")
    opened = open_session(tmp_path / "few.csv")
    for names in ([], ["slip_sinkage"]):
        view = opened.view(names)
        assert all(np.isfinite(e).all() for e in view.after.error.values())
        assert "2 runs: under 6 runs nothing can be told" in said(opened, view)


def test_without_repeats_no_noise_floor_is_claimed(tmp_path: Path) -> None:
    table = simulate_rig(RigSettings(seed=3, runs=16, hidden=("slip_sinkage",))).table
    write_table(table.groupby("run").head(1), tmp_path / "once.csv")
    opened = open_session(tmp_path / "once.csv")
    html = json.dumps(SessionData(opened).page([()]).data)
    assert all(c["noise_floor"] is None for c in opened.document["channels"].values())
    assert "not known here" in html


# The server, over real HTTP


@contextmanager
def serving(session: Session) -> Iterator[ExploreServer]:
    with ExploreServer(session) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        try:
            yield running
        finally:
            running.shutdown()
            thread.join()


@pytest.fixture(scope="module")
def server(session: Session) -> Iterator[ExploreServer]:
    with serving(session) as running:
        yield running


def ask(
    server: ExploreServer, path: str, method: str = "GET", root: str | None = None
) -> tuple[http.client.HTTPResponse, str]:
    """Ask for a path below the address that is printed, or below another root."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=120)
    connection.request(method, (server.root if root is None else root) + path.removeprefix("/"))
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer, text


def test_the_page_shows_effects_and_has_what_was_fitted(server: ExploreServer) -> None:
    answer, html = ask(server, "/")
    assert answer.status == 200
    policy = str(answer.getheader("Content-Security-Policy"))
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert re.search(r"script-src 'sha256-[^']*'; .*connect-src 'self'", html)  # the page's own
    assert "rig&lt;b&gt;.csv" in html
    assert EVIL not in html  # only escaped
    assert "<img " not in html
    assert "no column &#x27;grouser_height&#x27;" in html
    assert 'value="slip" selected' in html
    assert re.search(r"checked>", html) is None
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', html)


def test_a_view_holds_what_the_diagnosis_says(server: ExploreServer, session: Session) -> None:
    answer, text = ask(server, "/view?effects=slip_sinkage&over=load")
    assert answer.status == 200
    found = json.loads(text)
    after = session.document["steps"][1]["held_out_rmse"]
    for channel, scale, unit in (("sinkage", 1e3, "mm"), ("resistance", 1.0, "N")):
        shown = found["rmse"][channel]
        assert shown["value"] == pytest.approx(scale * after[channel], rel=1e-3)
        assert f"{shown['text']} {unit}" == shown_value(channel, after[channel])
        assert f"→ {shown['text']} {unit}" in found["headline"]
        assert shown["text"] in session.diagnosis.text()  # to the last digit
    assert found["headline"].startswith("With slip sinkage")
    rows = [row for row in session.document["ranking"] if row["effect"] == "slip_sinkage"]
    assert {row[1] for row in found["parameters"]["rows"]} >= set(rows[0]["parameters"])
    assert "NaN" not in text


def test_each_effect_and_each_pair_is_fitted_while_nobody_asks(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = session.beforehand()[:4]
    wanted = session.beforehand()
    count = len(session.forms)
    assert len(wanted) == 1 + count + count * (count - 1) // 2
    assert len(session.beforehand(pairs=False)) == 1 + count
    assert wanted[:2] == [(), ("slip_sinkage",)]  # the steps to the verdict first
    fresh = Session(session.diagnosis, default_registry())
    monkeypatch.setattr(fresh, "beforehand", lambda pairs=True: few)
    with serving(fresh) as running:
        assert json.loads(ask(running, "/progress")[1]) == {"done": 0, "needed": 0}
        running.fit_beforehand()
        assert fresh.fitted == few
        page = ask(running, "/")[1]
    data = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])  # type: ignore[index]
    views = next(value for key, value in data.items() if key.startswith("effects"))["views"]
    assert len(views) == len(few)


def test_what_a_run_changes_can_be_asked(server: ExploreServer, session: Session) -> None:
    run = str(session.measurements.runs[3])
    answer, text = ask(server, f"/without?effects=slip_sinkage&run={run}")
    assert answer.status == 200
    lines = json.loads(text)["lines"]
    known = session.view(["slip_sinkage"])
    others = known.after.score("sinkage", session.measurements.run != run)
    assert others is not None
    assert f"{1e3 * others.rmse:.3g}"[:4] in lines[0]
    assert "without" in lines[0]
    assert any("standard deviation" in line or "with it" in line for line in lines[2:])
    answer, text = ask(server, "/without?effects=slip_sinkage&run=nobody")
    assert answer.status == 400
    assert "no run 'nobody'" in text


def test_a_column_with_a_hostile_name_can_be_set_and_drawn(server: ExploreServer) -> None:
    name = quote("wet" + EVIL)
    answer, text = ask(server, f"/view?effects=covariate%3A{name}&over={name}")
    assert answer.status == 200, text
    assert answer.getheader("Content-Type") == "application/json"
    assert answer.getheader("X-Content-Type-Options") == "nosniff"


@pytest.mark.parametrize(
    ("path", "status", "message"),
    [
        ("/view?effects=slip_sinkge", 400, "did you mean 'slip_sinkage'"),
        ("/?effects=nonsense", 400, "no effect 'nonsense'"),
        ("/view?effects=grouser&over=slip", 400, "no column 'grouser_height'"),
        ("/view?over=sped", 400, "did you mean 'speed'"),
        ("/view?over=slip_angle", 400, "no setting 'slip_angle'"),
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
    with socket.create_connection(server.server_address[:2]) as line:
        line.sendall(b"rubbish\r\n\r\n")
        assert b"400" in line.recv(4096)
    assert ask(server, "/progress")[0].status == 200  # still there


@pytest.mark.parametrize(
    "path",
    ["", "progress", "view?effects=multipass", "model.yaml", "?effects=multipass", "without?run=x"],
)
@pytest.mark.parametrize("wrong", ["/", "//", "/%00/", "/A", "short", "last letter"])
def test_without_the_secret_of_the_address_nothing_is_shown_or_fitted(
    server: ExploreServer, path: str, wrong: str
) -> None:
    root = {"short": server.root[:-2] + "/", "last letter": server.root[:-2] + "~/"}.get(
        wrong, wrong
    )
    fitted = server.session.progress
    answer, text = ask(server, path, root=root)
    assert answer.status == 403
    assert "the whole address" in text
    assert server.root.strip("/") not in text
    assert server.session.progress == fitted


def test_each_start_has_a_secret_of_its_own(session: Session) -> None:
    with serving(session) as one, serving(session) as other:
        assert one.root != other.root
        assert len(one.root) > 20


def test_a_connection_that_says_nothing_is_closed(
    server: ExploreServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smallwheel_ros.explore.server._Handler.timeout", 0.2)
    with socket.create_connection(server.server_address[:2], timeout=60) as line:
        line.sendall(b"GET /")
        assert line.recv(4096) == b""


def test_the_model_of_a_file_with_a_name_beyond_ascii_can_be_saved(
    session: Session, tmp_path: Path
) -> None:
    named = copy.copy(session)
    named.measurements = replace(session.measurements, source='/data/песок\udcff "x".csv')
    with serving(named) as running:
        answer, text = ask(running, "/model.yaml?effects=slip_sinkage")
    assert answer.status == 200
    disposition = str(answer.getheader("Content-Disposition"))
    plain, extended = re.fullmatch(
        r"attachment; filename=\"([ -~]*)\"; filename\*=UTF-8''([!-~]*)", disposition
    ).groups()  # type: ignore[union-attr]
    assert plain == "______x__slip_sinkage.yaml"
    assert unquote(extended) == "песок_x__slip_sinkage.yaml"
    (tmp_path / "saved.yaml").write_text(text)
    assert read_model(tmp_path / "saved.yaml").provenance["data"]


def test_a_model_file_is_offered_for_download(server: ExploreServer, tmp_path: Path) -> None:
    answer, text = ask(server, "/model.yaml?effects=slip_sinkage&over=slip")
    assert answer.status == 200
    assert str(answer.getheader("Content-Disposition")).startswith(
        'attachment; filename="rig_b__slip_sinkage.yaml"'
    )
    (tmp_path / "saved.yaml").write_text(text)
    assert [e.id for e in read_model(tmp_path / "saved.yaml").model.effects] == ["slip_sinkage"]


def test_a_fit_that_fails_is_said_in_the_page(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crumble(*_: object) -> None:
        raise ValueError("<i>more than I can bear</i>")

    broken = copy.copy(session)
    monkeypatch.setattr("smallwheel_ros.explore.session.Grown.with_effect", crumble)
    broken._made = {}
    with serving(broken) as running:
        answer, text = ask(running, "/view?effects=hardpan&over=slip")
        assert answer.status == 200
        assert "more than I can bear" in json.loads(text)["problem"]
        assert "Traceback" not in text
        answer, text = ask(running, "/?effects=hardpan&over=slip")
        assert answer.status == 200
        assert "<i>" not in text
        assert ask(running, "/model.yaml?effects=hardpan")[0].status == 400
        assert "With slip sinkage" in ask(running, "/?effects=slip_sinkage")[1]


def test_where_no_known_effect_explains_a_button_looks_for_a_law(
    server: ExploreServer, rig: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, button = server.session, 'formaction="learn.html"'
    assert button not in ask(server, "/")[1]
    monkeypatch.setitem(session.document, "verdict", "unknown_effect")
    assert button in ask(server, "/")[1]
    monkeypatch.setattr(session, "measurements", read_measurements(rig).take(np.arange(9)))
    answer, page = ask(server, "/learn.html")
    assert answer.status == 200
    assert "3 settings, and a law needs 10" in page


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
        port, root = re.fullmatch(r"http://127\.0\.0\.1:(\d+)(/.+/)", url).groups()  # type: ignore[union-attr]
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=120)
        connection.request("GET", f"{root}?effects=slip_sinkage&over=slip")
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
