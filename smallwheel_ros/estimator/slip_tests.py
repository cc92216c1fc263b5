# SPDX-License-Identifier: Apache-2.0
"""Which slip test would determine what driving on does not: an axle drives alone, the others brake.

A filter's covariance after a measurement hangs on where it is linearised, not on what is measured. So each
test is gone through in a copy of the filter, with measurements that are as expected, at the state that is
believed; beside it as much of driving on. What is said is the deviation of each number of the strength that
is not determined: now, after driving on, and after the test that leaves least of it (expected information of
an optimal design, Fedorov 1972, of one number).

On a level: what the driving axle pulls at the reference slip the others hold, braked. Where they cannot, or
where it pulls nothing, the test is not proposed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from smallwheel_ros.estimator.identifiability import DETERMINED
from smallwheel_ros.estimator.path_steps import FORCE_STD
from smallwheel_ros.estimator.strength_filter import TractionFilter, WheelStep
from smallwheel_ros.physics.wheel import Quantity, Wheel

Array = NDArray[np.float64]

LENGTH = 1.0  # m, of a test: over less the grip of one place counts as the soil's strength
_STRIDE = 0.2  # m between two measurements that are gone through: neighbours tell little more
_LOCKS = -0.6  # the most that a braked wheel may skid
_WORTH = 0.9  # of the deviation after driving on: for less nobody would stop to test
# Of each number of the strength: its name, unit, and factor from the filter's unit to that one.
_NUMBERS = (
    ("cohesion", "Pa", 1.0),
    ("friction angle", "degrees", math.degrees(1.0)),
    ("shear displacement", "%", 100.0),
)


class SlipTest(NamedTuple):
    """A slip test, and the deviations of a number: now, after driving on as far, and after it."""

    what: str
    quantity: str
    unit: str
    now: float
    driving_on: float
    after: float

    @property
    def text(self) -> str:
        """In words."""
        return (
            f"{self.what}: {self.quantity} to about +- {self.after:.2g} {self.unit};"
            f" driving on as far, +- {self.driving_on:.2g}; now, +- {self.now:.2g}"
        )


def best(tests: Sequence[SlipTest]) -> tuple[SlipTest, ...]:
    """For each number the test that leaves least of its deviation, where it is worth it."""
    found: dict[str, SlipTest] = {}
    for one in sorted(tests, key=lambda one: -one.after):
        if one.after < _WORTH * one.driving_on:
            found[one.quantity] = one
    return tuple(found.values())


def slip_tests(
    strength: TractionFilter,
    wheels: Sequence[Wheel],
    steps: Sequence[WheelStep],
    *,
    with_balance: bool,
    reference_slip: float,
) -> Iterator[list[SlipTest]]:
    """Give, one after the other, what each test would tell; each takes ten or twenty milliseconds.

    steps: what each wheel did lately, with torque and pull where they are measured. with_balance: whether
    the forces of the vehicle are.
    """
    deviations = _deviations(strength)
    known = deviations / strength.prior_deviations[: len(_NUMBERS)] <= DETERMINED
    places = sorted({wheel.longitudinal_position for wheel in wheels}, reverse=True)
    if len(places) < 2 or known.all():
        return
    driving_on = _gone_through(strength, steps, with_balance)
    yield []
    for i, place in enumerate(places):
        drive = {strength.order[w.name] for w in wheels if w.longitudinal_position == place}
        tested = _balanced(strength, steps, drive, reference_slip)
        if tested is None:
            yield []
            continue
        after = _gone_through(strength, tested, with_balance)
        axle = {0: "front", len(places) - 1: "rear"}.get(i, f"{i + 1}.")
        what = (
            f"let the {axle} axle drive alone with a slip of {reference_slip:.0%} for {LENGTH:g} m, the"
            " other wheels braked"
        )
        rows = zip(_NUMBERS, deviations, driving_on, after, known, strict=True)
        yield [
            SlipTest(what, name, unit, *(by * float(d) for d in (now, on, then)))
            for (name, unit, by), now, on, then, is_known in rows
            if not is_known
        ]


def _deviations(strength: TractionFilter) -> Array:
    """Of cohesion (Pa), friction angle (rad) and ln shear displacement."""
    found: Array = np.sqrt(np.diag(strength.strength[1])[: len(_NUMBERS)])
    return found


def _balanced(
    strength: TractionFilter, steps: Sequence[WheelStep], drive: set[int], slip: float
) -> list[WheelStep] | None:
    """The wheels with these driving at a slip, the others at the one that holds it; None: there is none."""

    def at(braked: float) -> list[WheelStep]:
        return [one._replace(slip=slip if one.order in drive else braked) for one in steps]

    def pull(braked: float) -> float:
        return sum(strength.forces(one, exact_slip=True).pull.value for one in at(braked))

    if not pull(_LOCKS) < 0.0 < pull(0.0):
        return None
    return at(float(brentq(pull, _LOCKS, 0.0, xtol=1e-3)))


def _gone_through(
    strength: TractionFilter, steps: Sequence[WheelStep], with_balance: bool
) -> Array:
    """Deviations after as many strides as a test has, in which everything that is measured is as expected."""
    ahead = deepcopy(strength)
    for _ in range(round(LENGTH / _STRIDE)):
        ahead.move(_STRIDE, True)
        forces = [ahead.forces(one) for one in steps]
        shown = [
            one._replace(
                torque=one.torque and made.rim.value * one.contact.diameter / 2.0,
                pull=one.pull and Quantity(made.pull.value, one.pull.standard_deviation),
            )
            for one, made in zip(steps, forces, strict=True)
        ]
        balance = None
        if with_balance and ahead.mass > 0.0:
            total = sum(made.pull.value for made in forces) / ahead.mass + ahead.level
            balance = Quantity(total, FORCE_STD)
        ahead.update(shown, balance)
    return _deviations(ahead)
