# SPDX-License-Identifier: Apache-2.0
"""Stretches and soils at their edges, on drives whose truth is a quadrature of its own.

Tests `border_evidence.py`, `filter.py`, `health.py`, `local_law.py` and `scatter.py`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from world_drives import Driven, driven_world, table_of

from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.onboard.declared import VehicleParameters
from smallwheel_ros.onboard.prior import EstimatorSettings, SoilPrior
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.contact import contact_load
from smallwheel_ros.physics.soil import soil, usual_strength
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.borders import Soils
from smallwheel_ros.pipeline.soil.filter import SoilFilter
from smallwheel_ros.pipeline.soil.local_law import Reported, Version, law_of
from smallwheel_ros.pipeline.soil.saved_state import (
    SavedState,
    read_state,
    state_bytes,
    write_state,
)
from smallwheel_ros.pipeline.soil.stretches import Stretches, StretchState, stretches
from smallwheel_ros.pipeline.tables import Readings
from smallwheel_ros.simulate.truth import static_sinkage


def flags_of(version: Version, prior: SoilPrior, share: float = 0.5) -> np.ndarray:
    """Which of (ln pressure, n, m) the data has determined: half of the prior's deviation is gone."""
    spread = np.sqrt(np.diag(law_of(version)[1]))
    known = spread <= share * np.sqrt(np.diag(prior.law[1]))
    return known & version.settled


def drive_of(world: str, way: str = "half", seed: int = 1) -> Driven:
    return driven_world("soil", world, way, seed)


def settings_of(drive: Driven, **more: object) -> OnboardSettings:
    return replace(drive.settings, vehicle=VehicleParameters(), **more)  # type: ignore[arg-type]


def border_of(drive: Driven) -> float:
    return next(one.start for one in drive.drive.ground.started)


def driven(
    rows: Readings, settings: OnboardSettings, cuts: tuple[int, ...] = (), *, forget: bool = False
) -> tuple[Soils, list[Version], np.ndarray]:
    """Rows in blocks: soils, all versions, and number, load and its deviation of each row."""
    soils = Soils(
        settings.prior, settings.estimator, settings.effects, settings.wheels, settings.mass
    )
    state, found, versions = StretchState.of(settings), [], [soils.versions[0]]
    for part in np.split(np.arange(len(rows)), sorted(cuts)):
        if not part.size:
            continue
        block = rows.take(part)
        first = soils.versions.count - 1
        closed, loads = stretches(state, block, settings)
        number = soils.take(closed, block)[0]
        versions += [soils.versions[i] for i in range(first + 1, soils.versions.count)]
        found.append(np.array([number, loads.load, loads.load_std]))
        if forget:
            soils.forget(number)
    return soils, versions, np.concatenate(found, axis=1)


@cache
def whole_drive(world: str) -> tuple[Soils, list[Version], np.ndarray]:
    """A world's drive in one block, once; what is made of it is only read."""
    drive = drive_of(world)
    return driven(drive.rows, settings_of(drive))


def test_a_soil_is_recovered_and_bands_hold() -> None:
    drive = drive_of("nominal")
    settings = settings_of(drive)
    soils, versions, _ = whole_drive("nominal")
    mean, covariance = law_of(versions[-1])
    true = drive.drive.ground.soil
    off = mean - np.array([true.pressure, true.n, true.m])
    assert (np.abs(off) < 3.0 * np.sqrt(np.diag(covariance))).all()
    assert flags_of(versions[-1], settings.prior)[0]
    assert soils.changes == 0


def test_nothing_is_determined_before_the_law_was_taken_again() -> None:
    settings = settings_of(drive_of("nominal"))
    _, versions, _ = whole_drive("nominal")
    first = next(i for i, one in enumerate(versions) if flags_of(one, settings.prior).any())
    assert versions[first].settled
    assert (
        versions[first].accepted >= 160
    )  # some 6 readings a stretch; the law is taken again at the 40th
    assert not any(flags_of(one, settings.prior).any() for one in versions[:first])


def test_nothing_is_believed_that_the_same_readings_taken_together_do_not_show() -> None:
    """Readings near zero: stretches, each about its own state, had shown n to 0.12, 4.4 deviations off.

    Taken together they show it to 0.2, so that its deviation grew at once by 1.6.
    """
    drive = drive_of("right x1.5", "straight")
    rows = replace(drive.rows, sinkage=drive.rows.sinkage - 0.008)  # the zero is 2.7 deviations off
    _, versions, _ = driven(rows, settings_of(drive))
    laws = [law_of(one) for one in versions if one.settled]
    n, deviation = np.array([(mean[1], math.sqrt(spread[1, 1])) for mean, spread in laws]).T
    assert n.size > 50
    assert (np.abs(n - drive.drive.ground.soil.n) < 3.0 * deviation).all()
    assert (deviation[1:] < 1.3 * deviation[:-1]).all()


@pytest.mark.parametrize("world", ["soil x2", "outliers 5 %"])
@pytest.mark.parametrize("seed", [0, 1])
def test_results_do_not_depend_on_where_blocks_are_cut(world: str, seed: int) -> None:
    drive = drive_of(world)
    settings = settings_of(drive)
    rows = drive.rows
    rng = np.random.default_rng(seed)
    cuts = tuple(rng.integers(0, len(rows), [5, 300][seed]).tolist())
    _, whole, expected = whole_drive(world)
    kept, cut, found = driven(rows, settings, cuts, forget=True)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert len(cut) == len(whole)
    for one, other in zip(cut, whole, strict=True):
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-7, atol=1e-14)
        assert (one.number, one.settled, one.border) == (other.number, other.settled, other.border)
    assert len(kept.versions) <= len(rows) // 4  # those of the last block alone


def test_a_border_is_found_and_wheels_behind_it_are_on_the_old_soil() -> None:
    drive = drive_of("soil x2")
    rows = drive.rows
    soils, versions, found = whole_drive("soil x2")
    assert soils.changes == 1
    number = np.array([versions[int(i)].number for i in found[0]])
    first = rows.distance[number == 1].min()
    border = border_of(drive)
    assert border - 0.35 <= first <= border + 1.0
    rear = rows.wheel >= 2
    near = (rows.distance > first) & (rows.distance < versions[-1].border + 0.3)
    assert (number[near & rear] == 0).all()
    assert (number[rows.distance > border + 1.5] == 1).all()


def crossing(factor: float, noise: float, seed: int) -> tuple[Soils, list[Version]]:
    """Stretches of four wheels over 30 m, on soil of so many times its modulus from 15 m on.

    noise: m, of each stretch. Loads swing by a third; n is 0.8, and sinkages are by quadrature.
    """
    prior, rng = SoilPrior.from_soil(soil("dry_sand")), np.random.default_rng(seed)
    wheels = tuple(
        Wheel(f"{x}{y}", 0.25, 0.1, longitudinal_position=x, lateral_position=y)
        for x in (0.3, -0.3)
        for y in (0.3, -0.3)
    )
    way = np.arange(0.2, 30.0, 0.2)
    columns = dict.fromkeys(Stretches.__dataclass_fields__, np.zeros(4 * way.size))
    distance, wheel = np.repeat(way, 4), np.tile(np.arange(4), way.size)
    place = distance - 0.1 + np.array([0.3, 0.3, -0.3, -0.3])[wheel]
    load = 60.0 * np.exp(0.3 * np.sin(2.1 * distance + 1.7 * wheel))
    true = math.exp(prior.log_modulus(0.25)) * np.where(place > 15.0, factor, 1.0)
    one = np.ones(load.size)
    depth = static_sinkage(lambda z: true[:, None] * z**0.8, load, 0.25 * one, 0.1 * one)
    columns |= {
        "wheel": wheel, "load": load, "sinkage": depth + noise * rng.standard_normal(load.size),
        "variance": 0.1 * noise**2 * one, "distance": distance, "place": place, "slip": 0.02 * one,
        "speed": 0.4 * one, "count": np.full(load.size, 8), "dropped": np.zeros(load.size, dtype=int),
        "onward": one > 0.0, "end": (2.5e9 * distance).astype(np.int64), "low": depth, "high": 1.1 * depth,
    }  # fmt: skip
    rows = table_of(
        stamp=columns["end"], wheel=wheel, distance=distance, onward=one > 0.0, load=load
    )
    soils = Soils(prior, EstimatorSettings(sinkage_zero_std=1e-3), (), wheels)
    soils.take(Stretches(**columns), rows)  # type: ignore[arg-type]
    return soils, [soils.versions[i] for i in range(soils.versions.count)]


@pytest.mark.parametrize(
    ("factor", "noise", "seed"),
    [(0.6, 4e-3, 0), (0.6, 4e-3, 1), (1.8, 3e-3, 1), (1.8, 3e-3, 2)],
)
def test_a_border_that_0_6_m_do_not_show_is_found_and_the_law_goes_back(
    factor: float, noise: float, seed: int
) -> None:
    soils, versions = crossing(factor, noise, seed)
    assert soils.changes == 1
    new = next(one for one in versions if one.changes)
    assert abs(new.border - 15.0) < 1.0
    assert new.distance - 15.0 <= 4.0, "over which the law is kept"
    assert new.distance - new.border > 0.9, "the stretches that wait alone would have shown it"
    # Neither n nor the old soil has taken up what changed: the law is that of before the border.
    for version in (versions[new.old], versions[-1]):
        law, covariance = law_of(version)
        assert abs(law[1] - 0.8) < 3.0 * math.sqrt(covariance[1, 1])
    law, covariance = law_of(versions[new.old])
    assert abs(law[0] - soils.prior.law[0][0]) < 3.0 * math.sqrt(covariance[0, 0])
    old_rows = 4 * round(new.border / 0.2)
    assert soils.accepted <= 8 * 4 * 150  # none counts twice
    assert versions[new.old].accepted <= 8 * old_rows + 200


@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_changes_on_one_soil_however_noisy(seed: int) -> None:
    soils, _ = crossing(1.0, 4e-3, seed)
    assert soils.changes == 0


def test_the_bank_together_is_the_prior_of_ground_that_may_be_misnamed() -> None:
    prior = SoilPrior.from_soil(soil("dry_sand"))
    wheels = (Wheel("one", 0.25, 0.1),)
    found = SoilFilter(prior, EstimatorSettings(), (), wheels, (60.0, 0.25, 0.1))
    np.testing.assert_allclose(found.mean, found.model.mean, atol=1e-12)
    np.testing.assert_allclose(found.covariance, found.model.unnamed_covariance, atol=1e-12)
    of_law = found.law[1] @ found.covariance @ found.law[1].T
    expected = prior.law[1].copy()
    expected[0, 0] *= 4.0  # of ln pressure, another soil's than the named one's
    np.testing.assert_allclose(of_law, expected, atol=1e-9)


def test_a_sensor_that_is_stuck_goes_to_no_filter() -> None:
    drive = driven_world("field", "sinkage frozen", "half")
    soils, versions, _ = driven(drive.rows, settings_of(drive))
    assert soils.sensors.stuck.tolist() == [True, False, False, False]
    assert soils.changes == 0
    mean, covariance = law_of(versions[-1])
    assert abs(mean[0] - drive.drive.ground.soil.pressure) < 3.0 * math.sqrt(covariance[0, 0])


def test_sensors_in_whole_steps_are_not_stuck() -> None:
    soils, _, _ = whole_drive("quantised 1 mm")
    assert not soils.sensors.stuck.any()


def test_rows_of_wheels_that_stand_tell_nothing() -> None:
    drive = drive_of("nominal", "short")
    settings = settings_of(drive)
    rows = drive.rows
    twice = np.repeat(np.arange(len(rows)), 1 + 40 * (np.arange(len(rows)) // 4 == 100))
    again = rows.take(twice)
    again = replace(again, stamp=again.stamp + 1000 * np.arange(len(again)))
    _, expected, _ = driven(rows, settings)
    _, found, _ = driven(again, settings)
    assert len(found) == len(expected)
    np.testing.assert_allclose(found[-1].mean, expected[-1].mean, rtol=1e-3)


@pytest.mark.parametrize("blank", ["load", "sinkage"])
def test_without_loads_or_sinkages_the_prior_stays(blank: str) -> None:
    drive = drive_of("nominal", "short")
    settings = settings_of(drive)
    rows = drive.rows
    rows = replace(rows, **{blank: np.full(len(rows), math.nan)})
    soils, versions, found = driven(rows, settings, (100, 200))
    assert len(versions) == 1
    assert soils.record() is None
    np.testing.assert_array_equal(law_of(versions[0])[0], settings.prior.law[0])
    np.testing.assert_array_equal(found[1], rows.load)


def test_loads_of_no_wheel_on_the_ground_are_left_out() -> None:
    drive = drive_of("nominal", "short")
    settings = settings_of(drive)
    rows = drive.rows
    lifted = replace(rows, load=np.where(np.arange(len(rows)) % 9 == 0, -0.5, rows.load))
    _, versions, _ = driven(lifted, settings)
    assert np.isfinite(versions[-1].mean).all()
    assert np.isfinite(versions[-1].covariance).all()


def test_a_slip_that_is_blank_under_an_effect_of_slip() -> None:
    drive = drive_of("slip digs", "short")
    settings = settings_of(drive, effects=(Exponential(a=0.7),))
    rows = drive.rows
    stands = (np.arange(len(rows)) // 4) % 10 == 0
    rows = replace(rows, slip=np.where(stands, math.nan, rows.slip), stands=stands)
    _, versions, _ = driven(rows, settings)
    assert len(versions) > 10
    assert all(np.isfinite(one.mean).all() for one in versions)


def test_a_soil_goes_on_from_its_file(tmp_path: Path) -> None:
    settings = settings_of(drive_of("nominal"))
    soils, versions, _ = whole_drive("nominal")
    saved = soils.record()
    assert saved is not None
    path, now = (
        tmp_path / "soil.json",
        Reported(settings.prior, settings.mean_diameter).estimate(versions[-1]),
    )
    state = SavedState(saved, soils.variety, soils.accepted)
    write_state(path, state_bytes(state, settings.prior, (), now), {})
    state = read_state(path, settings.prior, ())
    again = Soils(settings.prior, settings.estimator, (), settings.wheels)
    assert state.soil is not None
    again.resume(state.soil, state.variety, state.accepted)
    for one, other in zip(law_of(again.versions.newest), law_of(versions[-1]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    assert (
        flags_of(again.versions.newest, settings.prior).tolist()
        == flags_of(versions[-1], settings.prior).tolist()
    )
    assert again.variety == soils.variety


def test_a_pressed_wheel_shows_the_soil_that_it_is_pressed_into() -> None:
    wheel, base = Wheel("plate", 0.3, 0.1, "pressed"), soil("dry_sand")
    prior = SoilPrior.from_soil(base)
    estimator = EstimatorSettings(sinkage_zero_std=1e-4)
    settings = OnboardSettings((wheel,), prior, usual_strength(base), estimator=estimator)
    count, n, modulus = 3000, prior.n + 0.15, math.exp(prior.log_modulus(0.3) + 0.3)
    depth = np.linspace(2e-3, 0.1, count)
    load = 2.0 * contact_load(depth, 0.3, 0.1, modulus, n)
    rng = np.random.default_rng(2)
    zero, yes = np.zeros(count), np.ones(count, dtype=bool)
    rows = table_of(
        stamp=10_000_000 * np.arange(count), wheel=zero.astype(int),
        sinkage=depth + 1e-4 * rng.standard_normal(count), path=depth, distance=depth,
        load=load * (1.0 + 0.01 * rng.standard_normal(count)), pitch=zero, passes=zero, pass_doubt=zero,
        pass_number=zero,
        onward=yes, forward=yes, stands=~yes, due=yes,
    )  # fmt: skip
    soils, versions, _ = driven(rows, settings, (500, 1700))
    mean, covariance = law_of(versions[-1])
    assert soils.changes == 0
    assert abs(mean[1] - n) < 3.0 * math.sqrt(covariance[1, 1])
    assert abs(mean[1] - n) < 0.1
