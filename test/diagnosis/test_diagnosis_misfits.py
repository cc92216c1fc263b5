# SPDX-License-Identifier: Apache-2.0
"""The verdict is never calm over a misfit: lack of fit, bad runs, drifts, laws that the library lacks.

Tests `bad_runs.py`, `curves.py` and `misfit.py`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain_rig import PlainRig, rolled
from threadpoolctl import threadpool_info, threadpool_limits

import smallwheel_ros as sw
from rates import _world_labs as swept
from rates import _world_misfits as misfits
from rates._world_labs import rig_table
from rates.learn_worlds import table as without_a_law
from smallwheel_ros.api.compare import compare
from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.diagnosis.bad_runs import bad_runs
from smallwheel_ros.diagnosis.misfit import at_an_end, lack_of_fit
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.diagnosis.posterior import family_of
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.constants import ALARM
from smallwheel_ros.fitting.held_out import CvErrors
from smallwheel_ros.fitting.points import MOST_POINTS
from smallwheel_ros.measurements.from_file import read_measurements
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.simulate import write_table


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables")


def read(frame: pd.DataFrame, folder: Path) -> Measurements:
    write_table(frame, folder / "rig.csv")
    return read_measurements(folder / "rig.csv")


# Lack of fit


@pytest.mark.parametrize(("seed", "setting"), [(1, "slip"), (2, "slip"), (3, "load")])
def test_one_setting_that_sinks_60_percent_deeper_is_not_adequate(
    folder: Path, seed: int, setting: str
) -> None:
    found = diagnose(read(misfits.deeper_at_one(seed, 0, setting=setting), folder))
    assert found.verdict != "adequate"
    assert "use the model" not in found.text()


def test_a_sensor_that_saturates_is_said_with_its_range(folder: Path) -> None:
    frame = misfits.saturated(1, 0, ("slip_sinkage",))
    found = diagnose(read(frame, folder)).document
    assert found["verdict"] == "unknown_effect"
    said = re.search(r"seems to saturate at ([\d.]+) mm", found["reason"])
    assert said is not None
    assert float(said[1]) == pytest.approx(frame["sinkage [mm]"].max(), rel=0.02)
    assert found["closest"] == ["slip_sinkage"]


@pytest.mark.parametrize("step", [0.0, 1.0])
def test_repeats_and_a_coarse_scale_are_no_plateau(folder: Path, step: float) -> None:
    """Equal readings at the top that a scale of whole millimetres gives by itself."""
    frame = misfits.any_lab(2, 0, ("slip_sinkage",), repeats=(4, 4))
    if step:
        frame["sinkage [mm]"] = np.maximum(np.round(frame["sinkage [mm]"] / step), 1.0) * step
    assert "saturate" not in diagnose(read(frame, folder)).document["reason"]


def test_the_f_test_rejects_a_misfit_and_not_the_truth(folder: Path) -> None:
    for by, rejected in ((0.0, False), (0.6, True)):
        problem = Problem.of(read(misfits.deeper_at_one(5, 0, by=by), folder))
        p = [m.p for m in lack_of_fit(problem.fitter, problem.fit).values()]
        assert (min(p) < 1e-3) == rejected


@pytest.mark.slow
def test_curves_of_soils_that_are_not_named_give_no_name() -> None:
    """Depth was set: firmness of the soils, 1 to 10, is no scatter of one, nor is there evidence under it."""
    path = Path(__file__).parents[2] / "examples" / "data" / "cullinan_sand" / "plates.csv"
    table = pd.read_csv(path).drop(columns=["soil", "dry_density [kg/m^3]"])
    found = sw.diagnose(table)
    assert (found.verdict, found.missing_effects, found.candidates) == ("unknown_effect", [], [])
    reason = found.document["reason"]
    assert reason.startswith(
        "runs differ by 99 % in sinkage, more than those of one soil: name the soils"
    )


@pytest.mark.parametrize("seed", range(3))
def test_p_up_to_the_alarm_is_never_adequate(folder: Path, seed: int) -> None:
    found = diagnose(read(without_a_law("speed_drag", seed, 0), folder)).document
    assert found["lack_of_fit"]["p_value"] > ALARM or found["verdict"] != "adequate"


# What helps nobody is no name


@pytest.mark.parametrize("law", ["slip_drag", "temperature_drag"])
def test_a_drag_that_the_library_lacks_is_not_given_a_name(folder: Path, law: str) -> None:
    found = diagnose(read(without_a_law(law, 1, 0), folder)).document
    assert found["missing_effects"] == []
    assert found["verdict"] != "adequate"


def test_every_name_lowers_an_error_on_runs_that_were_held_out(folder: Path) -> None:
    found = diagnose(read(misfits.any_lab(4, 0, ("slip_sinkage",)), folder))
    for before, after in zip(found.steps, found.steps[1:], strict=False):
        a, b = before.errors.rmse(), after.errors.rmse()
        assert min(b[name] / a[name] for name in a) < 0.98


def test_a_curve_speaks_for_the_family_of_fewest_drivers(folder: Path) -> None:
    """Of a wheel with lugs, a curve of slip is slip sinkage, not the digging of lugs."""
    frame = rig_table(3, 0, ("slip_sinkage",), runs=16)
    frame["grouser_height [mm]"] = np.where(np.arange(len(frame)) % 2, 8.0, 4.0)
    found = diagnose(read(frame, folder))
    assert found.search is not None
    curves = [c for c in found.search.field.competitors if c.family == "unknown:slip@sinkage"]
    assert curves
    assert {family_of(found.search, c) for c in curves} == {"slip_sinkage"}


# Digging in part


@pytest.mark.parametrize(
    "id", ["slip_sinkage", "skid_sinkage", "multipass", "slip_angle_sinkage", "grouser"]
)
def test_every_digging_effect_has_a_form_between_compacted_and_carried_away(id: str) -> None:
    forms = default_registry().family(id)
    parted = [f for f in forms if f.form.startswith("partly_dug")]
    assert parted
    sand = soil("dry_sand")
    there = Conditions.of(60.0, 0.3, 0.1, slip=-0.3 if id == "skid_sinkage" else 0.3, pass_number=3.0,
                          slip_angle=0.2, grouser_height=0.008)  # fmt: skip
    for form in parted:
        numbers = {p.name: p.start if p.start else 0.5 for p in form.parameters()}
        shares = [predict(Model(sand) + form(**(numbers | {"c": c})), there)
                  for c in (0.0, 0.5, 1.0)]  # fmt: skip
        assert np.ptp([s.sinkage[0] for s in shares]) < 1e-12
        dug_away, half, compacted = (s.resistance[0] for s in shares)
        assert dug_away < half < compacted


# Drifts


@pytest.mark.parametrize(
    ("what", "column"), [("k", "time [s]"), ("zero", "index"), ("force", "trial")]
)
def test_a_drift_over_the_day_is_said(folder: Path, what: str, column: str) -> None:
    found = diagnose(read(misfits.drifting(2, 0, what, column), folder))
    assert found.verdict != "adequate"
    name = column.partition(" ")[0]
    said = [*found.missing_effects, *found.candidates, *found.document["unknown"]]
    assert any(name in one for one in said)
    assert not any(name in p["settings"] for p in found.document["next_measurements"])


def test_time_alone_is_no_drift(folder: Path) -> None:
    found = diagnose(read(misfits.drifting(3, 0, "none"), folder))
    assert found.verdict == "adequate"
    assert "order of the runs, for drifts: time" in " ".join(found.measurements.understood)


# Bad runs


@pytest.mark.parametrize(
    ("fault", "hidden"),
    [("tenfold", ()), ("transposed", ()), ("force-tenfold", ("slip_sinkage",)), ("swapped", ())],
)
def test_a_bad_run_is_named_with_file_and_line(
    folder: Path, fault: str, hidden: Sequence[str]
) -> None:
    frame = misfits.bad_run(7, 0, fault, hidden)
    found = diagnose(read(frame, folder))
    named = {one["run"] for one in found.document["bad_runs"]}
    assert named & {*frame.attrs["bad"]}
    assert named <= {*frame.attrs["bad"]}
    line = int(np.flatnonzero(frame["run"] == min(named))[0]) + 2
    assert re.search(rf"rig\.csv, line {line}\)", found.document["reason"])
    assert "the verdict would be" in found.document["reason"]
    assert set(found.missing_effects) <= {*hidden}


@pytest.mark.parametrize("seed", range(4))
def test_in_a_clean_table_no_run_is_bad(folder: Path, seed: int) -> None:
    problem = Problem.of(read(rig_table(seed, 0, (), runs=24, rows_per_run=1), folder))
    assert bad_runs(problem.fitter, problem.fit) == []


# Size


def test_thousands_of_runs_are_judged_by_a_sample_that_is_said() -> None:
    measured = PlainRig().measure(rolled(0, 2000), 1, rows=1)
    problem = Problem.of(measured)
    assert len(problem.points) <= MOST_POINTS
    assert any("drawn at random" in note for note in problem.points.notes)


@pytest.mark.parametrize("contact", ["plate", pytest.param("pressed", marks=pytest.mark.slow)])
def test_density_of_the_rows_changes_no_verdict(folder: Path, contact: str) -> None:
    found = {
        (d.verdict, *d.missing_effects)
        for rows in (4, 40)
        if (d := diagnose(read(swept.curves(11, 0, contact=contact, rows=rows), folder)))
    }
    assert len(found) == 1


def test_plates_and_a_wheel_in_one_table_have_a_curve_in_width(folder: Path) -> None:
    """A round plate has no width; drawing the curve refused it."""
    plates = swept.curves(3, 0, contact="plate", rows=6)
    wheel = swept.curves(3, 0, contact="pressed", rows=6)
    wheel["run"] = "w" + wheel["run"].astype(str)
    wheel["sinkage [mm]"] *= 1.8  # and nothing in the library says why
    found = diagnose(read(pd.concat([plates, wheel], ignore_index=True), folder))
    assert found.verdict != "adequate"


def test_linear_algebra_has_one_thread_while_it_is_judged() -> None:
    seen: list[int] = []

    def look(step: str) -> None:
        seen.extend(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):  # whatever is set outside
        diagnose(PlainRig().measure(rolled(0, 8), 2), progress=look)
    assert seen
    assert set(seen) == {1}


# Words


@cache
def lacking() -> Diagnosis:
    return diagnose(PlainRig(slip_growth=2.0).measure(rolled(0), 1))


def test_the_text_has_a_line_for_each_channel_and_what_to_do_next() -> None:
    text = lacking().text()
    assert re.search(
        r"^  Sinkage: [\d.]+ mm -> [\d.]+ mm with what is named\.$", text, re.MULTILINE
    )
    assert re.search(r"^  Resistance: ", text, re.MULTILINE)
    assert ".save('MODEL.yaml')" in text
    following = {"apply": "smallwheel diagnose 'made up' --apply -o MODEL.yaml", "learn": ""}
    assert f"`{following['apply']}`" in replace(lacking(), following=following).text()


def test_no_text_has_a_raw_name_of_an_effect() -> None:
    ids = {*default_registry()}
    sentences = [
        lacking().document["reason"],
        *(p["text"] for p in lacking().document["next_measurements"]),
    ]
    for one in sentences:
        assert not ids & {*re.findall(r"\b\w+_\w+\b", one)}


def test_no_text_speaks_of_a_floor() -> None:
    measured = PlainRig().measure(rolled(0), 2)
    for text in (lacking().text(), compare(measured, []).text()):
        assert "floor" not in text


def test_what_a_file_holds_is_fitted(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(
        "from dataclasses import dataclass\n"
        "import numpy as np\n"
        "from smallwheel_ros.effects import Effect, parameter\n\n\n"
        "@dataclass(frozen=True)\n"
        "class Wet(Effect):\n"
        '    id = "slip_softens"\n'
        '    needs = ("slip",)\n'
        '    a: float = parameter(0.1, (-5.0, 5.0), "k lost with slip")\n\n'
        "    def modulus_factor(self, conditions):\n"
        '        return 1.0 / (1.0 + self.a**2 * np.abs(conditions["slip"]))\n'
    )
    measured = PlainRig().measure(rolled(0), 2)
    for given in (str(law), [str(law), "slip_softens"]):
        assert [e.id for e in sw.fit(measured, effects=given).model.effects] == ["slip_softens"]


def one_end(deep: float, times: int) -> tuple[Problem, CvErrors]:
    """Runs at six slips, the last `times` over; held out all are 1 mm off, those at the last `deep`."""
    slips = np.array([0.0, 0.1, 0.2, 0.3, 0.4, *([0.6] * times)])
    data = read_measurements(
        pd.DataFrame({
            "run": [f"r{i}" for i in range(slips.size)],
            "load [N]": 80.0, "diameter [mm]": 300.0, "width [mm]": 150.0, "slip": slips,
            "sinkage [mm]": 5.0 + 20.0 * slips,
        })
    )  # fmt: skip
    error = np.where(slips == 0.6, deep, 1e-3)
    return Problem.of(data), CvErrors({"sinkage": error}, np.arange(slips.size))


def test_an_error_of_one_end_of_a_setting_is_told_with_what_settles_it() -> None:
    problem, errors = one_end(8e-3, 1)
    said = at_an_end(problem.points, errors, "sinkage")
    assert said.startswith("8.00 mm at slip 0.6, the end of what was measured, 1.00 mm elsewhere")
    assert said.endswith("measure between slip 0.4 and 0.6")


@pytest.mark.parametrize(("deep", "times"), [(1.5e-3, 1), (8e-3, 2)])
def test_no_end_is_told_where_the_error_is_everywhere_or_the_end_was_repeated(
    deep: float, times: int
) -> None:
    problem, errors = one_end(deep, times)
    assert not at_an_end(problem.points, errors, "sinkage")


def test_the_error_of_a_real_wheel_with_lugs_is_one_of_its_largest_slip(shared_data: Path) -> None:
    path = shared_data / "published_wheels" / "ding2011.csv"
    if not path.exists():
        pytest.skip("needs ../shared/data/published_wheels")
    said = diagnose(path).document["channels"]["sinkage"]["finding"]
    end, elsewhere = re.findall(r"([\d.]+) mm at slip 0.6.* ([\d.]+) mm elsewhere", said)[0]
    assert float(elsewhere) < 1.0 < 5.0 < float(end)
