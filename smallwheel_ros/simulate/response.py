"""What wheels really do in a truth soil with hidden effects in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smallwheel_ros.simulate.hidden_effects import HiddenEffect
from smallwheel_ros.simulate.truth import (
    Array,
    Circumstances,
    PressureLaw,
    TruthSoil,
    motion_resistance,
    shear_thrust,
    static_sinkage,
)


@dataclass(frozen=True)
class Response:
    """True values, each of shape (rows,); NaN in all of them where a wheel sinks to its axle.

    What is `shown` is what an instrument without noise shows: it differs by the instrument's fault
    and, for sinkage, by soil that comes up again behind the wheel.
    """

    depth: Array  # m, lowest point of the wheel below the untouched surface
    shown_sinkage: Array  # m
    resistance: Array  # N
    shown_resistance: Array  # N
    thrust: Array  # N

    @property
    def drawbar_pull(self) -> Array:
        """Thrust less resistance, N."""
        return self.thrust - self.resistance


def pressure_law(
    soil: TruthSoil, effects: Sequence[HiddenEffect], at: Circumstances, scatter: Array | float
) -> PressureLaw:
    """Return p(z) for these rows; `scatter` multiplies k."""
    modulus = soil.k * at.diameter**soil.m * scatter
    for effect in effects:
        modulus = modulus * effect.modulus(at)

    def law(depth: Array) -> Array:
        pressure = modulus[:, None] * depth**soil.n
        for effect in effects:
            pressure = pressure * effect.stiffening(depth)
        return pressure

    return law


def thrust_at(
    soil: TruthSoil,
    effects: Sequence[HiddenEffect],
    at: Circumstances,
    scatter: Array | float,
    depth: Array,
) -> Array:
    """Thrust (N) of wheels whose depth (m) is known."""
    return shear_thrust(pressure_law(soil, effects, at, scatter), soil, at, depth)


def wheel_response(
    soil: TruthSoil,
    effects: Sequence[HiddenEffect],
    at: Circumstances,
    scatter: Array | float = 1.0,
) -> Response:
    """Compute the truth for each row.

    The load alone gives a static sinkage. Digging in and repeated passes deepen it, and the wheel
    then compacts the soil down to that depth: motion resistance is the horizontal component of
    the pressure from the untouched surface to the final depth, although the soil that was dug out
    no longer carries. Bulldozing comes on top, at the final depth too.

    Parameters
    ----------
    scatter
        Factor on k, by row or for all.
    """
    law = pressure_law(soil, effects, at, scatter)
    depth = static_sinkage(law, at.load, at.diameter, at.width)
    for effect in effects:
        depth = effect.sinkage(depth, at)
    depth = np.where(depth < at.diameter / 2, depth, np.nan)
    resistance = motion_resistance(law, at.diameter, at.width, depth)
    shown = depth
    pressure = law(depth[:, None])[:, 0]
    for effect in effects:
        resistance = resistance + effect.added_resistance(depth, soil, at)
        rise = effect.rebound(pressure)
        # The soil that rises pushes the wheel on: half of pressure times rise for each area.
        resistance = resistance - at.width * pressure * rise / 2
        shown = shown - rise
    thrust = shear_thrust(law, soil, at, depth)
    return Response(
        depth=depth,
        shown_sinkage=shown_by_instrument(effects, "sinkage", shown, at),
        resistance=resistance,
        shown_resistance=shown_by_instrument(effects, "resistance", resistance, at),
        thrust=thrust,
    )


def shown_by_instrument(
    effects: Sequence[HiddenEffect], channel: str, value: Array, at: Circumstances
) -> Array:
    """Let the faults of instruments have their say about `sinkage`, `resistance` or `load`."""
    for effect in effects:
        value = effect.shown(channel, value, at)
    return value
