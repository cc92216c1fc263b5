# SPDX-License-Identifier: Apache-2.0
"""Combines models that the data could not tell apart (rivals) into one, for users that can run only one.

Its soil is the mean of theirs. At each stage, the change of a value is the mean of the changes by
the effects of each model. Means are weighted by the models' probabilities. To first order the combined
model predicts the mean of their predictions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from smallwheel_ros.effects.base import STAGES, Effect
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.stages import without_covariate
from smallwheel_ros.physics.soil import SOIL_NUMBERS, Soil, k_from_reference

# Stages whose effects multiply a value, or add to it; at the others each changes what it is given in turn.
_FACTORS = ("modulus_factor", "pressure_factor", "thrust_factor")
_SUMS = ("exponent_shift", "added_resistance")

Part = tuple[float, Sequence[Effect]]  # a model's probability and its effects


def mixed(calibrated: CalibratedModel) -> Model:
    """The single model that represents a model's rivals; the model itself where it has none.

    Where a rival has effects, the result has one effect, `mixture`, in place of all of them.
    """
    if not calibrated.rivals:
        return calibrated.model
    parts = [(share, rival.model) for share, rival in calibrated.rivals]
    soils = [
        _mean_soil(soil, [(share, one.soils[i]) for share, one in parts])
        for i, soil in enumerate(calibrated.soils)
    ]
    effect = _mean_effect([(share, one.effects) for share, one in parts])
    effects = (effect,) if effect.acts else ()
    return Model(soils, calibrated.geometry, effects, calibrated.thrust_form)


def rivals_text(calibrated: CalibratedModel) -> str:
    """The rivals of a model and their probabilities, in words: `slip sinkage (0.60), no effect (0.40)`."""
    shares: dict[str, float] = {}  # forms of one effect are one to a reader
    for share, rival in calibrated.rivals:
        name = " and ".join(e.id.replace("_", " ") for e in rival.effects) or "no effect"
        shares[name] = shares.get(name, 0.0) + share
    return ", ".join(f"{n} ({p:.2f})" for n, p in sorted(shares.items(), key=lambda one: -one[1]))


def _mean_soil(soil: Soil, parts: Sequence[tuple[float, Soil]]) -> Soil:
    """The mean soil, named like the first argument: the means of ln p_ref and of each other number."""
    means = {
        name: sum(share * float(getattr(one, name)) for share, one in parts)
        for name in SOIL_NUMBERS
    }
    pressure = sum(share * one.log_reference_pressure for share, one in parts)
    means["k"] = float(k_from_reference(pressure, means["n"], means["m"]))
    return Soil(soil.name, source=soil.source, **means)


def _mean_effect(parts: Sequence[Part]) -> Effect:
    """One effect whose action at each stage is the mean of the actions of several models' effects."""
    acting = {stage for _, effects in parts for effect in effects for stage in effect.acts}
    if "sinkage" in acting:  # by default soil is compacted to the depth that is dug
        acting.add("compaction_sinkage")
    every = [effect for _, effects in parts for effect in effects]
    body: dict[str, Any] = {
        "id": "mixture",
        "summary": "What several models, which the data could not tell apart, do in the mean.",
        "needs": tuple(dict.fromkeys(name for effect in every for name in effect.needs)),
        "drivers": tuple(dict.fromkeys(name for effect in every for name in effect.drivers)),
    }
    body |= {stage: _mean_stage(parts, stage) for stage in STAGES if stage in acting}
    made: Effect = type("Mixture", (Effect,), body)()
    return made


def _mean_stage(parts: Sequence[Part], stage: str) -> Callable[..., Any]:
    """A method for one stage that returns the mean over the models of what their effects return."""

    def of_one(effects: Sequence[Effect], *given: Any) -> Any:
        *_, conditions = given
        rolling = conditions.rolling

        def result(effect: Effect, neutral: Any, *arguments: Any) -> Any:
            return without_covariate(getattr(effect, stage)(*arguments), neutral, rolling)

        if stage in _FACTORS:
            return math.prod((result(e, 1.0, *given) for e in effects), start=1.0)
        if stage in _SUMS:
            return sum((result(e, 0.0, *given) for e in effects), 0.0)
        value, _ = given
        for effect in effects:
            value = result(effect, value, value, conditions)
        return value

    def mean(_self: Effect, *given: Any) -> Any:
        return sum(share * of_one(effects, *given) for share, effects in parts)

    return mean
