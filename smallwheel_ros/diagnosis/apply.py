"""Add effects to a model, and say what that does to the held-out error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smallwheel_ros.diagnosis.candidates import Family, list_families, measured_forces
from smallwheel_ros.diagnosis.geometry import NAME as GEOMETRY
from smallwheel_ros.diagnosis.geometry import on_the_integral
from smallwheel_ros.diagnosis.held_out import Errors, better, refitted
from smallwheel_ros.diagnosis.search import LEAST_FALL, best_form, plausible
from smallwheel_ros.diagnosis.workbench import Base, Explanation, Workbench
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting.calibrate import Calibration, calibrate
from smallwheel_ros.fitting.files import soil_priors, starting_soils
from smallwheel_ros.fitting.observations import Observations, observe
from smallwheel_ros.fitting.result import FitResult, result_of
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model_file import CalibratedModel


@dataclass(frozen=True)
class Added:
    """An effect that was added to a model. before, after: held-out errors.

    fall: relative fall of the error (of the channel that gains most). sigmas: the gain over its
    standard error. recommended: it falls by more than 5 % and by more than its standard error,
    plausibly.
    """

    effect: str
    form: str
    fit: FitResult
    before: Errors
    after: Errors
    fall: float
    sigmas: float
    recommended: bool
    reason: str


def base_of(known: CalibratedModel, measurements: Measurements) -> Base:
    """What a diagnosis starts from, given a model file: its geometry, thrust, effects and soils.

    The soils are refitted within their covariance, where the file has one and was not made from
    this data.
    """
    model = known.model
    return Base(
        model.effects,
        model.geometry,
        model.thrust_form,
        starting_soils(known, measurements),
        soil_priors(known, measurements) or None,
    )


def base_physics(base: Base, measurements: Measurements, registry: Registry | None = None) -> Base:
    """The base with the known physics whose columns the table has (slope), where it is not in yet."""
    present = {effect.id for effect in base.effects}
    added = []
    for name, forms in (registry or default_registry()).families.items():
        cls = forms[0]
        there = all(need in measurements.conditions for need in cls.needs)
        acts = cls.known_physics and cls.needs and there and name not in present
        if acts and any(np.any(measurements.conditions[need] != 0) for need in cls.needs):
            added.append(cls.suited_to(measurements.conditions))
    return Base((*added, *base.effects), base.geometry, base.thrust_form, base.soils, base.priors)


def held_out_rmse(base: Base, measurements: Measurements) -> dict[str, float]:
    """Held-out RMSE of the base fitted to these rows, by channel, m or N; empty with one run only."""
    observations = observe(measurements)
    if np.unique(observations.run).size < 2:
        return {}
    workbench = Workbench(calibrate(observations, base.layout(observations)), base)
    return refitted(workbench, workbench.fit(())).rmse()


def without_corrections(observations: Observations, explanation: Explanation) -> Calibration:
    """The explanation's model fitted for a model file, which has no place for corrections of thrust."""
    free = [s.owner >= 0 for s in explanation.layout.slots]
    layout = explanation.layout.only(np.array(free))
    return calibrate(observations, layout, start=explanation.theta[free])


def _family(families: list[Family], effect: str, registry: Registry | None) -> Family:
    for family in families:
        if family.name == effect:
            if family.blocked:
                raise EffectError(
                    f"effect '{effect}' cannot be fitted to this data: {family.blocked}"
                )
            return family
    (registry or default_registry()).family(effect)  # says what exists where there is none
    raise EffectError(f"effect '{effect}' cannot be fitted to this data: its column is not there")


def add_effect(
    effect: str,
    base: Base,
    measurements: Measurements,
    *,
    registry: Registry | None = None,
) -> Added:
    """Add one effect, in the form that fits best, and fit everything anew.

    Raises EffectError where there is no such effect or the data does not have what it needs.
    """
    observations = observe(measurements)
    present = [e.id for e in base.effects]
    families = list_families(
        observations,
        present,
        base.geometry,
        registry,
        measured_forces(measurements.units),
    )
    workbench = Workbench(calibrate(observations, base.layout(observations)), base)
    before = workbench.fit(())
    changed = workbench
    if effect == GEOMETRY and base.geometry == "closed_form":
        changed = Workbench(workbench.calibration, on_the_integral(base))
        after, form = changed.fit(()), "contact_integral"
    else:
        family = _family(families, effect, registry)
        after = workbench.fit((family.forms[0],), near=before)
        after = best_form(workbench, after, family)
        form = after.forms[0].effect.form
    errors = refitted(workbench, before), refitted(changed, after)
    fall, sigmas = better(*errors)
    sensible = plausible(after, effect)
    final = without_corrections(observations, after)
    reason = ""
    if fall < 0.0005:  # 0.0 %, as it would be printed
        reason = "the error did not fall; not recommended"
    elif fall < LEAST_FALL:
        reason = f"the error fell by {100 * fall:.1f} % only; not recommended"
    elif sigmas < 1.0:
        reason = "the error fell by less than its own uncertainty; not recommended"
    elif not sensible:
        reason = "what was fitted is at a bound or outside the published range; not recommended"
    return Added(
        effect,
        form,
        result_of(final),
        errors[0],
        errors[1],
        fall,
        sigmas,
        not reason,
        reason,
    )
