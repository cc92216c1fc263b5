# SPDX-License-Identifier: Apache-2.0
"""Faults of a rig's instruments, which change what is shown and are not properties of the soil.

With a gain, every reading is larger by a constant share; with an offset, the instrument's zero is wrong.
Friction of the rig, and errors that follow slip, affect only the sensor of resistance: drawbar pull does
not contain them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions

# Prior of the error of a shown sinkage's zero: Student's t about 0 with this scale (m) and these degrees of
# freedom. On loose soil the zero can be set to within 1 or 2 mm. If it was set with the wheel on the soil, or
# in its own rut, its error is the sinkage at that time, up to a centimetre: the tails of t allow for it.
SINKAGE_ZERO_STD = 0.003
SINKAGE_ZERO_FREEDOM = 3.0

# Least share of a load cell's reading that is load, whatever the offset: an offset as large as the reading
# would mean a broken cell, and a wheel without a load has no sinkage to fit.
_LEAST_SHARE = 0.05


class _Gain(Effect):
    kind = "instrument"
    source = "an error of scale"


@dataclass(frozen=True)
class LoadGain(_Gain):
    id = "load_gain"
    form = "share"
    summary = "The load cell is out of scale: every load is shown too large by one share."
    formula = "shown W = W (1 + g)"
    next_step = "Weigh two known masses on the load cell, one light and one as heavy as the wheel."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def corrected_load(self, load: Array, conditions: Conditions) -> Array:
        return load / (1.0 + self.g)


@dataclass(frozen=True)
class SinkageGain(_Gain):
    id = "sinkage_gain"
    form = "share"
    summary = (
        "The sinkage instrument is out of scale: every sinkage is shown too deep by one share."
    )
    formula = "shown z = z (1 + g)"
    next_step = "Move the wheel's carriage by a gauge block of known height and read the sinkage."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage * (1.0 + self.g)


@dataclass(frozen=True)
class ResistanceGain(_Gain):
    id = "resistance_gain"
    form = "share"
    summary = "The force sensor is out of scale: every resistance is shown too large by one share."
    formula = "shown R = R (1 + g)"
    next_step = "Pull the carriage with a known weight over a pulley and read the resistance."

    g: float = parameter(0.05, (-0.6, 1.0), "share by which too much is shown")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return resistance * (1.0 + self.g)


class _Offset(Effect):
    kind = "instrument"


@dataclass(frozen=True)
class LoadOffset(_Offset):
    id = "load_offset"
    form = "constant"
    summary = "The load cell's zero is off: every load is shown too large or too small by as much."
    formula = "shown W = W + offset, W at least 5 % of what is shown"
    source = "a cell that was not set to zero with the wheel lifted"
    next_step = "Lift the wheel clear of the soil and read the load cell; it should show zero."

    offset: float = parameter(2.0, (-1e3, 1e3), "what is shown at zero load", unit="N")

    def corrected_load(self, load: Array, conditions: Conditions) -> Array:
        return np.maximum(load - self.offset, _LEAST_SHARE * load)


@dataclass(frozen=True)
class SinkageOffset(_Offset):
    id = "sinkage_offset"
    form = "constant"
    summary = (
        "The sinkage instrument's zero is off: all sinkages are shown too deep or too shallow."
    )
    formula = "shown z = z + offset"
    source = "a zero that was set at another height than touch-down"
    next_step = (
        "Take the zero of sinkage at touch-down under the lightest load, and again after the run."
    )

    offset: float = parameter(0.001, (-0.05, 0.05), "what is shown at zero sinkage", unit="m")

    def measured_sinkage(self, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage + self.offset


@dataclass(frozen=True)
class ResistanceOffset(_Offset):
    id = "resistance_offset"
    form = "constant"
    summary = "The force sensor's zero is off: every resistance is shown too large or too small."
    formula = "shown R = R + offset"
    source = "a sensor that was not set to zero at rest, or seals that rub"
    next_step = "Read the resistance with the wheel at rest and unloaded; it should show zero."

    offset: float = parameter(1.0, (-1e3, 1e3), "what is shown at zero resistance", unit="N")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return resistance + self.offset


@dataclass(frozen=True)
class ShareOfLoad(Effect):
    id = "rig_friction"
    kind = "instrument"
    summary = "The rig itself resists: bearings and guides add to the measured resistance."
    formula = "shown R = R + f W"
    source = "Coulomb friction in a bearing that carries the load"
    drivers = ("load",)
    next_step = "Tow the wheel over a hard, flat plate at two loads: what is left is the rig's own."

    f: float = parameter(0.05, (0.0, 1.0), "the rig's resistance over the load")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance + self.f * conditions.load)


@dataclass(frozen=True)
class Magnitude(Effect):
    """Resistance that grows with slip while sinkage does not; if the soil were the cause, sinkage would, too.

    In a rig it occurs where part of the wheel's thrust reaches the force sensor, as through a motor's
    cable or a tilted guide, or where the resistance is computed from the motor's torque.
    """

    id = "slip_resistance"
    kind = "instrument"
    summary = "The measured resistance follows slip, though sinkage does not."
    formula = "shown R = R (1 + s |i|)"
    source = "empirical, the first order in slip"
    needs = ("slip",)
    idle = "no row has slip"
    next_step = (
        "Sweep slip at one load on a hard, flat plate, where no soil is dug: the force sensor should "
        "show the same resistance at every slip."
    )

    s: float = parameter(0.2, (-0.9, 10.0), "growth of the shown resistance to slip 1 or -1")

    def measured_resistance(self, resistance: Array, conditions: Conditions) -> Array:
        return np.asarray(resistance * (1.0 + self.s * np.abs(conditions["slip"])))
