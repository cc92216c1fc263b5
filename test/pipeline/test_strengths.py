# SPDX-License-Identifier: Apache-2.0
"""Contacts, steps, strength and mobility at their edges, on drives whose truth is a quadrature of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
import pytest

from benchmarks._traction_table import rates
from benchmarks.robot_drives import table_of
from benchmarks.robot_worlds import VEHICLES
from benchmarks.traction_rates import run, settings_of, summed
from benchmarks.traction_worlds import GRAVITY, MASS, WORLDS, TractionDrive, make_drive
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.align import slip_of
from smallwheel_ros.pipeline.mobility import Predicted, mobility
from smallwheel_ros.pipeline.motion import rut_of
from smallwheel_ros.pipeline.soils import Soils
from smallwheel_ros.pipeline.steps import StepState, steps
from smallwheel_ros.pipeline.strength import Strengths
from smallwheel_ros.pipeline.strength_words import constants_of
from smallwheel_ros.pipeline.stretches import StretchState, stretches
from smallwheel_ros.pipeline.tables import Array, Integers, Readings

SETTINGS = settings_of("two sizes", MASS)
BOTH = "balance and torque"


@dataclass(frozen=True)
class Known(Predicted):
    """What wheels can do, with where and when that was."""

    stamp: Integers
    wheel: Integers
    slip: Array
    distance: Array


@lru_cache
def drive_of(world: str = "cruise", distance: float = 6.0) -> TractionDrive:
    return make_drive(replace(WORLDS[world], distance=distance), 2)


def rows_of(drive: TractionDrive, settings: OnboardSettings, kind: str) -> Readings:
    """The table of a drive, a row for each wheel and instant."""
    times, wheels = drive.rim.shape
    speed = np.convolve(np.pad(drive.odometry, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    gained = np.gradient(speed, drive.time)
    count = times * wheels
    yes, none = np.ones(count, dtype=bool), np.full(count, np.nan)
    wheel = np.tile(np.arange(wheels), times)

    def each(column: Array) -> Array:
        return np.repeat(column, wheels)

    travel, rim = each(drive.odometry), drive.rim.ravel()
    std = np.full(count, 0.01)
    slip, slip_std, _ = slip_of(travel, std, rim, 0.01 * rim, 0.01)
    passes, doubt = rut_of(settings.wheels, wheel, yes, none)  # these drives tell no places
    return table_of(
        stamp=(each(1e9 * drive.time) + wheel).astype(np.int64), wheel=wheel,
        sinkage=drive.shown_sinkage.ravel(), sinkage_std=np.full(count, 1e-3),
        load=drive.weighed.ravel(), load_std=np.full(count, 1.2), vehicle_speed=travel, speed=travel,
        speed_std=std, rim_speed=rim, rim_std=0.01 * rim, slip=slip, slip_std=slip_std, stands=~yes,
        forward=yes, slope=each(GRAVITY * np.sin(-drive.pitch)) if "balance" in kind else none,
        gained=each(gained), torque=drive.torque.ravel() if "torque" in kind else none,
        pull=drive.pulled.ravel() if kind == "pull sensor" else none, pitch=each(drive.pitch),
        distance=each(drive.path), path=each(drive.path), onward=yes, passes=passes, pass_doubt=doubt,
        due=yes,
    )  # fmt: skip


def driven(
    rows: Readings, settings: OnboardSettings = SETTINGS, cuts: tuple[int, ...] = ()
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
        first, told = len(soils.versions) - 1, len(strengths.believed) - 1
        stamps = np.empty(0, dtype=np.int64) if closed is None else soils.take(closed)
        law = soils.version_of(block, first, stamps)[0]
        made = steps(stepped, block, loads.load, loads.load_std, law, soils, settings)
        ends = np.empty(0, dtype=np.int64) if made is None else strengths.take(made)
        known = np.isfinite(loads.load)
        believed = told + np.searchsorted(ends, block.stamp)
        if known.any():
            some = block.take(known), loads.load[known], loads.load_std[known]
            numbers = law[known], believed[known]
            made_of = mobility(*some, *numbers, soils, strengths, settings)
            names = {
                name: getattr(some[0], name) for name in ("stamp", "wheel", "slip", "distance")
            }
            found.append(Known(**vars(made_of), **names))
    return Known.joined(found), strengths, soils


@pytest.mark.parametrize("kind", ["balance", BOTH, "pull sensor"])
def test_pull_and_margin_hold_the_truth(kind: str) -> None:
    """Through the whole pipeline; one seed of a world here, more in benchmarks/traction_rates.py."""
    pipeline, made = run(make_drive(WORLDS["patch"], 1), kind)
    score = {name: value for name, (value, _, _) in rates([summed("patch", 1, kind, made)]).items()}
    assert score["pull in band"] > 0.85
    assert score["margin in band"] > 0.8
    assert score["pull rms"] < 2.0
    assert score["Brier"] < 0.09
    told = {"pull"} if kind == "pull sensor" else set(kind.split(" and "))
    assert pipeline.strength.sources == told


def test_without_anything_that_tells_of_strength_bands_are_wide_and_hold() -> None:
    pipeline, made = run(drive_of(distance=8.0), "nothing")
    found = rates([summed("cruise", 2, "nothing", made)])
    assert found["pull in band"][0] > 0.88
    assert found["margin in band"][0] > 0.9
    assert pipeline.strength.steps == 0
    assert pipeline.strength.status[0].startswith("thrust is not determined")


@pytest.mark.slow
def test_rates_over_worlds() -> None:
    drives = [
        (name, seed, make_drive(world, seed)) for name, world in WORLDS.items() for seed in range(4)
    ]
    found = {
        kind: rates([summed(name, seed, kind, run(drive, kind)[1]) for name, seed, drive in drives])
        for kind in ("nothing", "balance", BOTH, "pull sensor")
    }
    print(found)
    for kind, brier in (("balance", 0.08), (BOTH, 0.045)):
        assert found[kind]["Brier"][0] <= brier
    assert all(rate["pull in band"][0] >= 0.9 for rate in found.values())
    assert all(rate["margin in band"][0] >= 0.9 for rate in found.values())


@pytest.mark.parametrize("cuts", [4, 60])
def test_results_do_not_depend_on_where_blocks_are_cut(cuts: int) -> None:
    rows = rows_of(drive_of(), SETTINGS, BOTH)
    places = np.random.default_rng(cuts).integers(0, len(rows), cuts)
    whole, one, _ = driven(rows)
    cut, other, _ = driven(rows, cuts=tuple(places.tolist()))
    for field in fields(Known):
        expected, found = getattr(whole, field.name), getattr(cut, field.name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=field.name)
    np.testing.assert_allclose(other.now.kalman.x, one.now.kalman.x, rtol=1e-9, atol=1e-12)
    assert len(other.believed._kept) < len(one.believed._kept)


def test_what_was_not_measured_is_not_known_and_the_rest_is() -> None:
    rows = rows_of(drive_of(), SETTINGS, "balance")
    found, _, _ = driven(rows)
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
    blind, _, _ = driven(replace(rows, slip=np.full(len(rows), math.nan)))
    assert np.isnan(blind.drawbar_pull).all()
    assert np.isfinite(blind.margin[late]).all()


def test_loads_without_numbers_are_no_rows_and_harm_no_others() -> None:
    rows = rows_of(drive_of(), SETTINGS, BOTH)
    gone = (np.arange(len(rows)) // 4) % 5 == 0
    found, strengths, _ = driven(replace(rows, load=np.where(gone, math.nan, rows.load)))
    assert len(found) == int((~gone).sum())
    assert np.isfinite(strengths.now.kalman.x).all()
    none = replace(rows, load=np.full(len(rows), math.nan))
    soils = Soils(SETTINGS.prior, SETTINGS.estimator, (), SETTINGS.wheels, MASS)
    blank = np.full(len(rows), math.nan)
    made = steps(StepState(), none, blank, blank, np.zeros(len(rows), dtype=int), soils, SETTINGS)
    assert made is not None
    strengths = Strengths(SETTINGS.strength, SETTINGS.wheels, np.arange(4), MASS)
    strengths.take(made)
    assert strengths.steps == 0
    assert strengths.record() is None


def test_effects_in_the_model_and_a_vehicle_that_stands_in_between() -> None:
    settings = replace(SETTINGS, effects=(Exponential(a=0.5),))
    rows = rows_of(drive_of(), settings, BOTH)
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
    rows = rows_of(drive_of(), SETTINGS, BOTH)
    back = replace(
        rows, forward=~rows.forward, onward=~rows.onward, slope=-rows.slope, gained=-rows.gained,
        torque=-rows.torque,
    )  # fmt: skip
    wheels = tuple(
        replace(w, longitudinal_position=-w.longitudinal_position) for w in SETTINGS.wheels
    )
    forth, one, _ = driven(rows)
    found, other, _ = driven(back, replace(SETTINGS, wheels=wheels))
    np.testing.assert_allclose(found.drawbar_pull, forth.drawbar_pull, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.margin, forth.margin, rtol=1e-6, atol=1e-6)
    assert constants_of(other.believed[-1][0])["friction_angle"][0] == pytest.approx(
        constants_of(one.believed[-1][0])["friction_angle"][0]
    )


def test_a_pressed_wheel_has_a_sinkage_and_no_pull() -> None:
    rows = rows_of(drive_of(), SETTINGS, "nothing")
    wheels = (*VEHICLES["two sizes"][:3], Wheel("plate", 0.4, 0.12, "pressed"))
    settings = replace(SETTINGS, wheels=wheels, mass=0.0)
    found, strengths, _ = driven(rows, settings)
    plate = found.wheel == 3
    assert np.isnan(found.drawbar_pull[plate]).all()
    assert np.isfinite(found.sinkage[plate]).all()
    assert (found.compaction_resistance[plate] == 0.0).all()
    assert strengths.steps == 0


def test_a_strength_goes_on_from_its_record() -> None:
    rows = rows_of(drive_of(), SETTINGS, BOTH)
    _, strengths, _ = driven(rows)
    saved = strengths.record()
    assert saved is not None
    again = Strengths(SETTINGS.strength, SETTINGS.wheels, np.arange(4), MASS)
    again.restore(saved)
    assert again.record() == saved
    mean = constants_of(again.believed[-1][0])["friction_angle"]
    assert mean == pytest.approx(constants_of(strengths.believed[-1][1])["friction_angle"])
    with pytest.raises(ValueError, match="another prior"):
        again.restore(saved | {"prior": [1.0] * 6})


def test_loads_that_are_all_too_large_are_seen_by_the_mass() -> None:
    drive = drive_of(distance=8.0)
    rows = rows_of(drive, SETTINGS, BOTH)
    wrong = replace(rows, load=1.15 * rows.load)
    weighed, _, _ = driven(wrong)
    told, _, _ = driven(wrong, replace(SETTINGS, mass=0.0))
    late = weighed.distance > 4.0
    truth = drive.load.ravel()[late]
    assert np.abs(np.log(weighed.load[late] / truth)).mean() < 0.09
    assert np.abs(np.log(told.load[late] / truth)).mean() > 0.1
