"""What a diagnosis starts from: a table reduced to points, a base model, and its fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.fitting import FitResult, fit_points, result_of, usable_points
from smallwheel_ros.fitting.files import effect_parts, soil_priors, starting_soils
from smallwheel_ros.fitting.fit import Fit, Fitter, make_fitter
from smallwheel_ros.fitting.parameters import EffectPart, ParameterVector, SoilPrior
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.soils import parameter_vector
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.model import Geometry
from smallwheel_ros.model_file import CalibratedModel
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.physics.traction import ThrustForm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Base:
    """The model that is judged. effects: it has; parts: the same, with what is known of their numbers.

    soils: where to start, by name. priors: soils known beforehand.
    """

    effects: tuple[Effect, ...] = ()
    geometry: Geometry = "contact_integral"
    thrust_form: ThrustForm = "integrated"
    soils: tuple[Soil, ...] = ()
    priors: Mapping[str, SoilPrior] = field(default_factory=dict)
    parts: tuple[EffectPart, ...] = ()

    def vector(self, points: Points) -> ParameterVector:
        """The free parameters of the base on these points."""
        known = {part.id for part in self.parts}
        return parameter_vector(
            points,
            [e for e in self.effects if e.id not in known],
            self.geometry,
            parts=self.parts,
            soils=self.soils,
            priors=self.priors,
            thrust_form=self.thrust_form,
        )


def base_of(known: CalibratedModel, measurements: Measurements) -> Base:
    """What a diagnosis starts from, given a model file.

    Soils and effects are refitted within the file's covariance, where it has one and was not made
    from this data.
    """
    model = known.model
    return Base(
        model.effects,
        model.geometry,
        model.thrust_form,
        starting_soils(known, measurements),
        soil_priors(known, measurements),
        effect_parts(known, measurements),
    )


@dataclass(frozen=True)
class Problem:
    """A table, its points and the base model on them. outliers: rows that were left out."""

    measurements: Measurements
    points: Points
    outliers: NDArray[np.intp]
    base: Base

    @classmethod
    def of(cls, measurements: Measurements, base: Base | None = None) -> Problem:
        """Reduce a table. Raises FittingError where nothing usable was measured."""
        points, outliers = usable_points(measurements)
        return cls(measurements, points, outliers, base or Base())

    @cached_property
    def vector(self) -> ParameterVector:
        """The free parameters of the base."""
        return self.base.vector(self.points)

    @cached_property
    def _made(self) -> tuple[Fitter, Fit]:
        return make_fitter(self.points, self.vector)

    @property
    def fitter(self) -> Fitter:
        """Fits models to the points, all under the same levels."""
        return self._made[0]

    @property
    def fit(self) -> Fit:
        """The base, fitted."""
        return self._made[1]

    @cached_property
    def judged(self) -> Problem:
        """The channels that decide about effects: all, but drawbar pull only where it is alone.

        The law of thrust is wrong by a share of the load; it must not decide about sinkage.
        """
        if "drawbar_pull" not in self.points.channels or len(self.points.channels) == 1:
            return self
        return replace(self, points=self.points.without_channel("drawbar_pull"))

    def own(self, model: ParameterVector) -> ParameterVector:
        """A vector of the judged channels with the same effects, for all channels."""
        return replace(self.vector.with_parts(model.parts), geometry=model.geometry)

    def result(self, model: ParameterVector, theta: Array) -> FitResult:
        """A model fitted for people and for files, with the noise at its own level."""
        vector = self.own(model)
        known = dict(zip(model.names, theta, strict=True))
        start = np.array([known.get(p.name, p.start) for p in vector.free])
        fitter, fit = fit_points(self.points, vector, start)
        return result_of(fitter, fit, self.outliers)
