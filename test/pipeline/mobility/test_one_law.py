# SPDX-License-Identifier: Apache-2.0
"""One model file, two doors: the bench's prediction and the robot's estimate are one number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.api.predict import predict
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.model import Geometry, Model
from smallwheel_ros.model.model_file import CalibratedModel, write_model
from smallwheel_ros.onboard.parameters import ParametersError, settings_from
from smallwheel_ros.physics.soil import REFERENCE_DIAMETER, REFERENCE_SINKAGE, SOILS, Soil, soil
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.tables import Estimates

SPEED = 0.1  # m/s
WHEELS = st.fixed_dictionaries(
    {
        "load": st.floats(5.0, 300.0),
        "diameter": st.floats(0.1, 0.6),
        "width": st.floats(0.05, 0.25),
        "slip": st.one_of(st.floats(0.0, 0.9), st.floats(-0.8, -0.05)),
    }
)


@st.composite
def soils(draw: st.DrawFn) -> Soil:
    """Soils as files have them; k from a pressure of 5 to 300 kPa at the reference."""
    n, m = draw(st.floats(0.2, 1.8)), draw(st.floats(-0.8, 0.8))
    pressure = np.exp(draw(st.floats(np.log(5e3), np.log(3e5))))
    k = pressure * REFERENCE_SINKAGE**-n * REFERENCE_DIAMETER**-m
    return Soil(
        "own", float(k), n, m, draw(st.floats(0.0, 8e3)), draw(st.floats(0.2, 0.9)),
        draw(st.floats(1e-3, 0.06)), "", draw(st.floats(0.0, 3.0)), draw(st.floats(0.4, 1.2)),
        draw(st.floats(0.0, 0.6)),
    )  # fmt: skip


EFFECTS = st.sampled_from(
    [(), ("slip_sinkage",), ("bulldozing",), ("hardpan",), ("sinkage_offset",), ("load_gain",),
     ("load_dependent_modulus", "slip_sinkage"), ("hardpan", "skid_sinkage")]
)  # fmt: skip


FITTED = ("cohesion", "friction_angle", "log_shear_displacement", "rolling_share", "rim_friction")
DEVIATIONS = (200.0, 0.02, 0.2, 0.2, 0.05)


@st.composite
def models(draw: st.DrawFn) -> CalibratedModel:
    """Model files: strength measured or not; decided, or two or three models not told apart."""
    geometry: Geometry = draw(st.sampled_from(["contact_integral", "closed_form"]))
    own = draw(soils())
    decided = Model(own, geometry, draw(EFFECTS))
    names, covariance = [], np.empty((0, 0))
    if draw(st.booleans()):
        names = [f"own.{name}" for name in FITTED]
        covariance = np.diag(np.square(DEVIATIONS))
    rivals = []
    if draw(st.booleans()):
        shares = draw(st.lists(st.floats(0.1, 1.0), min_size=2, max_size=3))
        for share in shares:
            # As a diagnosis finds them: about the same soil, with other effects.
            like = replace(
                own, k=own.k * draw(st.floats(0.8, 1.25)), n=own.n + draw(st.floats(-0.05, 0.05))
            )
            rival = CalibratedModel(Model(like, geometry, draw(EFFECTS)), names, covariance)
            rivals.append((share / sum(shares), rival))
    return CalibratedModel(decided, names, covariance, rivals=rivals)


def on_board(wheel: dict[str, float], **parameters: object) -> Estimates:
    """The newest estimate of one wheel that nothing is measured of but load and slip."""
    given = {
        "wheels": ["w"], "w.diameter": wheel["diameter"], "w.width": wheel["width"], "w.sinkage_topic": "",
        **parameters,
    }  # fmt: skip
    pipeline = Pipeline(settings_from(given).onboard)
    slip = wheel["slip"]
    ratio = 1.0 / (1.0 - slip) if slip >= 0.0 else 1.0 + slip
    for i in range(1, 120):
        stamp = 20_000_000 * i + 10**9
        pose = 0.02 * SPEED * i
        pipeline.streams.add("odom", stamp, (SPEED, 0, pose, 0, 1, 0, 0, 0, 0, 0))
        pipeline.streams.add("w/wheel_speed", stamp, (SPEED * ratio / (0.5 * wheel["diameter"]),))
        pipeline.streams.add("w/load", stamp, (wheel["load"],))
    return Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)]).take(
        slice(-1, None)
    )


def assert_one_number(
    wheel: dict[str, float], model: object, found: Estimates, gravity: float | None = None
) -> None:
    under = {} if gravity is None else {"gravity": gravity}
    row = predict(model=model, **wheel, **under).to_frame().iloc[0]
    if row["status"] != "ok":
        assert np.isnan(found.sinkage[0])
        assert np.isnan(found.drawbar_pull[0])
        return
    assert found.slip[0] == pytest.approx(wheel["slip"], abs=1e-9)
    for name in ("sinkage", "compaction_resistance", "thrust", "drawbar_pull"):
        size = 1e-3 if name == "sinkage" else wheel["load"]
        value = float(getattr(found, name)[0])
        assert value == pytest.approx(row[name], rel=1e-6, abs=1e-6 * size), name


@settings(max_examples=examples(60), deadline=None)
@given(wheel=WHEELS, model=models(), gravity=st.sampled_from([9.80665, 1.62, 24.8]))
def test_bench_and_robot_give_one_number(
    tmp_path_factory: pytest.TempPathFactory,
    wheel: dict[str, float],
    model: CalibratedModel,
    gravity: float,
) -> None:
    path = tmp_path_factory.getbasetemp() / "model.yaml"
    write_model(path, model)
    assert_one_number(wheel, path, on_board(wheel, model_file=str(path), gravity=gravity), gravity)


def test_so_they_do_for_wheels_of_several_sizes_of_one_robot(tmp_path: Path) -> None:
    sizes = {"a": (0.12, 0.06, 0.4, 0.25), "b": (0.3, 0.1, 0.4, -0.25), "c": (0.5, 0.2, -0.4, 0.25)}
    given: dict[str, object] = {"wheels": list(sizes), **of_file(tmp_path, Model("moist_earth"))}
    for name, (diameter, width, ahead, left) in sizes.items():
        given |= {
            f"{name}.diameter": diameter, f"{name}.width": width, f"{name}.sinkage_topic": "",
            f"{name}.longitudinal_position": ahead, f"{name}.lateral_position": left,
        }  # fmt: skip
    pipeline = Pipeline(settings_from(given).onboard)
    slips, loads = (0.05, 0.3, 0.6), (15.0, 60.0, 140.0)
    for i in range(1, 120):
        stamp = 20_000_000 * i + 10**9
        pipeline.streams.add("odom", stamp, (SPEED, 0, 0.02 * SPEED * i, 0, 1, 0, 0, 0, 0, 0))
        for (name, (diameter, *_)), slip, load in zip(sizes.items(), slips, loads, strict=True):
            rim = SPEED / (1.0 - slip)
            pipeline.streams.add(f"{name}/wheel_speed", stamp, (rim / (0.5 * diameter),))
            pipeline.streams.add(f"{name}/load", stamp, (load,))
    found = Estimates.joined([turn.estimates for turn in pipeline.turns(last=True)])
    for i, (diameter, width, *_) in enumerate(sizes.values()):
        wheel = {"load": loads[i], "diameter": diameter, "width": width, "slip": slips[i]}
        own = found.take(found.wheel == i).take(slice(-1, None))
        assert_one_number(wheel, tmp_path / "model.yaml", own)


@pytest.mark.parametrize("name", SOILS)
@pytest.mark.parametrize("slip", [-0.2, 0.0, 0.3])
def test_so_they_do_on_a_soil_of_the_library(name: str, slip: float) -> None:
    wheel = {"load": 60.0, "diameter": 0.25, "width": 0.1, "slip": slip}
    assert_one_number(wheel, name, on_board(wheel, **{"soil.name": name}))


def test_the_paper_s_moist_earth_pulls_by_the_paper_s_strength() -> None:
    row = predict(soil="moist_earth", load=60, diameter=0.2, width=0.1, slip=0.3).to_frame().iloc[0]
    assert row["drawbar_pull"] == pytest.approx(18.4, abs=0.05)


def of_file(tmp_path: Path, model: Model) -> dict[str, object]:
    write_model(tmp_path / "model.yaml", model)
    return {"model_file": str(tmp_path / "model.yaml")}


def test_a_model_measured_under_another_gravity_is_noted(tmp_path: Path) -> None:
    known = Measured(ranges={"load": (20.0, 90.0), "gravity": (1.62, 1.62)})
    given = {
        "wheels": ["w"], "w.diameter": 0.2, "w.width": 0.1,
        **of_file(tmp_path, CalibratedModel(Model("dry_sand"), measured=known)),
    }  # fmt: skip
    note = settings_from(given).onboard.model_note
    assert "measured was under a gravity of 1.62 m/s^2, and parameter gravity is 9.80665" in note
    assert "gravity" not in settings_from(given | {"gravity": 1.62}).onboard.model_note


def test_a_measured_strength_gives_the_margin_from_the_first_metre(tmp_path: Path) -> None:
    own = soil("moist_earth")
    names = ("moist_earth.cohesion", "moist_earth.friction_angle", "moist_earth.rim_friction")
    fitted = CalibratedModel(Model(own), names, np.diag([50.0**2, 0.003**2, 0.02**2]))
    wheel = {"load": 60.0, "diameter": 0.25, "width": 0.1, "slip": 0.4}
    measured = on_board(wheel, **of_file(tmp_path, fitted))
    assumed = on_board(wheel, **of_file(tmp_path, Model(own)))
    row = predict(model=fitted, **wheel).to_frame().iloc[0]
    # At the reference slip, at the depth at which this wheel pulls most if it sinks less than that.
    assert measured.margin[0] >= row["drawbar_pull"] / 60.0 - 1e-6
    assert assumed.margin[0] < measured.margin[0]  # that of any ground
    assert measured.drawbar_pull_std[0] < assumed.drawbar_pull_std[0]


def test_what_the_robot_cannot_honour_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(
        ParametersError, match="thrust_form is wong_reece, expected stress_integral"
    ):
        on_board(
            {"diameter": 0.25, "width": 0.1, "load": 60.0, "slip": 0.1},
            **of_file(tmp_path, Model("dry_sand", thrust_form="wong_reece")),
        )
    with pytest.raises(ParametersError, match="write geometry: contact_integral"):
        on_board(
            {"diameter": 0.25, "width": 0.1, "load": 60.0, "slip": 0.1},
            **of_file(
                tmp_path, Model("dry_sand", "closed_form", ("penetration_rate/penetration_speed",))
            ),
        )
