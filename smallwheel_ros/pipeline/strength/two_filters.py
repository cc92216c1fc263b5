# SPDX-License-Identifier: Apache-2.0
"""The soils' strength from steps of the path: the belief at each, for the present pull and for the margin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from smallwheel_ros.common.stamps import NEVER
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.onboard.strength import any_strength
from smallwheel_ros.physics.wheel import GRAVITY, Quantity, Strength, Wheel
from smallwheel_ros.pipeline.tables import Array, Integers
from smallwheel_ros.pipeline.versions import REMEMBERED, Versions

from .contact import OnSoil
from .filter import StrengthFilter
from .forces import Believed, Rolling
from .steps import Excitation, Steps

# rad, of any ground: wet ice has a friction angle of 0.1, dry sands and loams 0.47 to 0.6, asphalt 0.7.
_ANY_FRICTION_STD = 0.25
_DRAG = 0.2  # of the load on a wheel that is only dragged along
RECENT = 2.0  # s: a step that ended longer ago says nothing of now


def of_any_ground(strength: Strength) -> Strength:
    """Strength from which the estimate of a margin starts, if only the kind of soil is known.

    What a wheel gains when it slips and sinks further is cohesion times an area that it has not touched yet,
    and soils of one name differ most in cohesion (dry sand 0.2 to 2.3 kPa). The cohesion is therefore that of
    any ground, or the soil's own if that is less; its standard deviation is such that the soil's own lies
    within two of them.
    """
    any_ground, own = any_strength().cohesion, strength.cohesion.value
    value = min(own, any_ground.value)
    cohesion = Quantity(value, max(any_ground.standard_deviation, 0.5 * (own - value)))
    return replace(strength, cohesion=cohesion).wider(friction_angle=_ANY_FRICTION_STD)


class Strengths:
    """Estimates the strength from steps of the path.

    Attributes
    ----------
    believed
        States of both filters after each step, the newest last.
    now
        Filter for the present pull: uses everything, and starts from the named soil.
    reserve
        Filter for the margin: starts from any ground (`of_any_ground`), and uses only the balance once
        there is one, since a wheel's torque or pull only shows its own place.
    measured
        Whether the initial strength was measured on this ground.
    """

    def __init__(
        self, strength: Strength, wheels: tuple[Wheel, ...], rolling: Integers, mass: float,
        effects: tuple[Effect, ...] = (), measured: bool = False, gravity: float = GRAVITY,
    ) -> None:  # fmt: skip
        self.mass, self._count = mass, rolling.size
        self._order = np.full(len(wheels), -1)  # of each wheel among those that roll
        self._order[rolling] = np.arange(rolling.size)
        self._sizes = np.array([(wheel.diameter, wheel.width) for wheel in wheels]).reshape(-1, 2)
        self._own = tuple(wheels[i] for i in rolling.tolist())
        any_ground = strength if measured else of_any_ground(strength)
        self._priors = strength, any_ground
        self.measured, self._gravity = measured, gravity
        self._peak = strength.pressure_peak.value
        self._layers = tuple(effect for effect in effects if "pressure_factor" in effect.acts)
        self._since = NEVER
        self._begin(0)
        self.believed = Versions(self._now(np.full(rolling.size, np.nan), -math.inf))

    def _begin(self, soil: int) -> None:
        """Know nothing but the priors, on a soil."""
        self.now, self.reserve = (
            StrengthFilter(prior, self._own, self.mass) for prior in self._priors
        )
        self._balanced = False
        self._soil = soil
        self._soils: dict[int, list[tuple[Array, Array]]] = {}
        self.steps = 0
        self.sources: set[str] = set()
        self.excitation = Excitation()

    def take(self, steps: Steps, anew: Sequence[int] = ()) -> Integers:
        """Update the strength with steps.

        Parameters
        ----------
        steps
            The steps.
        anew
            Stamps at which the strength is learnt anew, ns: what was learnt before is dropped, and so is
            the step in progress.

        Returns
        -------
        ndarray
            Stamps from which on each new version holds, shape (steps,), ns.
        """
        self.believed.forget(())
        for number in range(steps.end.size):
            mine = np.flatnonzero(steps.step == number)
            new = [stamp for stamp in anew if self._since < stamp < steps.end[number]]
            if new:
                self._since = new[-1]
                self._begin(int(steps.soil[number]))
                mine = mine[:0]
            if int(steps.soil[number]) != self._soil:
                self._change(int(steps.soil[number]))
            if mine.size:
                self._take(steps, number, mine)
            else:
                newest = self.believed.newest[0]
                self._publish(newest.slips, newest.end)
        return steps.end

    def rolling(
        self, wheel: Integers, on: OnSoil, slip: Array, along: Array | None = None
    ) -> Rolling:
        """Rows of rolling wheels in the form that the filters' forces use.

        Parameters
        ----------
        wheel
            Number among all wheels, shape (rows,).
        on
            The wheels on their soil.
        slip
            Shape (rows,).
        along
            Share of each wheel's pull along the vehicle's course, shape (rows,); None: all of it.
        """
        diameter, width = self._sizes[wheel].T
        along = np.ones(1) if along is None else along
        return Rolling(
            self._order[wheel], on, diameter, width, slip, self._peak, along, self._layers
        )

    def _take(self, steps: Steps, number: int, mine: Integers) -> None:
        along = None if steps.along is None else steps.along[mine]
        at = self.rolling(steps.wheel[mine], steps.contact.take(mine), steps.slip[mine], along)
        force = float(steps.force[number]) if mine.size == self._count else math.nan
        torque, pull = steps.torque[mine], steps.pull[mine]
        single = bool(np.isfinite(torque).any() or np.isfinite(pull).any())
        balance = math.isfinite(force) and self.mass > 0.0
        self._balanced |= balance
        slip_std, length = float(steps.slip_std[mine].max()), float(steps.length[number])
        forward = bool(steps.forward[number])
        told = force, float(steps.force_std[number])
        zero = None if steps.level is None else steps.level[number]
        drag = (
            0.0 if steps.unlisted is None else _DRAG * self._gravity * float(steps.unlisted[number])
        )
        nothing = np.full(mine.size, np.nan)
        for one in (self.now, self.reserve):
            one.move(length, forward, slip_std)
            one.level(zero, drag)
            alone = one is self.reserve and self._balanced
            turned, pulled = (nothing, nothing) if alone else (torque, pull)
            one.update(at, turned, pulled, steps.pull_std[mine], *told)
        slips = np.full(self._count, np.nan)
        slips[at.order] = at.slip
        if single or balance:
            self.steps += 1
            self.excitation = self.excitation.widened(at.on.load, np.abs(at.slip))
            self.sources |= {"balance"} if balance else set()
            self.sources |= {"torque"} if np.isfinite(torque).any() else set()
            self.sources |= {"pull"} if np.isfinite(pull).any() else set()
        self._publish(slips, float(steps.end[number]) / 1e9)

    def _publish(self, slips: Array, end: float | Array) -> None:
        self.believed.append(self._now(slips, end))

    def _now(self, slips: Array, end: float | Array) -> tuple[Believed, Believed]:
        two = [
            Believed(one.kalman.x, one.kalman.P, one.cells, slips, end)
            for one in (self.now, self.reserve)
        ]
        return two[0], two[1]

    def at(self, versions: Integers) -> tuple[Believed, Believed]:
        """The strengths for the present pull and for the margin, for rows that name versions."""
        kinds, index = np.unique(versions, return_inverse=True)
        now, reserve = zip(*[self.believed[kind] for kind in kinds.tolist()], strict=True)
        return Believed.stacked(now, index), Believed.stacked(reserve, index)

    def record(self) -> dict[str, Any] | None:
        """State to be saved; None before the first measurement."""
        if not self.steps:
            return None
        mean, covariance = zip(self.now.strength, self.reserve.strength, strict=True)
        return {
            "prior": self._prior_numbers,
            "mean": np.array(mean).tolist(),
            "covariance": np.array(covariance).tolist(),
            "steps": self.steps,
            "sources": sorted(self.sources),
            # None: on the newest soil nothing was measured yet.
            "excitation": None
            if self.excitation == Excitation()
            else [list(bounds) for bounds in self.excitation],
        }

    def restore(self, record: Any) -> None:
        """Restore a `record` before any step; None: start from the prior.

        Raises ValueError, and changes nothing, where it is of another prior.
        """
        if record is None:
            return
        if len(record["prior"]) != len(self._prior_numbers) or not np.allclose(
            record["prior"], self._prior_numbers, rtol=1e-9
        ):
            raise ValueError("saved under another prior of the soil's strength")
        told = zip(record["mean"], record["covariance"], strict=True)
        for one, (mean, covariance) in zip((self.now, self.reserve), told, strict=True):
            one.kalman.x, one.kalman.P = one.kalman.x.copy(), one.kalman.P.copy()
            one.strength = np.array(mean), np.array(covariance)
        self.steps, self.sources = record["steps"], set(record["sources"])
        if record["excitation"] is not None:
            load, slip = record["excitation"]
            self.excitation = Excitation(tuple(load), tuple(slip))
        self._publish(np.full(self._count, np.nan), -math.inf)

    @property
    def _prior_numbers(self) -> list[float]:
        filters = self.now, self.reserve
        return [n for one in filters for n in one.prior]

    def _change(self, soil: int) -> None:
        """Go on on another soil, with what is known of it, or else by what the last one tells."""
        filters = self.now, self.reserve
        self._soils.pop(self._soil, None)
        self._soils[self._soil] = [one.strength for one in filters]
        self._soils = dict(list(self._soils.items())[-REMEMBERED:])
        known = self._soils.get(soil)
        for i, one in enumerate(filters):
            one.kalman.x, one.kalman.P = one.kalman.x.copy(), one.kalman.P.copy()
            if known is None:
                one.hand_over()
            else:
                one.strength = known[i]
        if known is None:
            self.excitation = Excitation()
        self._soil = soil
