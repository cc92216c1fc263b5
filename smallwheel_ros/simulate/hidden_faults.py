# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: D102 - HiddenEffect describes the methods once, for all effects
"""Faults of instruments that the truth can have in it: the soil and the wheel do not notice them.

A gain or a zero has one sensible form, the one that the library fits too. Where no size is given,
the sign of a gain or a zero is drawn as well.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from smallwheel_ros.simulate.contact import Array
from smallwheel_ros.simulate.hidden_effects import Form, HiddenEffect
from smallwheel_ros.simulate.truth import Circumstances


def _one_form(formula: str) -> dict[Form, str]:
    return {"own": formula, "published": formula}


class _Gain(HiddenEffect):
    """An instrument shows a share too much or too little: 10 %."""

    kind = "instrument"
    channel: ClassVar[str] = ""
    typical: ClassVar = {"own": 0.10, "published": 0.10}

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: float, form: Form) -> HiddenEffect:
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        return cls(form, sign * strength * cls.typical[form] * rng.uniform(0.85, 1.15))

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        return value * (1.0 + self.amplitude) if channel == self.channel else value


class _Zero(_Gain):
    """The zero of an instrument is off."""

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        return value + self.amplitude if channel == self.channel else value


class SinkageOffset(HiddenEffect):
    """The zero of the sinkage sensor is off by 2 to 3 mm, always the same way."""

    name = "sinkage_offset"
    kind = "instrument"
    formula: ClassVar = _one_form("measured z = z + A, m")
    typical: ClassVar = {"own": 0.0025, "published": 0.0025}

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        return value + self.amplitude if channel == "sinkage" else value


class SinkageGain(_Gain):
    """The scale of the sinkage sensor is off."""

    name = "sinkage_gain"
    channel = "sinkage"
    formula: ClassVar = _one_form("measured z = z (1 + A)")


class LoadGain(_Gain):
    """The scale of the load cell is off."""

    name = "load_gain"
    channel = "load"
    formula: ClassVar = _one_form("measured W = W (1 + A)")
    in_drives = False


class LoadOffset(_Zero):
    """The zero of the load cell is off by 4 N."""

    name = "load_offset"
    channel = "load"
    formula: ClassVar = _one_form("measured W = W + A, N")
    typical: ClassVar = {"own": 4.0, "published": 4.0}
    in_drives = False


class ResistanceGain(_Gain):
    """The scale of the sensor of resistance is off."""

    name = "resistance_gain"
    channel = "resistance"
    formula: ClassVar = _one_form("measured R = R (1 + A)")
    in_drives = False


class ResistanceOffset(_Zero):
    """The zero of the sensor of resistance is off by 2 N."""

    name = "resistance_offset"
    channel = "resistance"
    formula: ClassVar = _one_form("measured R = R + A, N")
    typical: ClassVar = {"own": 2.0, "published": 2.0}
    in_drives = False


class RigFriction(HiddenEffect):
    """The rig itself resists: 6 % of the load."""

    name = "rig_friction"
    kind = "instrument"
    formula: ClassVar = _one_form("measured R = R + A W")
    typical: ClassVar = {"own": 0.06, "published": 0.06}
    in_drives = False

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        return value + self.amplitude * at.load if channel == "resistance" else value


class SlipResistance(HiddenEffect):
    """The measured resistance grows with slip, the sinkage does not: by half at slip 1."""

    name = "slip_resistance"
    kind = "instrument"
    formula: ClassVar = {
        "own": "measured R = R (1 + A (1 - exp(-2 i)) / (1 - exp(-2))), i > 0",
        "published": "measured R = R (1 + A i), i > 0",
    }
    typical: ClassVar = {"own": 0.5, "published": 0.5}
    in_drives = False

    def shown(self, channel: str, value: Array, at: Circumstances) -> Array:
        if channel != "resistance":
            return value
        slip = np.maximum(at.slip, 0.0)
        share = np.expm1(-2.0 * slip) / np.expm1(-2.0) if self.form == "own" else slip
        return np.asarray(value * (1.0 + self.amplitude * share))
