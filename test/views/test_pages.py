# SPDX-License-Identifier: Apache-2.0
"""Tests `comparison.py`, `diagnosis.py`, `notes.py`, `page.py`, `parameters.py`, `plots.py`,
`ratio.py`, `report.py` and `svg.py`."""

from __future__ import annotations

import base64
import copy
import hashlib
import json
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.common.files import OutputError
from smallwheel_ros.compare.comparison import Comparison, comparison_of
from smallwheel_ros.compare.contenders import Contender
from smallwheel_ros.compare.resistance_ratio import resistance_ratio
from smallwheel_ros.diagnosis.document import failing_settings
from smallwheel_ros.measurements.display import effect_words, to_tell
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table
from smallwheel_ros.views import comparison as compared_view
from smallwheel_ros.views import diagnosis as diagnosed_view
from smallwheel_ros.views import report
from smallwheel_ros.views.blocks import Callout, Column, Details, Section, Table, Text
from smallwheel_ros.views.notes import grouped
from smallwheel_ros.views.page import Page, embedded, html_of, inline
from smallwheel_ros.views.plots import Panel

DOCUMENT: dict[str, Any] = json.loads(
    (Path(__file__).parents[1] / "data" / "diagnosis_document.json").read_text()
)
DOCUMENT |= {"warnings": DOCUMENT.get("warnings", []), "notes": DOCUMENT.get("notes", [])}
DOCUMENT["ranking"] = [{"form": ""} | row for row in DOCUMENT["ranking"]]
EVIL = '<script>document.title="evil"</script><img src=x onerror=alert(1)> $x^{ "&\' \u202e\u2028'


def diagnosed_as(document: dict[str, Any]) -> Any:
    """A diagnosis of which there is only the document."""
    data = read_measurements(
        pd.DataFrame({"load": [20.0, 30.0], "diameter": 0.2, "width": 0.1, "sinkage": [0.01, 0.02]})
    )
    return SimpleNamespace(
        document=document, measurements=data, steps=[], search=None, following=None
    )


def whole_report(document: dict[str, Any], comparison: Comparison | None = None) -> str:
    found = diagnosed_as(document)
    if comparison is None:
        return html_of(diagnosed_view.page(found))
    found.measurements = comparison.measurements
    return html_of(report.page(found, comparison))


class Parsed(HTMLParser):
    """The tags and the text of a page; fails on tags that do not close."""

    VOID = ("meta", "link", "img", "br", "input")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.scripts: list[str] = []
        self.feed(html)
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """A simulated table whose every free text is hostile."""
    table = simulate_rig(RigSettings(seed=3, runs=12, hidden=("slip_sinkage",))).table
    table["soil"] = EVIL
    table["wheel"] = table["wheel"] + EVIL
    table[f"wet{EVIL}"] = np.linspace(0.1, 0.9, len(table))
    table[f"who{EVIL}"] = EVIL
    path = tmp_path_factory.mktemp("rig") / "rig<b>.csv"
    write_table(table, path)
    data = read_measurements(path)
    soft = Contender("soft" + EVIL, "a model file" + EVIL, Model(Soil("mud", 3e3, 0.8, 0.4)))
    return comparison_of(data, [soft])


@pytest.fixture(scope="module")
def compared(comparison: Comparison) -> str:
    return html_of(compared_view.page(comparison))


@pytest.fixture(scope="module")
def compared_again(comparison: Comparison) -> str:
    return html_of(compared_view.page(comparison))


@pytest.fixture(scope="module")
def diagnosed() -> str:
    document = copy.deepcopy(DOCUMENT)
    document["ranking"][0]["effect"] = "covariate:" + EVIL
    document["ranking"][0]["reason"] = EVIL
    document["where_it_fails"][0]["region"] = EVIL
    document["next_measurements"][0]["settings"] = {EVIL: EVIL}
    document["steps"][1]["added"] = "covariate:" + EVIL
    document["missing_effects"] = ["covariate:" + EVIL]
    document["warnings"] = document["notes"] = [EVIL]
    return whole_report(document)


def assert_harmless(html: str) -> Parsed:
    parsed = Parsed(html)
    names = [tag for tag, _ in parsed.tags]
    # the data and the script that sets points in, where models can be chosen
    assert names.count("script") == (2 if "data-models=" in html else 0)
    assert not {"iframe", "img", "image"} & set(names)
    for tag, attributes in parsed.tags:
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        for name in ("src", "href", "xlink:href"):
            target = attributes.get(name)
            assert target is None or target.startswith(("data:", "#")), target
    data, script = parsed.scripts or ("[]", "")
    json.loads(data)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policies = [a.get("content") for t, a in parsed.tags if t == "meta" and "http-equiv" in a]
    assert policies == [
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    ]
    assert not re.search(r"url\((?!#)", html)  # of the plots' own parts alone
    assert "@import" not in html
    return parsed


@given(st.recursive(st.text() | st.none() | st.integers(), lambda e: st.dictionaries(st.text(), e)))
def test_nothing_breaks_out_of_the_data(value: Any) -> None:
    text = embedded({"value": value})
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == {"value": value}


def test_a_comparison_with_hostile_names_makes_a_harmless_page(compared: str) -> None:
    parsed = assert_harmless(compared)
    assert EVIL in parsed.text  # shown as it is
    for title in ("In short", "The data", "The models", "Where it fails", "What to keep in mind"):
        assert title in parsed.text
    for name in ("Bekker", "Meirion-Griffith & Spenko", "contact integral"):
        assert name in parsed.text
    assert re.search(r"\bnan\b", parsed.text) is None


def test_a_diagnosis_with_hostile_names_makes_a_harmless_page(diagnosed: str) -> None:
    parsed = assert_harmless(diagnosed)
    assert EVIL in parsed.text


def test_the_same_comparison_gives_the_same_bytes(compared: str, compared_again: str) -> None:
    assert compared_again == compared


def test_the_story_says_which_model_is_best_and_where_it_fails(compared: str) -> None:
    text = Parsed(compared).text
    found = re.search(
        r"Sinkage: no law has less error than a log-log regression, which contains no physics: "
        r"([^,:]+), the best of them, has ([\d.]+) mm, the regression ([\d.]+) mm",
        text,
    )
    assert found is not None
    assert found[1] in ("Bekker", "Meirion-Griffith & Spenko", "contact integral")
    assert 0.0 < float(found[3]) < float(found[2])
    assert "of a true model" not in text  # that is for a diagnosis to say
    assert "sinks to the axle in" in text  # of the soft model
    assert "worst first" in text


# The diagnosis' page, verdict by verdict


@pytest.mark.parametrize(
    ("verdict", "more", "words"),
    [
        ("missing_effect", {}, "The model lacks slip sinkage and bulldozing"),
        ("adequate", {"missing_effects": []}, "Nothing is missing that this data could show"),
        (
            "unknown_effect",
            {"missing_effects": [], "candidates": []},
            "no effect of the library explains it",
        ),
        (
            "unknown_effect",
            {"missing_effects": [], "candidates": ["sinkage_offset"]},
            "Something may be missing: sinkage offset. This data does not confirm it",
        ),
        (
            "unknown_effect",
            {"missing_effects": [], "candidates": ["sinkage_offset", "load_offset"]},
            "Something may be missing: sinkage offset or load offset. This data does not confirm any of",
        ),
        (
            "indistinguishable",
            {"missing_effects": [], "candidates": ["slip_sinkage", "penetration_rate"]},
            "Something is missing: slip sinkage or penetration rate",
        ),
        ("insufficient_data", {"missing_effects": []}, "Too little data for a verdict"),
    ],
)
def test_every_verdict_is_said_in_words(verdict: str, more: dict[str, Any], words: str) -> None:
    parsed = Parsed(whole_report({**DOCUMENT, "verdict": verdict, **more}))
    assert words in parsed.text


def test_the_diagnosis_tells_errors_limits_and_what_to_measure() -> None:
    text = Parsed(whole_report(DOCUMENT)).text
    assert "Sinkage: 4.30 mm → 0.900 mm with what is named" in text
    assert "the table has no column 'grouser_height'" in text
    assert "load 60 N, slip 0 to 0.4" in text
    assert "hardpan from moisture" in text
    assert "slip sinkage: Sweep slip at one load." in text
    assert "Measure a second pass." not in text  # of what nobody suspects
    assert "slip > 0.32" in text
    assert "|slip angle| > 28.6 deg" in text
    assert "1.32" in text
    assert "stiffness differs by 5 %; in addition, sinkage by 2 %." in text


def test_numbers_are_those_of_the_document() -> None:
    """No p under 1 / (replicates + 1) is claimed, and nothing is minus zero."""
    text = Parsed(whole_report(DOCUMENT)).text
    assert "p at most 0.005." in text
    assert "under 1e" not in text
    assert "-0 %" not in text
    assert "0 %" in table_row(text, "multipass")


def test_an_error_of_the_instrument_is_visibly_one() -> None:
    document = {**DOCUMENT, "verdict": "indistinguishable", "missing_effects": [],
                "candidates": ["penetration_rate", "sinkage_offset"]}  # fmt: skip
    text = Parsed(whole_report(document)).text
    assert "Something is missing: penetration rate or sinkage offset" in text
    assert "Sinkage offset: the instrument, not the soil." in text
    assert "instrument" in table_row(text, "sinkage offset")
    assert "1.200" in text  # mm
    assert "the instrument, not the soil" not in Parsed(whole_report(DOCUMENT)).text


def table_row(text: str, name: str) -> str:
    """What follows the last mention of a name in the ranking."""
    return text.split("probabilityerror removed")[1].split(name)[1][:60]


def test_what_is_left_and_curves_are_shown_where_they_lead_on() -> None:
    named = whole_report(DOCUMENT)
    assert "Residuals of the best explanation" not in named
    adequate = {**DOCUMENT, "verdict": "adequate", "missing_effects": [], "candidates": []}
    unknown = {**adequate, "verdict": "unknown_effect", "unknown": ["unknown:slip_angle@sinkage"]}
    for document in (adequate, unknown):
        text = Parsed(whole_report(document)).text.replace("\u00a0", " ")
        assert "5.73 deg: 0.0 ± 1.0 %" in text  # never -0.0
        assert "28.6 deg: +8.0 ± 2.0 %" in text
        assert "smooth: -2.1 ± 1.1 %" in text
        assert "lugged: +3.0 %" in text
    curves = [f for f in diagnosed_view.page(diagnosed_as(unknown)).figures() if f.name == "curves"]
    (panel,) = curves[0].panels
    assert panel.x == "slip angle [deg]"
    np.testing.assert_allclose(np.asarray(panel.layers[1].x)[-1], np.degrees(0.6))
    assert "curves" not in [f.name for f in diagnosed_view.page(diagnosed_as(adequate)).figures()]


@pytest.mark.parametrize(
    ("stage", "unit", "label", "scale"),
    [
        ("height", "m", "length added to the shown sinkage [mm]", 1e3),
        ("force", "N", "force added to the resistance [N]", 1.0),
        ("drag", "1", "share of the load added to the resistance", 1.0),
    ],
)
def test_a_curve_that_is_added_is_drawn_in_its_unit_about_0(
    stage: str, unit: str, label: str, scale: float
) -> None:
    (factor,) = DOCUMENT["curves"]
    (drawn,) = curve_panels(DOCUMENT)
    assert (drawn.y, [*drawn.layers[0].y]) == (f"factor on {factor['stage']}", [1.0, 1.0])
    added = {"setting": "slip", "stage": stage, "unit": unit, "x": [0.0, 0.5],
             "added": [0.0, 0.002], "low": [0.0, 0.001], "high": [0.0, 0.003]}  # fmt: skip
    (panel,) = curve_panels({**DOCUMENT, "curves": [added]})
    assert panel.y == label
    none, line = panel.layers
    assert [*none.y] == [0.0, 0.0]
    np.testing.assert_allclose(
        [line.y[1], line.low[1], line.high[1]], scale * np.array([2e-3, 1e-3, 3e-3])
    )


def curve_panels(document: dict[str, Any]) -> list[Panel]:
    unknown = {**document, "verdict": "unknown_effect", "missing_effects": [], "candidates": []}
    unknown |= {"unknown": ["unknown:slip@sinkage"]}
    (figure,) = (
        f for f in diagnosed_view.page(diagnosed_as(unknown)).figures() if f.name == "curves"
    )
    return figure.panels


def test_a_curve_without_a_name_is_said_in_words() -> None:
    assert effect_words("unknown:slip < 0@sinkage") == (
        "something that follows slip < 0 (at the sinkage)"
    )


def test_runs_tell_two_effects_apart_or_whether_one_is_missing() -> None:
    assert to_tell(("slip_sinkage", "rig_friction")) == "slip sinkage from rig friction"
    for one in (("none", "sinkage_offset"), ("sinkage_offset", "none")):
        assert to_tell(one) == "whether sinkage offset is missing"
    assert to_tell(()) == ""


def test_a_bare_document_is_enough() -> None:
    bare = {
        "schema": 1,
        "verdict": "insufficient_data",
        "missing_effects": [],
        "candidates": [],
        "channels": {},
        "lack_of_fit": {"p_value": None},
        "where_it_fails": [],
        "ranking": [],
        "steps": [{"added": None, "held_out_rmse": {}}],
        "next_measurements": [],
        "notes": [],
        "warnings": [],
    }
    text = Parsed(whole_report(bare)).text
    assert "Too little data for a verdict" in text
    assert "Where the model fails" not in text  # empty sections are left out


def test_the_noise_floor_is_not_passed_off_as_the_spread_of_repeats() -> None:
    text = Parsed(whole_report(DOCUMENT)).text
    assert "the held-out error that the true model would leave" in text
    assert "the scatter from run to run" in text
    assert "repeats differ by" not in text
    assert "may be taken for scatter" not in text
    unknown = {**DOCUMENT, "verdict": "unknown_effect", "missing_effects": []}
    assert "may be taken for scatter" in Parsed(whole_report(unknown)).text
    document = copy.deepcopy(DOCUMENT)
    document["channels"]["sinkage"]["repeatability"] = 0.000432
    text = Parsed(whole_report(document)).text
    assert "repeats differ by" in text
    assert "0.432 mm" in text


def test_with_too_little_data_no_error_is_called_held_out() -> None:
    document = {**DOCUMENT, "verdict": "insufficient_data", "missing_effects": []}
    text = Parsed(whole_report(document)).text
    assert "step by step" not in text
    assert "Errors of the diagnosis are held out" not in text
    assert "Errors of the diagnosis are held out" in Parsed(whole_report(DOCUMENT)).text


# Both in one


def test_the_settings_in_which_it_fails_are_found_whatever_they_are_called() -> None:
    regions = ["slip > 0.3", "|slip| > 0.5", "slip_angle > 0.2", f"wet{EVIL} < 0.2", "soil x"]
    document = {"where_it_fails": [{"region": r, "channel": "sinkage"} for r in regions]}
    settings = ["load", "slip", "slip_angle", f"wet{EVIL}"]
    assert failing_settings(document, settings) == [
        ("sinkage", "slip"), ("sinkage", "slip_angle"), ("sinkage", f"wet{EVIL}")]  # fmt: skip
    assert failing_settings({}, settings) == []


def test_the_whole_report_tells_the_story_in_order(comparison: Comparison) -> None:
    document = copy.deepcopy(DOCUMENT)
    document["channels"] = {
        "sinkage": {"rows": 36, "rmse": 0.004, "bias": 0.001, "noise_floor": 0.00123,
                    "noise_floor_source": "repeats", "repeatability": 0.000456},
        "resistance": {"rows": 36, "rmse": 4.0, "bias": 1.0, "noise_floor": None,
                       "noise_floor_source": None},
    }  # fmt: skip
    html = whole_report(document, comparison=comparison)
    parsed = assert_harmless(html)
    titles = ["In short", "The data", "Models side by side", "Where the model fails",
              "Which effect is missing", "Held-out error, step by step",
              "What this data cannot tell", "What to measure next",
              "What to keep in mind"]  # fmt: skip
    headings = re.findall(r"<h2>(.*?)</h2>", html)
    assert headings == titles
    text = parsed.text
    assert "1.23" in text  # the floor of the diagnosis, not what repeats differ by
    assert "times the expected error of a true model, 1.23 mm" in text
    assert "0.456" in text
    assert "could not tell noise from misfit" in text  # of resistance
    assert text.index("The model lacks slip sinkage") < text.index("Bekker")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("the data has no column 'grouser_height'", "the data has no column 'grouser_height'"),
        ("add `--effects slip_sinkage` to it", "add --effects slip_sinkage to it"),
        ("a/slip_sinkage.yaml, my_slip_angle, sand_1", "a/slip_sinkage.yaml, my_slip_angle, sand_1"),
        ("1.68e+07 Pa, 3.0e-05, -2e+06", "1.68·10⁷ Pa, 3.0·10⁻⁵, -2·10⁶"),
        ("run 1e5, 0x1e-3, v1.2e+3", "run 1e5, 0x1e-3, v1.2e+3"),
        ("4.30 mm -> 0.900 mm", "4.30 mm → 0.900 mm"),
    ],
)  # fmt: skip
def test_pages_say_names_and_numbers_as_people_do(text: str, shown: str) -> None:
    html = inline(text)
    assert unescape(re.sub("<[^>]+>", "", html)) == shown
    assert ("<code>" in html) == ("`" in text)
    assert Text(text).lines() == [text]  # on the terminal as it was: names there are for pasting


@given(st.text(st.sampled_from("ab<>&'\"`_. \u202e"), max_size=40))
@settings(max_examples=examples(300))
def test_whatever_stands_between_backticks_is_text(text: str) -> None:
    html = inline("x" + text)
    bare = html.replace("<code>", "").replace("</code>", "")
    assert "<" not in bare
    pairs = re.sub("`([^`]+)`", r"\1", "x" + text)
    assert unescape(bare) == pairs


@pytest.mark.parametrize(("suffix", "place"), [(".csv", "line"), (".xlsx", "row")])
def test_a_page_says_line_of_a_text_file_and_row_of_a_sheet(
    tmp_path: Path, suffix: str, place: str
) -> None:
    table = simulate_rig(RigSettings(seed=3, runs=12)).table
    column = next(name for name in table if name.startswith("sinkage"))
    table.loc[4, column] /= 4.0
    path = tmp_path / f"rig{suffix}"
    table.to_excel(path, index=False) if suffix == ".xlsx" else table.to_csv(path, index=False)
    read = read_measurements(path)
    assert read.place == read.take([0]).place == place
    html = html_of(compared_view.page(comparison_of(read)))
    other = {"line": "row", "row": "line"}[place]
    assert re.search(rf"\b{place}s? 6\b", html)
    assert not re.search(rf"\b{other}s? \d", html)


# Building blocks


# Pictures


# Building blocks


def test_blocks_escape_and_keep_their_text() -> None:
    table = Table([Column(EVIL, "a"), Column("b", "b", right=True)], [{"a": EVIL, "b": 1}], EVIL,
                  strong=lambda row: True)  # fmt: skip
    blocks = [
        Text(EVIL, [EVIL]),
        Callout(EVIL, [EVIL], "warning"),
        table,
        Details(EVIL, [Text(EVIL)]),
    ]
    parsed = Parsed(html_of(Page(EVIL, [Section(EVIL, blocks)], EVIL, EVIL)))
    assert not {"script", "img"} & {tag for tag, _ in parsed.tags}
    # title, heading, subtitle, link, section's heading, the blocks' nine, footer
    assert parsed.text.count(EVIL) == 5 + 9 + 1


def test_a_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "a.html"
    Page("one", []).write(target)
    Page("two", []).write(target)
    assert "two" in target.read_text()
    assert [p.name for p in tmp_path.iterdir()] == ["a.html"]
    with pytest.raises(OutputError):
        Page("x", []).write(tmp_path / "no" / "a.html")


def test_notes_of_one_kind_are_one_line() -> None:
    rest = "is not determined by this data: vary the load"
    tied = "are tied (correlation {}): this data tells a combination of them"
    notes = [f"sand.n {rest}", "some rows are out", f"slip_sinkage.a {rest}", f"sand.n {rest}",
             f"a.x and b.y {tied.format(0.99)}", f"a.x and c.z {tied.format(0.98)}"]  # fmt: skip
    assert grouped(notes) == [
        "sand.n and slip_sinkage.a are not determined by this data: vary the load.",
        "Some rows are out.",
        "Tied are a.x and b.y (correlation 0.99); a.x and c.z (correlation 0.98): this data tells a "
        "combination of them.",
    ]


# Pictures


def test_measured_over_predicted_has_every_model_and_moves_no_row(comparison: Comparison) -> None:
    axes = comparison.plot(channel="sinkage")
    assert len(axes.get_legend().get_texts()) == len(comparison.models) == 6
    measured = 1e3 * comparison.measurements.channels["sinkage"]
    (low, high), beyond = axes.get_xlim(), 0
    for points, model in zip(axes.collections, comparison.models, strict=True):
        errors = (model.held_out or model.in_sample).error["sinkage"]
        known = np.isfinite(errors)
        shown = np.asarray(points.get_offsets())
        predicted = measured[known] - 1e3 * errors[known]
        inside = (predicted >= low) & (predicted <= high)
        beyond += int(np.count_nonzero(~inside))
        np.testing.assert_allclose(shown[:, 0], predicted[inside])
        np.testing.assert_allclose(shown[:, 1], measured[known][inside])
    assert beyond > 0
    assert f"({beyond} points beyond the axes)" in axes.get_title(loc="left")


def test_the_first_screen_is_the_answer() -> None:
    notes = [
        f"sand.p{i} is at its bound, {i}: the data favours values beyond it" for i in range(40)
    ]
    lines = diagnosed_view.text(diagnosed_as({**DOCUMENT, "notes": notes})).splitlines()
    assert lines[0].startswith("The model lacks slip sinkage")
    assert any("4.30 mm" in line for line in lines)
    assert any(line.startswith("  Next: ") for line in lines)
    assert "--full" in lines[-1]
    assert len(lines) <= 25


def test_resistance_ratio_is_exact_for_compaction_alone() -> None:
    conditions = Conditions.of(np.linspace(5, 200, 20), 0.3, 0.1)
    exact = predict(Model(Soil("s", 1e6, 1.0)), conditions)
    data = Measurements(conditions, {"sinkage": exact.sinkage, "resistance": exact.resistance},
                        np.arange(20).astype(np.str_), np.full(20, "w"), np.arange(20))  # fmt: skip
    found = resistance_ratio(data)
    assert found is not None
    line = np.interp(found.x, found.line_x, found.lines[1.0])
    np.testing.assert_allclose(found.y, line, rtol=2e-3)
    assert resistance_ratio(data.take(np.zeros(20, dtype=bool))) is None
