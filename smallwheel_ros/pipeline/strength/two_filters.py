# SPDX-License-Identifier: Apache-2.0
"""The soils' strength from steps of the path, by two filters: for the present pull, and for the margin."""

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
RECENT = 2.0  # s: the mean slip of a step that ended longer ago is not that of now


def of_any_ground(strength: Strength) -> Strength:
    """Return the strength from which the estimate of a margin starts if only the kind of soil is known.

    When a wheel slips and sinks further, it gains cohesion times an area that it has not touched yet, and
    soils of one name differ most in cohesion (dry sand 0.2 to 2.3 kPa). The cohesion is therefore that of
    any ground, or the soil's own if that is less; its standard deviation is such that the soil's own lies
    within two of them. The friction angle's standard deviation is increased by that of any ground.

    Parameters
    ----------
    strength
        Strength of the named soil.
    """
    any_ground, own = any_strength().cohesion, strength.cohesion.value
    value = min(own, any_ground.value)
    cohesion = Quantity(value, max(any_ground.standard_deviation, 0.5 * (own - value)))
    return replace(strength, cohesion=cohesion).wider(friction_angle=_ANY_FRICTION_STD)


class Strengths:
    """Estimates the strength from steps of the path.

    Parameters
    ----------
    strength
        Prior of the soil's strength.
    wheels
        All wheels.
    rolling
        Numbers of those that roll, shape (rolling wheels,).
    mass
        Mass of the vehicle, kg; 0 if unknown.
    effects
        Effects of the model; those that act on the pressure change the forces.
    measured
        Whether `strength` was measured on this ground; otherwise the margin starts from `of_any_ground`.
    gravity
        Acceleration of gravity, m/s^2.

    Attributes
    ----------
    believed
        Versions of the strength: states of both filters, `now` and `reserve`, after each step.
    now
        Filter for the present pull: uses all measurements, and starts from `strength`.
    reserve
        Filter for the margin: starts from `of_any_ground`, unless `measured`. Once the balance of the
        vehicle's forces has been measured it uses only that, since the torque or pull of a single wheel
        tells only about the ground under that wheel.
    steps
        Number of steps in which anything was measured.
    sources
        Measurements used so far: 'balance', 'torque', 'pull'.
    excitation
        Ranges of load and slip in these steps on the present soil.
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
        """Reset both filters to their priors. soil: number of the soil under the wheels."""
        self.now, self.reserve = (
            StrengthFilter(prior, self._own, self.mass) for prior in self._priors
        )
        self._balanced = False
        self._soil = soil
        # By number: strengths of both filters, and excitation.
        self._soils: dict[int, tuple[list[tuple[Array, Array]], Excitation]] = {}
        self.steps = 0
        self.sources: set[str] = set()
        self.excitation = Excitation()

    def take(self, steps: Steps, anew: Sequence[int] = ()) -> Integers:
        """Update the strength with steps; each makes a new version, and older ones are dropped.

        Parameters
        ----------
        steps
            The steps.
        anew
            Stamps at which the strength is learnt anew, rising, ns: what was learnt before is dropped, and
            the step in which such a stamp lies is not used.

        Returns
        -------
        ndarray
            Stamps after which each new version holds, shape (steps,), ns.
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
        """Collect all that the forces of rolling wheels depend on except the filter's state.

        Parameters
        ----------
        wheel
            Number of the wheel among all, shape (rows,).
        on
            The wheels on their soil, a row each.
        slip
            Slip, shape (rows,), 1.
        along
            Cosine of the angle between the wheel's heading and the vehicle's course, shape (rows,); None: 1.

        Returns
        -------
        Rolling
            A row for each wheel given.
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
        """Return the states of both filters for rows.

        Parameters
        ----------
        versions
            Number of each row's version, shape (rows,).

        Returns
        -------
        now, reserve : Believed
            States for the present pull and for the margin, stacked: arrays have a leading axis of rows.
        """
        kinds, index = np.unique(versions, return_inverse=True)
        now, reserve = zip(*[self.believed[kind] for kind in kinds.tolist()], strict=True)
        return Believed.stacked(now, index), Believed.stacked(reserve, index)

    def record(self) -> dict[str, Any] | None:
        """Return the state to be saved, in types of JSON; None before the first measurement."""
        if not self.steps:
            return None
        mean, covariance = zip(self.now.strength, self.reserve.strength, strict=True)
        return {
            "prior": self._prior_numbers,
            "mean": np.array(mean).tolist(),
            "covariance": np.array(covariance).tolist(),
            "steps": self.steps,
            "sources": sorted(self.sources),
            # None if nothing was measured yet on the newest soil.
            "excitation": None
            if self.excitation == Excitation()
            else [list(bounds) for bounds in self.excitation],
        }

    def restore(self, record: Any) -> None:
        """Restore a state before any step.

        Parameters
        ----------
        record
            What `record` returned; None leaves the prior.

        Raises
        ------
        ValueError
            If it was saved under another prior; nothing is changed then.
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
        """Continue on another soil: with its remembered strength, or else with what the last soil implies."""
        filters = self.now, self.reserve
        self._soils.pop(self._soil, None)
        self._soils[self._soil] = [one.strength for one in filters], self.excitation
        self._soils = dict(list(self._soils.items())[-REMEMBERED:])
        known = self._soils.get(soil)
        for i, one in enumerate(filters):
            one.kalman.x, one.kalman.P = one.kalman.x.copy(), one.kalman.P.copy()
            if known is None:
                one.hand_over()
            else:
                one.strength = known[0][i]
        self.excitation = Excitation() if known is None else known[1]
        self._soil = soil
