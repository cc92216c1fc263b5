# SPDX-License-Identifier: Apache-2.0
"""The alarm that an effect is missing, on drives whose truth has it in another form."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from smallwheel_ros.common.stamps import SECOND
from smallwheel_ros.effects.slip import Exponential
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.soil.identifiability import DETERMINED
from smallwheel_ros.pipeline.soil.missing_effect import (
    MissingEffect,
    MissingEffectWatch,
    StretchChanges,
    robust_fit,
)
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.simulate import DriveSettings, simulate_drive

TERRAINS = ["mixed", pytest.param("single", marks=pytest.mark.slow)]
PRIOR = settings_from(
    {"wheels": ["a"], "a.diameter": 0.2, "a.width": 0.1, "soil.name": "dry_sand"}
).onboard.prior
TWO = (Wheel("a", 0.2, 0.1), Wheel("b", 0.2, 0.1))


def driven(seed: int, distance: float, **more: object) -> Pipeline:
    """A pipeline at the end of a simulated drive, all its versions of the law kept."""
    drive = simulate_drive(DriveSettings(seed=seed, distance=distance, outliers=0.02, **more))
    values: dict[str, object] = {"wheels": [wheel.name for wheel in drive.rover.wheels]}
    for wheel in drive.rover.wheels:
        values |= {f"{wheel.name}.diameter": wheel.diameter, f"{wheel.name}.width": wheel.width}
        values |= {f"{wheel.name}.longitudinal_position": wheel.x}
        values |= {f"{wheel.name}.lateral_position": wheel.y}
    pipeline = Pipeline(settings_from(values).onboard)
    pipeline.soils.forget = lambda *_: None  # type: ignore[method-assign]
    rows = {name: drive.rows[name] for name in pipeline.streams.all}
    stamps = drive.rows["odom"][0]
    for begin in range(int(stamps[0]), int(stamps[-1]), 5 * SECOND):
        block = {}
        for name, (stamps, shown) in rows.items():
            part = (stamps >= begin) & (stamps < begin + 5 * SECOND)
            block[name] = stamps[part], shown[part]
        order = np.argsort(np.concatenate([one[0] for one in block.values()]), kind="stable")
        number = np.empty_like(order)
        number[order] = np.arange(order.size)
        ends = np.cumsum([one[0].size for one in block.values()])[:-1]
        numbered = zip(block, block.values(), np.split(number, ends), strict=True)
        pipeline.streams.add_rows({name: (*one, n) for name, one, n in numbered if n.size})
        for _ in pipeline.turns():
            pass
    return pipeline


def alarms(pipeline: Pipeline) -> list[MissingEffect]:
    """Every alarm of a drive, each once."""
    versions = pipeline.soils.versions
    found: dict[str, MissingEffect] = {}
    for number in range(versions.count):
        missing = versions[number].missing
        if missing is not None:
            found.setdefault(missing.effect, missing)
    return list(found.values())


@pytest.mark.parametrize("terrain", TERRAINS)
def test_hidden_slip_sinkage_is_named(terrain: str) -> None:
    pipeline = driven(3, 20.0, terrain=terrain, hidden=("slip_sinkage",))
    found = alarms(pipeline)
    assert [one.effect for one in found] == ["slip_sinkage"]
    assert found[0].rivals == ()
    assert found[0].follows == "slip"
    assert "follows slip: slip_sinkage fits" in found[0].message
    newest = pipeline.soils.versions.newest
    assert (
        newest.missed_variance > 0.0
    )  # what every prediction is uncertain by until it is in the model
    # Numbers of a law that the drive contradicts take up what it misses, however sharp they are.
    assert pipeline.soil.remaining["reference_pressure"] < DETERMINED
    assert not any(pipeline.soil.identifiable)
    misses = "the model misses an effect, slip_sinkage"
    assert pipeline.soil.status == (f"nothing is determined: {misses}",)
    assert pipeline.soil.verdicts["n"].startswith(f"not determined ({misses}): ")


@pytest.mark.parametrize("terrain", TERRAINS)
def test_without_a_hidden_effect_it_is_quiet(terrain: str) -> None:
    assert alarms(driven(3, 25.0, terrain=terrain)) == []


# ---- Parts


def stretches_of(
    wheel: list[int], distance: list[float], sinkage: list[float], **more: float
) -> Stretches:
    """Stretches of a drive that nothing but this is known of."""
    count = len(wheel)
    known = {"load": 50.0, "slip": 0.2, "variance": 1e-8} | more
    columns = {f.name: np.full(count, known.get(f.name, np.nan)) for f in fields(Stretches)}
    columns |= {"wheel": np.array(wheel), "distance": np.array(distance)}
    return Stretches(**(columns | {"sinkage": np.array(sinkage)}))


def test_robust_fit_lets_a_few_great_errors_be() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((400, 2))
    y = columns @ [0.5, -1.0] + 0.1 * rng.standard_normal(400)
    y[:20] += 5.0
    fit = robust_fit(y, columns)
    np.testing.assert_allclose(fit.coefficients, [0.5, -1.0], atol=0.02)
    assert fit.scale < 0.15
    # One column more than there is reason for gains what chance gives.
    more = robust_fit(y, np.column_stack([columns, rng.standard_normal(400)]), np.zeros(3))
    assert -0.01 < 2 * (more.log_likelihood - fit.log_likelihood) < 12
    assert robust_fit(y, np.zeros((400, 0))).coefficients.size == 0


def test_changes_are_of_neighbours_and_gaps_part_them() -> None:
    made = StretchChanges(TWO, 0.2, 40.0)
    assert made.changes() is None
    for i in range(100):
        at = 0.2 * i + (5.0 if i >= 50 else 0.0)
        made.add(stretches_of([0, 1], [at, at], [0.01, 0.02]))
    changes = made.changes()
    assert changes is not None
    # Of one wheel only; over the gap the soil may be any other.
    assert changes.later.size == 2 * 98
    np.testing.assert_allclose(changes.of(changes.log_sinkage), 0.0, atol=1e-12)
    assert np.isnan(changes.wheels["speed"]).all()
    assert np.all(changes.wheels["slip"] == 0.2)


def test_a_stretch_without_measurable_sinkage_has_no_logarithm() -> None:
    made = StretchChanges(TWO, 0.2, 40.0)
    for i, sinkage in enumerate((0.01, -0.001, 1e-5, 0.01)):
        made.add(stretches_of([0], [0.1 * i], [sinkage]))
    changes = made.changes()
    assert changes is not None
    assert changes.log_sinkage.size == 2


def test_old_stretches_are_forgotten() -> None:
    made = StretchChanges(TWO, 0.2, 40.0)
    for i in range(2_000):
        made.add(stretches_of([0], [0.2 * i], [0.01]))
    changes = made.changes()
    assert changes is not None
    assert changes.log_sinkage.size <= 202


def waved(slip: float) -> Stretches:
    """Stretches of one wheel under loads that vary, with sinkages that scatter."""
    rng = np.random.default_rng(2)
    load = 50.0 * np.exp(0.3 * rng.standard_normal(150))
    sinkage = 0.01 * (load / 50.0) ** 0.7 * np.exp(0.03 * rng.standard_normal(150))
    rows = stretches_of([0] * 150, np.linspace(0.0, 30.0, 150).tolist(), sinkage.tolist())
    slips = np.full(150, np.nan) if np.isnan(slip) else slip + 0.1 * rng.random(150)
    return Stretches(**(vars(rows) | {"load": load, "slip": slips}))


def watched(watch: MissingEffectWatch, rows: Stretches) -> dict[str, str]:
    """Give stretches one by one; why effects could not be tested, by id."""
    for i in range(len(rows)):
        watch.take(rows.take(slice(i, i + 1)), lambda: (1.6e6, 0.8, 0.39))
    return {score.effect: score.reason for score in watch.scores}


def test_what_cannot_be_tested_says_why() -> None:
    watch = MissingEffectWatch((), TWO, 0.2, PRIOR)
    reasons = watched(watch, waved(np.nan))
    assert reasons["slip_sinkage"] == "slip is not known"
    assert reasons["moisture"] == "moisture is not known"
    assert watch.alarm is None


def test_an_effect_of_the_model_is_not_looked_for() -> None:
    watch = MissingEffectWatch((Exponential(a=1.0),), TWO, 0.2, PRIOR)
    reasons = watched(watch, waved(0.1))
    assert reasons
    assert "slip_sinkage" not in reasons


def test_a_soil_in_which_wheels_have_no_sinkage_is_not_tested() -> None:
    watch = MissingEffectWatch((), TWO, 0.2, PRIOR)
    rows = waved(0.1)
    for i in range(len(rows)):
        watch.take(rows.take(slice(i, i + 1)), lambda: (float("nan"), 0.8, 0.39))
    assert watch.alarm is None
