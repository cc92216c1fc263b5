# SPDX-License-Identifier: Apache-2.0
"""Faults of instruments: what each makes of a prediction, and what it leaves as it is.

Tests `instruments.py`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smallwheel_ros.effects.base import STAGES, Array, Effect
from smallwheel_ros.effects.registry import effect, families
from smallwheel_ros.model.model import Model, Prediction, predict
from smallwheel_ros.model.nearby_sinkage import NearbySinkage
from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Wheel
from smallwheel_ros.pipeline.soil.local_law import LocalLaws
from smallwheel_ros.pipeline.soil.model import sinkage_of
from smallwheel_ros.pipeline.strength.contact import on_soil

SAND = soil("dry_sand")
INSTRUMENTS = {
    "sinkage_gain", "sinkage_offset", "load_gain", "load_offset", "resistance_gain",
    "resistance_offset", "rig_friction", "slip_resistance",
}  # fmt: skip
LOADS = np.array([30.0, 60.0, 90.0, 60.0])
SLIPS = np.array([-0.4, 0.0, 0.5, 0.2])


def at(load: Array = LOADS) -> Conditions:
    return Conditions.of(load, 0.2, 0.1, slip=SLIPS)


def with_fault(*faults: Effect) -> Prediction:
    return predict(Model(SAND, effects=faults), at())


TRUE = predict(Model(SAND), at())


def test_the_instruments_say_that_they_are() -> None:
    kinds = {id: {form.kind for form in forms} for id, forms in families().items()}
    assert {id for id, kind in kinds.items() if kind == {"instrument"}} == INSTRUMENTS
    assert all(len(kind) == 1 for kind in kinds.values())


@pytest.mark.parametrize(
    ("fault", "shown"),
    [
        (effect("resistance_gain", g=0.1), 1.1 * TRUE.resistance),
        (effect("resistance_gain", g=-0.3), 0.7 * TRUE.resistance),
        (effect("resistance_offset", offset=-2.0), TRUE.resistance - 2.0),
        (effect("rig_friction", f=0.1), TRUE.resistance + 0.1 * LOADS),
        (effect("slip_resistance", s=0.5), TRUE.resistance * (1 + 0.5 * np.abs(SLIPS))),
        (effect("slip_resistance", s=-0.5), TRUE.resistance * (1 - 0.5 * np.abs(SLIPS))),
    ],
    ids=lambda v: f"{v.id}/{v.form}" if isinstance(v, Effect) else None,
)
def test_faults_of_resistance(fault: Effect, shown: Array) -> None:
    seen = with_fault(fault)
    assert seen.resistance == pytest.approx(shown, rel=1e-12)
    assert seen.true_resistance == pytest.approx(TRUE.resistance, rel=1e-15)
    assert (seen.sinkage == TRUE.sinkage).all()
    assert seen.drawbar_pull == pytest.approx(TRUE.drawbar_pull, rel=1e-15)  # of the true one


@pytest.mark.parametrize(
    ("fault", "shown"),
    [
        (effect("sinkage_gain", g=0.1), 1.1 * TRUE.sinkage),
        (effect("sinkage_gain", g=-0.6), 0.4 * TRUE.sinkage),
        (effect("sinkage_offset", offset=0.002), TRUE.sinkage + 0.002),
    ],
    ids=lambda v: f"{v.id}/{v.form}" if isinstance(v, Effect) else None,
)
def test_faults_of_sinkage(fault: Effect, shown: Array) -> None:
    seen = with_fault(fault)
    assert seen.sinkage == pytest.approx(shown, rel=1e-12)
    assert (seen.true_sinkage == TRUE.sinkage).all()
    assert (seen.resistance == TRUE.resistance).all()
    assert seen.drawbar_pull is not None
    assert (seen.drawbar_pull == TRUE.drawbar_pull).all()


@pytest.mark.parametrize(
    ("fault", "load"),
    [
        (effect("load_gain", g=0.25), LOADS / 1.25),
        (effect("load_gain", g=-0.5), LOADS / 0.5),
        (effect("load_offset", offset=-4.0), LOADS + 4.0),
        (effect("load_offset", offset=4.0), LOADS - 4.0),
        # At least a twentieth of what is shown is load.
        (effect("load_offset", offset=58.0), np.array([1.5, 3.0, 32.0, 3.0])),
    ],
    ids=lambda v: f"{v.id}={next(v.values())[1]:g}" if isinstance(v, Effect) else None,
)
def test_faults_of_the_load_cell(fault: Effect, load: Array) -> None:
    """All that is predicted is that of a wheel under the load itself, other effects' too."""
    others = (effect("load_dependent_modulus", g=0.2), effect("rig_friction", f=0.1))
    seen = with_fault(*others, fault)
    expected = predict(Model(SAND, effects=others), at(load))
    for channel in ("sinkage", "resistance", "drawbar_pull", "thrust"):
        assert getattr(seen, channel) == pytest.approx(getattr(expected, channel), rel=1e-13)


def test_the_load_is_corrected_before_gravity_acts() -> None:
    slope = Conditions.of(50.0, 0.2, 0.1, slope=0.2)
    seen = predict(Model(SAND) + effect("load_offset", offset=10.0), slope)
    expected = predict(Model(SAND), Conditions.of(40.0, 0.2, 0.1, slope=0.2))
    assert seen.sinkage == pytest.approx(expected.sinkage, rel=1e-13)
    assert seen.resistance == pytest.approx(expected.resistance, rel=1e-13)


def test_what_is_shown_comes_last() -> None:
    assert STAGES[0] == "corrected_load"
    assert STAGES[-1] == "measured_resistance"
    gain, pushed = effect("resistance_gain", g=0.5), effect("bulldozing", scale=3.0)
    first = with_fault(gain, pushed)
    assert first.resistance == pytest.approx(1.5 * first.true_resistance, rel=1e-13)
    assert first.resistance == pytest.approx(with_fault(pushed, gain).resistance, rel=1e-13)


@pytest.mark.parametrize("fault", ["resistance_offset", "rig_friction", "resistance_gain"])
def test_a_pressed_body_shows_no_resistance(fault: str) -> None:
    both = Conditions.of(60.0, 0.2, 0.1, contact=["pressed", "plate"])
    assert (predict(Model(SAND) + effect(fault), both).resistance == 0.0).all()


def test_sinkage_is_shown_wrongly_on_plates_too() -> None:
    plate = Conditions.of(60.0, 0.2, 0.1, contact="plate")
    shown = predict(Model(SAND) + effect("sinkage_gain", g=0.1), plate).sinkage
    assert shown == pytest.approx(1.1 * predict(Model(SAND), plate).sinkage, rel=1e-13)


def test_a_gain_of_load_is_one_of_resistance_in_another_soil() -> None:
    """As docs/effects.md says: sinkage and resistance cannot tell the two, a drawbar pull can."""
    loads = with_fault(effect("load_gain", g=0.25))
    stiffer = replace(SAND, k=1.25 * SAND.k)
    forces = predict(Model(stiffer) + effect("resistance_gain", g=1 / 1.25 - 1), at())
    assert loads.sinkage == pytest.approx(forces.sinkage, rel=1e-10)
    assert loads.resistance == pytest.approx(forces.resistance, rel=1e-10)
    assert loads.drawbar_pull != pytest.approx(forces.drawbar_pull, rel=0.05)


class TestOnTheRobot:
    """The pipeline's own ways to a prediction agree with the model's, under faults of instruments."""

    FAULTS = (
        effect("load_gain", g=0.25),
        effect("load_offset", offset=3.0),
        effect("sinkage_gain", g=0.1),
        effect("resistance_offset", offset=2.0),
    )
    ROW = Conditions.of(60.0, 0.2, 0.1, slip=0.3)
    WHEELS = (Wheel("one", 0.2, 0.1),)
    LOAD, FIRST, SLIP = np.array([60.0]), np.array([0]), np.array([0.3])

    def test_sinkage(self) -> None:
        expected = predict(Model(SAND, effects=self.FAULTS), self.ROW)
        law = np.array([[SoilPrior.from_soil(SAND).log_modulus(0.2), SAND.n, SAND.m]])
        seen = sinkage_of(law, self.LOAD, self.WHEELS, self.FIRST, self.FAULTS, self.SLIP)
        assert seen.value == pytest.approx(expected.sinkage, rel=1e-9)

    def test_forces_are_the_true_ones(self) -> None:
        expected = predict(Model(SAND, effects=self.FAULTS), self.ROW)
        nothing = np.zeros(1)
        law = LocalLaws(
            SoilPrior.from_soil(SAND).law[0][None], nothing, nothing, np.zeros((1, 5, 5))
        )
        on = on_soil(
            self.WHEELS, self.FIRST, law, self.LOAD, nothing, scatter=0.0, effects=self.FAULTS,
            slip=self.SLIP,
        )  # fmt: skip
        assert on.compaction + on.other == pytest.approx(expected.true_resistance, rel=1e-9)

    @pytest.mark.parametrize("added", [(), (effect("load_offset", offset=3.0),)])
    def test_nearby_sinkage(self, added: tuple[Effect, ...]) -> None:
        row = Conditions.of([40.0, 80.0], 0.2, 0.1, slip=0.3)
        near = NearbySinkage(SAND, self.FAULTS, row)
        softer = replace(SAND, n=SAND.n + 1e-4)
        expected = predict(Model(softer, effects=(*self.FAULTS, *added)), row).sinkage
        assert near.log_sinkage(softer, *added) == pytest.approx(np.log(expected), abs=1e-6)
