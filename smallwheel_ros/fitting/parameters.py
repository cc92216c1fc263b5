# SPDX-License-Identifier: Apache-2.0
"""The parameters of a fit, their priors, and the model that they define.

    theta = (ln p_ref, n, m [, phi, ln K, c and what a wheel does with them] of each soil; the numbers of each
             effect)

Soils have Gaussian priors, effects wide Gaussian ones in a fit and Student's t in a diagnosis. ln p_ref is
ln of the pressure at 10 mm of sinkage under a wheel of 0.2 m: k itself is the pressure at one metre, an
extrapolation whose error is tied to n and m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, stdtr

from smallwheel_ros.effects.base import Effect, Parameter
from smallwheel_ros.effects.instruments import SINKAGE_ZERO_FREEDOM, SINKAGE_ZERO_STD
from smallwheel_ros.fitting.constants import INSTRUMENT, STUDENT
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.sinkage import Geometry
from smallwheel_ros.physics.soil import SOIL_NUMBERS, Soil, k_from_reference
from smallwheel_ros.physics.traction import ThrustForm
from smallwheel_ros.physics.wheel import PRESSURE_PEAK, RIM_FRICTION, ROLLING_SHARE

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_STEP = 1e-4  # of the prior's deviation: finite differences


@dataclass(frozen=True)
class Prior:
    """Prior distribution of one parameter, in its unit.

    Attributes
    ----------
    centre
        Its centre.
    deviation
        Standard deviation of a Gaussian, scale of a Student's t.
    low, high
        Bounds of the parameter; a Student's t is truncated at them.
    freedom
        Degrees of freedom of Student's t; a Gaussian if infinite.
    """

    centre: float
    deviation: float
    low: float
    high: float
    freedom: float = np.inf

    @cached_property
    def _log_norm(self) -> float:
        if np.isinf(self.freedom):
            return float(np.log(self.deviation) + 0.5 * np.log(2.0 * np.pi))
        low, high = ((b - self.centre) / self.deviation for b in (self.low, self.high))
        inside = max(float(stdtr(self.freedom, high) - stdtr(self.freedom, low)), 1e-9)
        constant = gammaln((self.freedom + 1) / 2) - gammaln(self.freedom / 2)
        scale = np.log(inside * self.deviation) + 0.5 * np.log(self.freedom * np.pi)
        return float(scale - constant)

    def log_density(self, value: float) -> float:
        """Logarithm of the prior's density at a value, also outside the bounds."""
        u = (value - self.centre) / self.deviation
        if np.isinf(self.freedom):
            return -0.5 * u * u - self._log_norm
        tail = -(self.freedom + 1) / 2 * np.log1p(u * u / self.freedom)
        return float(tail) - self._log_norm

    def precision(self, value: float) -> float:
        """Precision of the Gaussian that touches the prior at a value and lies below it elsewhere."""
        u = (value - self.centre) / self.deviation
        weight = 1.0 if np.isinf(self.freedom) else (self.freedom + 1) / (self.freedom + u * u)
        return weight / self.deviation**2


def instrument_prior(p: Parameter, size: float) -> Prior:
    """Return the prior of a parameter of an instrument's fault, centred where there is no fault.

    Parameters
    ----------
    p
        Declared parameter of the fault, with bounds and unit.
    size
        Typical reading, in the parameter's unit; the scale of the prior is the share `INSTRUMENT` of it. Not
        used for a parameter in metres (a zero of sinkage), whose prior has the scale `SINKAGE_ZERO_STD`.

    Returns
    -------
    Prior
        A Student's t within the parameter's bounds.
    """
    if p.unit == "m":
        wide, freedom = SINKAGE_ZERO_STD, SINKAGE_ZERO_FREEDOM
    else:
        wide, freedom = INSTRUMENT * size, STUDENT
    return Prior(p.neutral or 0.0, wide, *p.bounds, freedom)


# Middle of what the soils of the library and of Wong (2008) show: n 0.1 to 1.6, |m| up to 0.5.
SOIL_PARAMETERS = {
    "log_reference_pressure": ("ln Pa", Prior(10.5, 3.0, 2.0, 20.0)),
    "n": ("1", Prior(0.9, 0.4, 0.05, 2.9)),
    "m": ("1", Prior(0.0, 0.6, -3.0, 3.0)),
}
# Dry sand under small wheels: phi 28 to 40 deg, c 0 to 1 kPa (Wong 2008; 21 to 31 deg and 200 to 2300 Pa in
# the pulls of nine rigs), K 5 to 25 mm.
STRENGTH_PARAMETERS = {
    "friction_angle": ("rad", Prior(0.576, 0.08, 0.1, 1.0)),
    "log_shear_displacement": ("ln m", Prior(float(np.log(0.012)), 0.6, -6.2, -2.8)),
    "cohesion": ("Pa", Prior(500.0, 500.0, 0.0, 20e3)),
}
# What a wheel does with that strength.
WHEEL_PARAMETERS = {
    "rolling_share": ("1", Prior(*ROLLING_SHARE, 0.0, 4.0)),
    "rim_friction": ("1", Prior(*RIM_FRICTION, 0.2, 1.5)),
    "pressure_peak": ("1", Prior(*PRESSURE_PEAK, 0.0, 0.8)),
}
# Where it was not measured.
USUAL_STRENGTH = {
    name: prior.centre for name, (_, prior) in (STRENGTH_PARAMETERS | WHEEL_PARAMETERS).items()
}


def soil_numbers(soil: Soil) -> dict[str, float]:
    """Return a soil's numbers by name as a fit uses them.

    ln p_ref (ln Pa) is added, and ln K (ln m) stands for the shear deformation modulus; all others are SI.
    """
    found = {name: float(getattr(soil, name)) for name in SOIL_NUMBERS}
    found["log_shear_displacement"] = float(np.log(found.pop("shear_displacement")))
    return found | {"log_reference_pressure": soil.log_reference_pressure}


def numbers_of_soil(known: Mapping[str, Any]) -> dict[str, Any]:
    """Return a soil's numbers by the names of `SOIL_NUMBERS`, SI, from those that a fit uses.

    Floats, or arrays of any shape.
    """
    found = {name: known[name] for name in SOIL_NUMBERS if name in known}
    found["shear_displacement"] = np.exp(known["log_shear_displacement"])
    found["k"] = k_from_reference(known["log_reference_pressure"], known["n"], known["m"])
    return found


def soil_from(soil: Soil, values: Mapping[str, float], name: str = "") -> Soil:
    """Return a soil with some of its numbers replaced.

    Parameters
    ----------
    soil
        Soil whose other numbers are kept.
    values
        New numbers by the names of a fit (`soil_numbers`): k is given by `log_reference_pressure` (ln Pa),
        the shear deformation modulus by `log_shear_displacement` (ln m), the others in SI units.
    name
        New name; the old one if empty.
    """
    made = numbers_of_soil(soil_numbers(soil) | dict(values))
    changes: dict[str, Any] = {number: float(value) for number, value in made.items()}
    return replace(soil, name=name or soil.name, **changes)


@dataclass(frozen=True)
class ParameterPrior:
    """Prior of a soil known from elsewhere, as from a model file.

    Attributes
    ----------
    soil
        The soil with the mean of the prior.
    covariance
        Covariance of (ln p_ref, n, m), shape (3, 3).
    """

    soil: Soil
    covariance: Array


@dataclass(frozen=True)
class FreeParameter:
    """One free parameter of a fit.

    Attributes
    ----------
    owner
        Name of the soil, or id of the effect, that the parameter belongs to.
    field
        Its name there, such as `n`.
    start
        Value to start from, in `unit`.
    unit
        As text; `1` if dimensionless, `ln Pa` for a logarithm.
    prior
        Its prior distribution and bounds.
    """

    owner: str
    field: str
    start: float
    unit: str
    prior: Prior

    @property
    def name(self) -> str:
        """The owner's name and its own, as `dry_sand.n` or `slip_sinkage.a`."""
        return f"{self.owner}.{self.field}"


@dataclass(frozen=True)
class EffectPart:
    """One effect of a fit: its free parameters, and the function that makes the effect from their values.

    Attributes
    ----------
    id
        Id of the effect.
    parameters
        Its free parameters.
    build
        Makes the effect from values by name, floats or arrays with an entry for each row.
    replaces
        Id of the effect in the model that it replaces; empty if it is added.
    """

    id: str
    parameters: tuple[FreeParameter, ...]
    build: Callable[[Mapping[str, Any]], Effect]
    replaces: str = ""

    @property
    def start(self) -> Array:
        """Starting values of its parameters, shape (parameters,)."""
        return np.array([p.start for p in self.parameters])


def part_of(
    effect: Effect, priors: Mapping[str, Prior] | None = None, replaces: str = ""
) -> EffectPart:
    """Make a part of a fit from an effect: all of its parameters are free and start at their present values.

    Parameters
    ----------
    effect
        Effect to fit.
    priors
        Priors by parameter name. A parameter without one has a Gaussian about its present value, with a
        standard deviation as large as the distance between its bounds.
    replaces
        Id of the effect in the model that the part replaces; empty if it is added.
    """
    values, listed = dict(effect.values()), []
    for p in effect.parameters():
        low, high = p.bounds
        prior = (priors or {}).get(p.name) or Prior(values[p.name], high - low, low, high)
        listed.append(FreeParameter(effect.id, p.name, float(values[p.name]), p.unit, prior))
    return EffectPart(effect.id, tuple(listed), partial(with_values, effect), replaces)


def with_values(effect: Effect, numbers: Mapping[str, Any]) -> Effect:
    """Return an effect with other values of some of its parameters.

    Parameters
    ----------
    effect
        Effect whose other values are kept.
    numbers
        New values by parameter name, SI. If any is an array, shape (rows,), values are not checked against
        the bounds.

    Returns
    -------
    Effect
        Of the same class; `effect` is unchanged.

    Raises
    ------
    EffectError
        If a single number is outside its bounds.
    """
    if all(np.ndim(v) == 0 for v in numbers.values()):
        return replace(effect, **{name: float(v) for name, v in numbers.items()})
    made = object.__new__(type(effect))
    made.__dict__.update(vars(effect) | dict(numbers))
    return made


@dataclass(frozen=True)
class ParameterVector:
    """The free parameters of a model and their joint prior; those of soils come first.

    Attributes
    ----------
    soils
        Soils whose numbers hold where no free parameter replaces them.
    geometry, thrust_form
        Rules of the model for load from sinkage, and for thrust.
    fixed
        Effects that are in the model and not fitted.
    parts
        Effects that are fitted.
    of_soils
        Free parameters of the soils; `base_size` is their number.
    soil_precision
        Precision of their joint Gaussian prior, shape (base_size, base_size).
    free, names
        All free parameters in order, first those of the soils, and their full names.
    start, bounds
        Starting values of all parameters, and their lower and upper bounds, shape (parameters,) each.
    centre, scale
        Centres and scales of the priors, shape (parameters,).
    log_density
        ln of the density of the soils' prior at its centre.
    soil_table
        For `soil_columns`: names of the soils' numbers, their values, shape (numbers, soils), and for each
        parameter of `of_soils` its row and column there.
    """

    soils: tuple[Soil, ...]
    geometry: Geometry
    thrust_form: ThrustForm
    fixed: tuple[Effect, ...]
    parts: tuple[EffectPart, ...]
    of_soils: tuple[FreeParameter, ...]
    soil_precision: Array
    free: tuple[FreeParameter, ...] = field(init=False)
    names: tuple[str, ...] = field(init=False)
    start: Array = field(init=False)
    bounds: tuple[Array, Array] = field(init=False)
    centre: Array = field(init=False)
    scale: Array = field(init=False)
    base_size: int = field(init=False)
    log_density: float = field(init=False)
    soil_table: tuple[tuple[str, ...], Array, Index] = field(init=False)

    def __post_init__(self) -> None:
        """Derive names, starting values, bounds and priors of all free parameters."""
        free = (*self.of_soils, *(p for part in self.parts for p in part.parameters))
        limits = np.array([(p.prior.low, p.prior.high) for p in free]).reshape(-1, 2)
        known = {soil.name: soil_numbers(soil) for soil in self.soils}
        soils, numbers = [*known], [*next(iter(known.values()), {})]
        held = np.array([[one[n] for one in known.values()] for n in numbers])
        of_soils = [p for p in self.of_soils if p.owner in known and p.field in numbers]
        places = [(numbers.index(p.field), soils.index(p.owner)) for p in of_soils]
        at_centre = np.linalg.slogdet(self.soil_precision / (2.0 * np.pi))[1]
        self.__dict__.update(
            free=free,
            names=tuple(p.name for p in free),
            start=np.array([p.start for p in free]),
            bounds=(limits[:, 0], limits[:, 1]),
            centre=np.array([p.prior.centre for p in free]),
            scale=np.array([p.prior.deviation for p in free]),
            base_size=len(self.of_soils),
            log_density=0.5 * float(at_centre),
            soil_table=(tuple(numbers), held, np.array(places, dtype=np.intp).reshape(-1, 2)),
        )

    def places(self, effect: str) -> Index:
        """Indices of that effect's parameters, shape (its parameters,)."""
        base = self.base_size
        mine = [j for j, p in enumerate(self.free[base:], base) if p.owner == effect]
        return np.array(mine, dtype=np.intp)

    def begun_at(self, other: ParameterVector, theta: Array) -> Array:
        """Return starting values: those of another vector for parameters of the same name, else `start`.

        Parameters
        ----------
        other
            Vector of a fit that is known.
        theta
            Values of its parameters, shape (parameters of other,).

        Returns
        -------
        ndarray
            Shape (parameters,).
        """
        known = dict(zip(other.names, theta, strict=True))
        return np.array([known.get(p.name, p.start) for p in self.free])

    def steps(self, theta: Array) -> Array:
        """Steps for finite differences, directed inward near a bound, shape (parameters,)."""
        h = _STEP * self.scale
        return np.where(theta + h > self.bounds[1], -h, h)

    def precision(self, theta: Array) -> Array:
        """Precision of the Gaussian that touches the prior at theta and lies below it elsewhere.

        Shape (parameters, parameters).
        """
        base = self.base_size
        full = np.zeros((theta.size, theta.size))
        full[:base, :base] = self.soil_precision
        for j in range(base, theta.size):
            full[j, j] = self.free[j].prior.precision(float(theta[j]))
        return full

    def log_prior(self, theta: Array) -> float:
        """Logarithm of the prior's density at theta."""
        base = self.base_size
        away = theta[:base] - self.centre[:base]
        value = self.log_density - 0.5 * float(away @ self.soil_precision @ away)
        others = zip(self.free[base:], theta[base:], strict=True)
        return value + sum(p.prior.log_density(float(v)) for p, v in others)

    def model(self, theta: Array) -> Model:
        """The model with these parameters, shape (parameters,)."""
        soils = [
            soil_from(soil, {p.field: float(v) for p, v in zip(self.of_soils, theta, strict=False)
                             if p.owner == soil.name})
            for soil in self.soils
        ]  # fmt: skip
        return Model(soils, self.geometry, self.effects(theta), self.thrust_form)

    def soil_columns(self, thetas: Array, codes: Index) -> dict[str, Array]:
        """Return each row's numbers of its soil, for rows that are repeated once for each parameter vector.

        Parameters
        ----------
        thetas
            Values of the parameters, shape (copies, parameters).
        codes
            Index of each row's soil in `soils`, shape (rows,).

        Returns
        -------
        dict of ndarray
            By the names of `SOIL_NUMBERS`, SI units, shape (copies * rows,): all rows of the first copy,
            then of the next.
        """
        names, held, places = self.soil_table
        known = np.repeat(held[:, None], len(thetas), axis=1)
        known[places[:, 0], :, places[:, 1]] = thetas[:, : self.base_size].T
        found = numbers_of_soil(dict(zip(names, known, strict=True)))
        return {n: v[:, codes].reshape(-1) for n, v in found.items()}

    def effects(self, numbers: Array) -> list[Effect]:
        """Return the effects of the model, for values of all parameters.

        `numbers` has the shape (parameters,), or (parameters, rows) for effects with a value for each row.
        A fitted effect stands in the place of the fixed one that it replaces, others after those.
        """
        found, j = list(self.fixed), self.base_size
        for part in self.parts:
            effect = part.build({p.field: numbers[j + i] for i, p in enumerate(part.parameters)})
            j += len(part.parameters)
            held = [i for i, e in enumerate(found) if e.id == part.replaces]
            if held:
                found[held[0]] = effect
            else:  # new, or what it replaces was a part itself and is gone
                found.append(effect)
        return found
