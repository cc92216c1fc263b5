# SPDX-License-Identifier: Apache-2.0
"""Contacts, steps, strength and mobility at their edges, on drives whose truth is a quadrature of its own.

Tests `words.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
import pytest
from world_drives import Driven, driven_world

from rates.drive_trial import judged
from rates.drive_worlds import WORLDS, make_drive
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.onboard.declared import VehicleParameters
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.mobility.wheel import Predicted, mobility
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.stretches import StretchState, stretches
from smallwheel_ros.pipeline.strength.steps import Excitation, Steps, StepState, steps
from smallwheel_ros.pipeline.strength.two_filters import Strengths
from smallwheel_ros.pipeline.strength.words import constants_of, strength_of
from smallwheel_ros.pipeline.tables import Array, Flags, Integers, Readings

BOTH = "balance and torque"


@dataclass(frozen=True)
class Known(Predicted):
    """What wheels can do, with where and when that was."""

    stamp: Integers
    wheel: Integers
    slip: Array
    distance: Array


def drive_of(kind: str = BOTH, ground: str = "cruise") -> Driven:
    """Readings of wheels that roll under a load, over 8 m; strength is told of as the kind says."""
    found = driven_world("traction", f"{ground}; {kind}", "short", 2)
    rolls = np.isfinite(found.rows.load) & ~found.rows.stands & np.isfinite(found.rows.slip)
    return replace(found, rows=found.rows.take(rolls))


def driven(
    rows: Readings, settings: OnboardSettings, cuts: tuple[int, ...] = ()
) -> tuple[Known, Strengths, Soils]:
    """Rows in blocks through every stage behind motion."""
    soils = Soils(
        settings.prior, settings.estimator, settings.effects, settings.wheels, settings.mass
    )
    rolling = np.flatnonzero([w.contact == "rolling" for w in settings.wheels])
    strengths = Strengths(settings.strength, settings.wheels, rolling, settings.mass)
    stretched, stepped, found = StretchState.of(settings), StepState(), []
    for part in np.split(np.arange(len(rows)), sorted(cuts)):
        if not part.size:
            continue
        block = rows.take(part)
        closed, loads = stretches(stretched, block, settings)
        told = strengths.believed.count - 1
        law = soils.take(closed, block)[0]
        made = steps(stepped, block, loads.load, loads.load_std, law, soils, settings)
        ends = np.empty(0, dtype=np.int64) if made is None else strengths.take(made)
        known = np.isfinite(loads.load)
        believed = told + np.searchsorted(ends, block.stamp)
        if known.any():
            some = block.take(known), loads.load[known], loads.load_std[known]
            numbers = law[known], believed[known]
            made_of = mobility(*some, *numbers, soils.versions, strengths, settings)
            names = {
                name: getattr(some[0], name) for name in ("stamp", "wheel", "slip", "distance")
            }
            found.append(Known(**vars(made_of), **names))
    return Known.joined(found), strengths, soils


@cache
def whole_drive(kind: str = BOTH) -> tuple[Known, Strengths, Soils]:
    """A drive in one block, once; what is made of it is only read."""
    drive = drive_of(kind)
    return driven(drive.rows, drive.settings)


@pytest.mark.parametrize(
    "kind", [pytest.param("balance", marks=pytest.mark.slow), BOTH, "pull sensor"]
)
def test_pull_and_margin_hold_the_truth(kind: str) -> None:
    """Through the whole pipeline; one seed of a world here, more in `rates/run.py traction`."""
    pipeline, line = judged(make_drive(WORLDS["traction"][f"patch; {kind}"], 1))
    inside = {name: line["inside"][name] / line["counts"][name] for name in ("pull", "margin")}
    assert inside["pull"] > 0.85
    assert inside["margin"] > 0.8
    assert math.sqrt(line["squares"]["pull"] / line["counts"]["pull"]) < 2.5
    told = {"pull"} if kind == "pull sensor" else set(kind.split(" and "))
    assert pipeline.strength.sources == told


def test_without_anything_that_tells_of_strength_bands_are_wide_and_hold() -> None:
    pipeline, line = judged(
        make_drive(replace(WORLDS["traction"]["cruise; nothing"], way="short"), 2)
    )
    assert line["inside"]["pull"] > 0.88 * line["counts"]["pull"]
    assert line["inside"]["margin"] > 0.9 * line["counts"]["margin"]
    assert pipeline.strength.steps == 0
    assert pipeline.strength.status[0].startswith("thrust is not determined")


@pytest.mark.parametrize("cuts", [4, 60])
def test_results_do_not_depend_on_where_blocks_are_cut(cuts: int) -> None:
    rows, settings = drive_of().rows, drive_of().settings
    places = np.random.default_rng(cuts).integers(0, len(rows), cuts)
    whole, one, _ = whole_drive()
    cut, other, _ = driven(rows, settings, cuts=tuple(places.tolist()))
    for field in fields(Known):
        expected, found = getattr(whole, field.name), getattr(cut, field.name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=field.name)
    np.testing.assert_allclose(other.now.kalman.x, one.now.kalman.x, rtol=1e-9, atol=1e-12)
    assert len(other.believed) < len(one.believed)


def test_what_was_not_measured_is_not_known_and_the_rest_is() -> None:
    rows, settings = drive_of("balance").rows, drive_of("balance").settings
    found, _, _ = whole_drive("balance")
    late = found.distance > 2.0
    for name in (
        "sinkage",
        "sinkage_std",
        "compaction_resistance",
        "drawbar_pull",
        "thrust_std",
        "margin",
    ):
        assert np.isfinite(getattr(found, name)[late]).all(), name
    blind, _, _ = driven(replace(rows, slip=np.full(len(rows), math.nan)), settings)
    assert np.isnan(blind.drawbar_pull).all()
    assert np.isfinite(blind.margin[late]).all()


def test_loads_without_numbers_are_no_rows_and_harm_no_others() -> None:
    rows, settings = drive_of().rows, drive_of().settings
    gone = (np.arange(len(rows)) // 4) % 5 == 0
    found, strengths, _ = driven(replace(rows, load=np.where(gone, math.nan, rows.load)), settings)
    assert len(found) == int((~gone).sum())
    assert np.isfinite(strengths.now.kalman.x).all()
    none = replace(rows, load=np.full(len(rows), math.nan))
    soils = Soils(settings.prior, settings.estimator, (), settings.wheels, settings.mass)
    blank = np.full(len(rows), math.nan)
    made = steps(StepState(), none, blank, blank, np.zeros(len(rows), dtype=int), soils, settings)
    assert made is not None
    strengths = Strengths(settings.strength, settings.wheels, np.arange(4), settings.mass)
    strengths.take(made)
    assert strengths.steps == 0
    assert strengths.record() is None


def test_effects_in_the_model_and_a_vehicle_that_stands_in_between() -> None:
    settings = replace(drive_of().settings, effects=(Exponential(a=0.5),))
    rows = drive_of().rows
    stands = (rows.distance > 3.0) & (rows.distance < 3.4)
    rows = replace(rows, stands=stands, slip=np.where(stands, math.nan, rows.slip))
    found, strengths, _ = driven(rows, settings, (300, 500))
    assert np.isnan(found.drawbar_pull[stands]).all()
    moves = ~stands & (found.distance > 1.0)
    assert np.isfinite(found.drawbar_pull[moves]).all()
    assert np.isfinite(found.sinkage[moves]).all()
    assert np.isfinite(strengths.now.kalman.x).all()


def test_a_way_back_is_the_mirror_of_a_way_forward() -> None:
    """Backward everything along x changes its sign, and so do the places of the wheels."""
    rows, settings = drive_of().rows, drive_of().settings
    rows = replace(rows, across=np.full(len(rows), math.nan))  # the level across is no matter of x
    back = replace(
        rows, forward=~rows.forward, onward=~rows.onward, slope=-rows.slope, gained=-rows.gained,
        pushed=-rows.pushed, torque=-rows.torque,
    )  # fmt: skip
    wheels = tuple(
        replace(w, longitudinal_position=-w.longitudinal_position) for w in settings.wheels
    )
    forth, one, _ = driven(rows, settings)
    found, other, _ = driven(back, replace(settings, wheels=wheels))
    np.testing.assert_allclose(found.drawbar_pull, forth.drawbar_pull, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.margin, forth.margin, rtol=1e-6, atol=1e-6)
    assert constants_of(other.believed.newest[0])["friction_angle"][0] == pytest.approx(
        constants_of(one.believed.newest[0])["friction_angle"][0]
    )


def test_a_pressed_wheel_has_a_sinkage_and_no_pull() -> None:
    rows, settings = drive_of("nothing").rows, drive_of("nothing").settings
    wheels = (*settings.wheels[:3], Wheel("plate", 0.4, 0.12, "pressed"))
    settings = replace(settings, wheels=wheels, vehicle=VehicleParameters())
    found, strengths, _ = driven(rows, settings)
    plate = found.wheel == 3
    assert np.isnan(found.drawbar_pull[plate]).all()
    assert np.isfinite(found.sinkage[plate]).all()
    assert (found.compaction_resistance[plate] == 0.0).all()
    assert strengths.steps == 0


def test_a_strength_goes_on_from_its_record() -> None:
    settings = drive_of().settings
    _, strengths, _ = whole_drive()
    saved = strengths.record()
    assert saved is not None
    again = Strengths(settings.strength, settings.wheels, np.arange(4), settings.mass)
    again.restore(saved)
    assert again.record() == saved
    for one, other in zip(again.believed.newest, strengths.believed.newest, strict=True):
        mean = constants_of(one)["friction_angle"]
        assert mean == pytest.approx(constants_of(other)["friction_angle"])
    with pytest.raises(ValueError, match="another prior"):
        again.restore(saved | {"prior": [1.0] * 6})


def test_loads_that_are_all_too_large_are_seen_by_the_mass() -> None:
    drive = drive_of()
    rows, settings = drive.rows, drive.settings
    wrong = replace(rows, load=1.15 * rows.load)
    weighed, _, _ = driven(wrong, settings)
    told, _, _ = driven(wrong, replace(settings, vehicle=VehicleParameters()))
    late = weighed.distance > 4.0
    truth = drive.drive.truth.load[drive.drive.at(rows.stamp), rows.wheel][late]
    assert np.abs(np.log(weighed.load[late] / truth)).mean() < 0.09
    assert np.abs(np.log(told.load[late] / truth)).mean() > 0.1


def test_ranges_are_those_of_the_present_soil_and_come_back_with_it() -> None:
    """Three soils: the second is rolled over with three times the load, the third without any wheel."""
    rows, settings = drive_of().rows, drive_of().settings
    soils = Soils(settings.prior, settings.estimator, (), settings.wheels, settings.mass)
    none = np.zeros(len(rows), dtype=int)
    made = steps(StepState(), rows, rows.load, 0.0 * rows.load + 1.0, none, soils, settings)
    assert made is not None
    soil = np.arange(made.end.size) * 4 // made.end.size
    soil[soil == 3] = 0
    heavy = made.contact.load * np.where(soil[made.step] == 1, 3.0, 1.0)
    made = replace(made, soil=soil, contact=replace(made.contact, load=heavy))
    strengths = Strengths(settings.strength, settings.wheels, np.arange(4), settings.mass)
    ranges = dict[int, Excitation]()
    for quarter, number in enumerate((0, 1, 2, 0)):
        mine = np.arange(made.end.size) * 4 // made.end.size == quarter
        strengths.take(_of_steps(made, mine, with_wheels=number != 2))
        if quarter == 3:
            load = heavy[(soil == 0)[made.step]]
            assert strengths.excitation.load == pytest.approx((load.min(), load.max()))
            assert strengths.excitation.slip[1] >= ranges[0].slip[1]
        elif number == 2:
            status = strength_of(strengths).status
            assert strengths.excitation == Excitation()
            assert any("nothing was measured on the present soil yet" in text for text in status)
            assert "inf" not in "".join(status)
        ranges[number] = strengths.excitation
    assert ranges[1].load[0] > ranges[0].load[1]


def _of_steps(made: Steps, which: Flags, *, with_wheels: bool) -> Steps:
    """Some of the steps, with or without the wheels' rows in them."""
    own = which[made.step] & with_wheels
    of_steps = ("end", "length", "forward", "force", "force_std", "soil", "level", "unlisted")
    of_rows = ("wheel", "slip", "slip_std", "torque", "pull", "pull_std", "along")
    columns = {
        name: None if vars(made)[name] is None else vars(made)[name][which] for name in of_steps
    }
    columns |= {name: vars(made)[name][own] for name in of_rows}
    step = (np.cumsum(which) - 1)[made.step[own]]
    return Steps(**columns, step=step, contact=made.contact.take(own))
