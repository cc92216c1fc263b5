"""Where explanations of the data are fitted: one noise, one set of runs, any effects.

An explanation is a set of effects added to the base model. All are fitted to the same observations
under the same noise, so that their likelihoods can be compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.candidates import Form
from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting.calibrate import Calibration
from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.layout import make_layout
from smallwheel_ros.fitting.observations import Observations
from smallwheel_ros.fitting.parameters import Layout, SoilPrior
from smallwheel_ros.fitting.solve import MixedFit, solve_mixed
from smallwheel_ros.model import Geometry, Model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Base:
    """What every explanation starts from: the model's geometry, thrust, effects, and known soils."""

    effects: tuple[Effect, ...] = ()
    geometry: Geometry = "contact_integral"
    thrust_form: ThrustForm = "integrated"
    soils: tuple[Soil, ...] = ()
    priors: Mapping[str, SoilPrior] | None = None

    def layout(self, observations: Observations, effects: Sequence[Effect] = ()) -> Layout:
        """What is fitted: the base with these effects added, corrections of thrust included."""
        return make_layout(
            observations,
            (*self.effects, *effects),
            self.geometry,
            soils=self.soils or None,
            priors=self.priors,
            thrust_form=self.thrust_form,
            corrections=True,
        )


@dataclass(frozen=True)
class Explanation:
    """Base and effects, fitted. cost: -2 log likelihood."""

    forms: tuple[Form, ...]
    layout: Layout
    predictor: Predictor
    fit: MixedFit

    @property
    def families(self) -> tuple[str, ...]:
        """The effects' names, in the order in which they were added."""
        return tuple(form.family for form in self.forms)

    @property
    def cost(self) -> float:
        """-2 log likelihood."""
        return self.fit.minus_two_log_likelihood

    @property
    def theta(self) -> Array:
        """All fitted parameters, those of the effects last."""
        return self.fit.solution.theta

    @property
    def residual(self) -> Array:
        """Measured less predicted."""
        return self.predictor.observations.value - self.fit.solution.predicted

    @property
    def design(self) -> Array:
        """Slopes by the parameters that are not at a bound."""
        return self.fit.solution.slopes[:, ~self.fit.solution.frozen]

    @property
    def precision(self) -> Array:
        """Of the prior of the same parameters."""
        free = ~self.fit.solution.frozen
        return self.layout.precision[np.ix_(free, free)]

    def model(self) -> Model:
        """The model with its fitted numbers."""
        return self.layout.model_at(self.theta)

    def covariance(self) -> Array:
        """Of all parameters; zero for one at its bound."""
        free = ~self.fit.solution.frozen
        full = np.zeros((free.size, free.size))
        block = self.fit.solution.information[np.ix_(free, free)]
        inverse = np.linalg.pinv(block, hermitian=True)
        full[np.ix_(free, free)] = self.fit.scatter.scale**2 * inverse
        return full

    def without(self, family: str) -> tuple[Form, ...]:
        """The forms of the other effects."""
        return tuple(form for form in self.forms if form.family != family)


class Workbench:
    """Fits explanations to one calibration's observations, and remembers them."""

    def __init__(self, calibration: Calibration, base: Base) -> None:
        self.calibration = calibration
        self.base = base
        self.observations = calibration.kept_observations
        self.effects = calibration.effects
        self.typical = calibration.typical
        self._known: dict[tuple[tuple[str, str], ...], Explanation] = {}
        self._common = calibration.layout.low.size

    def fit(
        self,
        forms: Sequence[Form],
        near: Explanation | None = None,
        strengths: Mapping[str, float] | None = None,
    ) -> Explanation:
        """Fit the base with these effects.

        near: a fitted explanation to start from. strengths: where an effect's first parameter starts.
        """
        key = tuple(sorted((f.family, f.effect.form) for f in forms))
        if key in self._known:
            return self._known[key]
        strengths = strengths or {}
        effects = []
        for form in forms:
            found = _found(near, form)
            if form.family in strengths:
                effects.append(form.at(strengths[form.family]))
            else:
                effects.append(found if found is not None else form.effect)
        layout = self.base.layout(self.observations, effects)
        start = layout.start
        source = self.calibration.fit.solution.theta if near is None else near.theta
        start[: self._common] = source[: self._common]
        tau = (self.calibration.fit if near is None else near.fit).scatter.tau
        predictor = Predictor(self.observations, layout)
        value = self.observations.value
        fit = solve_mixed(predictor, value, self.effects, self.typical, start, tau)
        # Where the pressure law itself changes, a linear guess may lead into the wrong valley.
        bent = [f for f in forms if f.family in strengths and f.effect.stage == "pressure_factor"]
        if bent:
            usual = start.copy()
            for j, slot in enumerate(layout.slots):
                if slot.of_effect and layout.owner_name(slot) == bent[0].family:
                    usual[j] = getattr(bent[0].effect, slot.field)
            other = solve_mixed(predictor, value, self.effects, self.typical, usual, tau)
            if other.minus_two_log_likelihood < fit.minus_two_log_likelihood:
                fit = other
        explanation = Explanation(tuple(forms), layout, predictor, fit)
        self._known[key] = explanation
        return explanation

    def strength(self, explanation: Explanation, family: str) -> float:
        """The fitted first parameter of one of its effects."""
        effect = self.effect(explanation, family)
        name = next(p.name for p in effect.parameters() if p.neutral is not None)
        return float(getattr(effect, name))

    def effect(self, explanation: Explanation, family: str) -> Effect:
        """One of its effects with its fitted numbers."""
        return next(e for e in explanation.model().effects if e.id == family)

    def known(self) -> list[Explanation]:
        """Everything that was fitted so far."""
        return list(self._known.values())


def _found(near: Explanation | None, form: Form) -> Effect | None:
    if near is None:
        return None
    for effect in near.model().effects:
        if effect.id == form.family and effect.form == form.effect.form:
            return effect
    return None
