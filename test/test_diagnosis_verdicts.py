"""The diagnosis as a whole, in process: each verdict, two effects, the next measurement, real data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from smallwheel_ros.cli import main
from smallwheel_ros.diagnosis import add_effect, base_of, diagnose
from smallwheel_ros.diagnosis.search import plausible
from smallwheel_ros.diagnosis.text import diagnosis_text
from smallwheel_ros.diagnosis.workbench import Base
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.fitting import fit_model
from smallwheel_ros.fitting.files import calibrated
from smallwheel_ros.measurements.table import Measurements, read_measurements
from smallwheel_ros.model_file import read_model
from smallwheel_ros.simulate import RigSettings, measure, simulate_rig, write_table

OWN = """
from dataclasses import dataclass
import numpy as np
from smallwheel_ros.effects.base import Effect, parameter

@dataclass(frozen=True)
class Shaking(Effect):
    id = "shaking"
    summary = "A rig that shakes loosens the soil."
    formula = "k exp(-a s)"
    source = "this test"
    needs = ("shake",)
    a: float = parameter(0.2, (-3.0, 3.0), "loosening")

    def modulus_factor(self, conditions):
        return np.exp(-self.a * conditions["shake"])
"""


def table(folder: Path, frame: pd.DataFrame, name: str = "rig.csv") -> Measurements:
    write_table(frame, folder / name)
    return read_measurements(folder / name)


def document(folder: Path, frame: pd.DataFrame) -> Mapping[str, Any]:
    return diagnose(table(folder, frame)).document


def test_two_effects_are_found_one_after_the_other(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4001, hidden=("slip_sinkage", "multipass")))
    found = document(tmp_path, rig.table)
    assert set(found["missing_effects"]) == {"slip_sinkage", "multipass"}
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1.3 * found["channels"]["sinkage"]["noise_floor"]
    words = diagnosis_text(found)
    assert "slip sinkage" in words.splitlines()[0]
    assert "Not testable with this data" in words


def test_a_column_that_nobody_has_a_law_for_is_named(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4002, hidden=("column:density",)))
    assert document(tmp_path, rig.table)["missing_effects"] == ["covariate:density"]


def test_what_follows_nothing_recorded_gets_no_name(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4003, hidden=("unrecorded",), strength=1.5))
    found = document(tmp_path, rig.table)
    assert found["missing_effects"] == []
    assert found["verdict"] == "unknown_effect"
    assert "not recorded" in found["reason"]


def test_a_rebound_may_be_a_sensor_of_wrong_scale(tmp_path: Path) -> None:
    """A sensor that reads 20 % too much is no effect of the soil, and nothing in the data says which."""
    frame = simulate_rig(RigSettings(seed=4040)).table
    assert "scale" not in document(tmp_path, frame)["reason"]
    frame["sinkage [mm]"] *= 1.2
    found = document(tmp_path, frame)
    assert "elastic_rebound" in [*found["missing_effects"], *found["candidates"]]
    assert "wrong scale of either sensor" in found["reason"]


def test_soil_that_scatters_as_prepared_soils_do_is_adequate(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4014, soil_scatter=0.10))
    assert document(tmp_path, rig.table)["verdict"] == "adequate"


def test_an_error_of_one_channel_over_one_column_is_unknown(tmp_path: Path) -> None:
    frame = simulate_rig(RigSettings(seed=4004)).table
    rng = np.random.default_rng(0)
    warmth = dict(zip(frame["run"].unique(), rng.uniform(-1.0, 1.0, 32), strict=True))
    frame["warmth"] = frame["run"].map(warmth)
    frame["sinkage [mm]"] *= 1.0 + 0.4 * frame["warmth"]  # the sensor drifts; the soil does not
    found = document(tmp_path, frame)
    assert found["verdict"] == "unknown_effect"
    assert "sinkage over warmth" in found["reason"]
    assert any(region["region"].startswith("warmth") for region in found["where_it_fails"])


@pytest.mark.parametrize("friction", [0.0, 0.06], ids=["of any load", "of the load"])
def test_what_the_rig_itself_resists_is_no_effect_of_the_soil(
    tmp_path: Path, friction: float
) -> None:
    frame = simulate_rig(RigSettings(seed=4042)).table
    load, resistance = (next(c for c in frame if c.startswith(n)) for n in ("load", "resistance"))
    frame[resistance] += friction * frame[load] if friction else 4.0
    diagnosis = diagnose(table(tmp_path, frame))
    assert diagnosis.document["verdict"] == "unknown_effect"
    assert "resistance of the rig itself" in diagnosis.document["reason"]
    # A curve that was bent as far as it goes is not the one that is there.
    assert diagnosis.workbench is not None
    bent = [
        (explanation, effect.id)
        for explanation in diagnosis.workbench.known()
        for slot, frozen in zip(
            explanation.layout.slots, explanation.fit.solution.frozen, strict=True
        )
        if slot.of_effect and frozen
        for effect in [explanation.layout.model.effects[slot.owner]]
        if next(p for p in effect.parameters() if p.name == slot.field).neutral is None
    ]
    assert bent
    assert not any(plausible(explanation, name) for explanation, name in bent)


@pytest.mark.parametrize("seed", [4020, 4021, 4022])
def test_soil_that_is_firmest_in_the_middle_of_a_column_is_unknown(
    tmp_path: Path, seed: int
) -> None:
    """Such a soil moves both channels together, as scatter from run to run would."""
    rig = simulate_rig(RigSettings(seed=seed))
    frame, n = rig.table, rig.truth.soil.n
    runs = frame["run"].unique()
    warmth = dict(zip(runs, np.linspace(-1.0, 1.0, runs.size), strict=True))
    frame["warmth"] = frame["run"].map(warmth)
    firmer = 1.0 + 0.4 * (1.0 - frame["warmth"] ** 2)
    # z ~ k^(-2 / (2 n + 1)) and R ~ k z^(n + 1)
    frame["sinkage [mm]"] *= firmer ** (-2.0 / (2.0 * n + 1.0))
    frame["resistance [N]"] *= firmer ** (1.0 - 2.0 * (n + 1.0) / (2.0 * n + 1.0))
    found = document(tmp_path, frame)
    assert found["verdict"] == "unknown_effect"
    assert "soil stiffness over warmth" in found["reason"]
    assert found["lack_of_fit"]["p_value"] < 0.02


@pytest.mark.parametrize("hidden", [(), ("slip_sinkage",)])
def test_computed_data_without_noise_has_nothing_unknown(
    tmp_path: Path, hidden: tuple[str, ...]
) -> None:
    """What is left of it is how two programs integrate, a millionth of the value."""
    settings = RigSettings(seed=4023, hidden=hidden, noise=0.0, soil_scatter=0.0)
    found = document(tmp_path, simulate_rig(settings).table)
    assert found["missing_effects"] == list(hidden)
    assert found["verdict"] == ("missing_effect" if hidden else "adequate")


def test_a_tie_is_said_and_the_proposed_runs_break_it(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4005, hidden=("slip_sinkage",), tie=("slip", "load")))
    tied = document(tmp_path, rig.table)
    assert tied["verdict"] == "indistinguishable"
    assert {"slip_sinkage", "load_dependent_modulus"} <= set(tied["candidates"])
    proposal = tied["next_measurements"][0]
    assert proposal["expected_power"] > 0.9
    runs = measure(rig.truth, [proposal["settings"]] * proposal["runs"])
    decided = document(tmp_path, pd.concat([rig.table, runs], ignore_index=True))
    assert decided["missing_effects"] == ["slip_sinkage"]


def test_sinkage_alone_cannot_tell_width_from_load(tmp_path: Path) -> None:
    settings = RigSettings(seed=4006, hidden=("width_dependent_modulus",), channels=("sinkage",))
    found = document(tmp_path, simulate_rig(settings).table)
    assert found["verdict"] == "indistinguishable"
    assert {"width_dependent_modulus", "load_dependent_modulus"} <= set(found["candidates"])


def test_outliers_neither_make_an_effect_nor_hide_one(tmp_path: Path) -> None:
    none = simulate_rig(RigSettings(seed=4007, outliers=0.02))
    found = document(tmp_path, none.table)
    assert found["missing_effects"] == []
    assert any("outliers" in note for note in found["notes"])
    slip = simulate_rig(RigSettings(seed=4007, outliers=0.02, hidden=("slip_sinkage",)))
    assert document(tmp_path, slip.table)["missing_effects"] == ["slip_sinkage"]


def test_everything_constant_is_insufficient(tmp_path: Path) -> None:
    rows = 12
    frame = pd.DataFrame(
        {
            "run": [f"r{i}" for i in range(rows)],
            "load": 50.0,
            "diameter": 0.2,
            "width": 0.1,
            "sinkage": np.random.default_rng(1).normal(0.01, 2e-4, rows),
        }
    )
    found = document(tmp_path, frame)
    assert found["verdict"] == "insufficient_data"
    assert "vary at least the load" in found["reason"]
    words = diagnosis_text(found)
    assert "nothing was held out" in words
    assert "Held-out error" not in words


def test_one_row_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("load,diameter,width,sinkage\n50,0.2,0.1,0.01\n")
    written = tmp_path / "one.json", tmp_path / "one.html"
    arguments = ["--json", str(written[0]), "--html", str(written[1])]
    result = CliRunner().invoke(main, ["diagnose", str(tmp_path / "one.csv"), *arguments])
    assert result.exit_code == 0, result.output
    found = json.loads(written[0].read_text())
    assert found["verdict"] == "insufficient_data"
    assert found["reason"].startswith("1 run: ")
    assert found["steps"] == [{"added": None, "held_out_rmse": {}}]
    assert {row["status"] for row in found["ranking"]} == {"not_testable"}
    assert written[1].is_file()
    assert "nan" not in result.output.lower().split()


def test_a_base_that_has_the_effect_is_adequate(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4008, hidden=("multipass",)))
    measurements = table(tmp_path, rig.table)
    named = diagnose(measurements)
    assert named.document["missing_effects"] == ["multipass"]
    base = Base(effects=named.fitted(1).model.effects)
    again = diagnose(measurements, base)
    assert again.document["verdict"] == "adequate"


def test_commands_from_fit_to_the_effect_added(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4009, hidden=("slip_sinkage",)))
    data, run = tmp_path / "rig.csv", CliRunner()
    write_table(rig.table, data)
    model, better = tmp_path / "m.yaml", tmp_path / "m2.yaml"
    fitted = run.invoke(main, ["fit", str(data), "-o", str(model)])
    assert fitted.exit_code == 0, fitted.output
    held_out = read_model(model).provenance["held_out_rmse"]
    in_sample = fit_model(read_measurements(data)).noise["sinkage"].absolute
    assert set(held_out) == {"sinkage", "resistance"}
    assert held_out["sinkage"] > in_sample
    common = ["--model", str(model), "--data", str(data), "-o", str(better)]
    added = run.invoke(main, ["add", "slip_sinkage", *common])
    assert added.exit_code == 0, added.output
    assert "recommended: the error fell" in added.output
    assert [e.id for e in read_model(better).model.effects] == ["slip_sinkage"]
    useless = run.invoke(main, ["add", "penetration_rate", *common])
    assert useless.exit_code == 0, useless.output
    assert "not recommended" in useless.output
    for effect, said in (
        ("slip_sinkag", "slip_sinkage"),
        ("grouser", "grouser_height"),
        ("covariate:speed", "'speed' is a known setting, and those have effects of their own (pen"),
        ("covariate:load", "(load_dependent_modulus): add one of them"),
        ("covariate:moistness", "no column 'moistness' of numbers"),
        ("covariate:sinkage", "'sinkage' is what was measured"),
        ("covariate:wheel", "'wheel' is text"),
    ):
        wrong = run.invoke(main, ["add", effect, *common])
        assert wrong.exit_code == 2
        assert said in wrong.output


def test_a_fit_of_one_run_has_no_held_out_error(tmp_path: Path) -> None:
    frame = simulate_rig(RigSettings(seed=4009)).table
    write_table(frame[frame["run"] == frame["run"][0]], tmp_path / "one.csv")
    model = tmp_path / "m.yaml"
    done = CliRunner().invoke(main, ["fit", str(tmp_path / "one.csv"), "-o", str(model)])
    assert done.exit_code == 0, done.output
    assert "held_out_rmse" not in read_model(model).provenance


def test_apply_writes_the_model_pictures_and_report(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4010, hidden=("multipass",)))
    data, model, html, plots = (tmp_path / n for n in ("rig.csv", "m.yaml", "r.html", "plots"))
    write_table(rig.table, data)
    arguments = ["diagnose", str(data), "--apply", "-o", str(model)]
    result = CliRunner().invoke(main, [*arguments, "--html", str(html), "--plots", str(plots)])
    assert result.exit_code == 0, result.output
    assert [e.id for e in read_model(model).model.effects] == ["multipass"]
    assert "held_out_rmse" in read_model(model).provenance
    assert html.read_text().lstrip().startswith("<!")
    names = {path.name for path in plots.iterdir()}
    assert {"staircase.png", "residuals.png", "ranking.png"} <= names


def test_options_that_do_not_go_together(tmp_path: Path) -> None:
    data = tmp_path / "rig.csv"
    write_table(simulate_rig(RigSettings(seed=4011)).table, data)
    for options in (["--apply"], ["-o", str(tmp_path / "m.yaml")]):
        result = CliRunner().invoke(main, ["diagnose", str(data), *options])
        assert result.exit_code == 2
        assert "--apply and -o" in result.output
    nowhere = str(tmp_path / "no" / "m.yaml")
    result = CliRunner().invoke(main, ["fit", str(data), "-o", nowhere])
    assert result.exit_code == 2
    assert "does not exist" in result.output


def test_an_effect_of_ones_own_is_ranked_and_named(tmp_path: Path) -> None:
    frame = simulate_rig(RigSettings(seed=4012)).table
    rng = np.random.default_rng(2)
    shake = frame["run"].map(
        dict(zip(frame["run"].unique(), rng.uniform(0.0, 1.0, 32), strict=True))
    )
    frame["shake"] = shake
    # as a softer soil would: sinkage by k^(-1/(n+1/2)), resistance by half of that; n about 0.9
    frame["sinkage [mm]"] *= np.exp(0.6 * shake / 1.4)
    frame["resistance [N]"] *= np.exp(0.3 * shake / 1.4)
    data, own = tmp_path / "rig.csv", tmp_path / "own.py"
    write_table(frame, data)
    own.write_text(OWN)
    result = CliRunner().invoke(main, ["diagnose", str(data), "--effects", str(own)])
    assert result.exit_code == 0, result.output
    assert "shaking" in result.stdout.splitlines()[0]


def test_an_effect_that_the_data_cannot_have_is_refused(tmp_path: Path) -> None:
    measurements = table(tmp_path, simulate_rig(RigSettings(seed=4013)).table)
    with pytest.raises(EffectError, match="grouser_height"):
        add_effect("grouser", Base(), measurements)


@pytest.fixture(scope="module")
def rig_data(shared_data: Path) -> tuple[Measurements, Base]:
    folder = shared_data / "cmu_wheel_rig"
    whole = read_measurements(folder / "indentation.csv")
    pressed = whole.take(whole.conditions.contact == "pressed")
    rolling = read_measurements(folder / "rolling_smooth_wheel.csv")
    rolling = rolling.take(np.abs(rolling.conditions["slip_angle"]) < 0.01)
    return rolling, base_of(calibrated(fit_model(pressed), pressed), rolling)


def test_recorded_wheel_calibrated_by_pressing_lacks_slip_and_skid(
    rig_data: tuple[Measurements, Base],
) -> None:
    rolling, base = rig_data
    assert base.priors
    found = diagnose(rolling, base).document
    assert set(found["missing_effects"]) == {"slip_sinkage", "skid_sinkage"}
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert 0.011 < errors[0] < 0.016
    assert errors[-1] < 0.002
    blind = {r["effect"]: r["reason"] for r in found["ranking"] if r["status"] == "not_testable"}
    for name in ("width_dependent_modulus", "load_dependent_modulus", "multipass"):
        assert name in blind
    assert any("one wheel diameter" in note for note in found["notes"])


def test_recorded_wheel_at_all_slip_angles(shared_data: Path) -> None:
    folder = shared_data / "cmu_wheel_rig"
    whole = read_measurements(folder / "indentation.csv")
    pressed = whole.take(whole.conditions.contact == "pressed")
    rolling = read_measurements(folder / "rolling_smooth_wheel.csv")
    base = base_of(calibrated(fit_model(pressed), pressed), rolling)
    found = diagnose(rolling, base).document
    named = ["slip_angle_sinkage", "skid_sinkage", "slip_sinkage"]
    assert set(found["missing_effects"]) == set(named)
    errors = [step["held_out_rmse"]["sinkage"] for step in found["steps"]]
    assert errors[0] > 0.012
    assert errors[-1] < 0.003
    assert any("|slip|" in region["region"] for region in found["where_it_fails"])
    assert any("deeper than its axle" in note for note in found["notes"])


def test_a_model_with_an_effect_is_diagnosed_and_added_to(tmp_path: Path) -> None:
    rig = simulate_rig(RigSettings(seed=4015, hidden=("slip_sinkage", "multipass")))
    data, first, second = (str(tmp_path / n) for n in ("rig.csv", "first.yaml", "second.yaml"))
    write_table(rig.table, tmp_path / "rig.csv")
    run = CliRunner()
    assert run.invoke(main, ["fit", data, "--effects", "multipass", "-o", first]).exit_code == 0
    added = run.invoke(
        main, ["add", "slip_sinkage", "--model", first, "--data", data, "-o", second]
    )
    assert added.exit_code == 0, added.output
    assert [e.id for e in read_model(second).model.effects] == ["multipass", "slip_sinkage"]
    again = run.invoke(main, ["diagnose", data, "--model", first, "--plots", str(tmp_path / "p")])
    assert again.exit_code == 0, again.output
    assert "The model lacks slip sinkage." in again.output
