# SPDX-License-Identifier: Apache-2.0
"""A model of wheel and soil: soils, a geometry rule, and effects, composed with `+`.

model = Model("dry_sand") + SlipSinkage(a=1.2)
prediction = predict(model, Conditions.of(load=60, diameter=0.2, width=0.1, slip=0.3))
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.common.result import Result
from smallwheel_ros.effects.base import Effect, WheelState
from smallwheel_ros.effects.registry import Registry, as_effect, known_physics
from smallwheel_ros.model.measured import Measured
from smallwheel_ros.model.stages import LoadedRows, Stages, guarded
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.contact import AXLE_RATIO, contact_sinkage
from smallwheel_ros.physics.sinkage import (
    Geometry,
    closed_form_sinkage,
    compaction_resistance,
    layered_work,
    loads_by_depth,
    plate_sinkage,
    solve_layered,
)
from smallwheel_ros.physics.soil import SOIL_NUMBERS, Soil, soil
from smallwheel_ros.physics.stresses import ShearLaw, WheelForces, rim_friction, wheel_forces
from smallwheel_ros.physics.traction import (
    ThrustForm,
    contact_length,
    thrust,
)

Array = NDArray[np.float64]
_DEEPEST_PLATE = 3.0  # diameters: no plate is pressed deeper
# Angle of the largest pressure over the entry angle, c1 + c2 i, as quoted for sands (Wong and Reece 1967; c1
# and c2 are 0.2 to 0.4 each, not read in the original).
_PEAK, _PEAK_BY_SLIP = 0.4, 0.3
_ROUNDED = 0.005 + 1e-9  # what rounding to two digits may do to a probability
GEOMETRIES: tuple[Geometry, ...] = get_args(Geometry)


class ModelError(SmallwheelError):
    """A model that cannot predict these conditions."""


@dataclass(frozen=True, repr=False)
class Model(Result, shown="model.model_file"):
    """Soils, geometry rule and effects in the order in which they act.

    Soils and effects may be given by name:

    >>> Model("dry_sand") + "slip_sinkage"
    <Model: dry_sand, contact integral, with slip sinkage>

    Attributes
    ----------
    soils
        One soil, which holds for every row, or several, of which each row's `Conditions.soil` names one.
    geometry
        How the outline of the wheel carries the load: `contact_integral` or `closed_form`.
    effects
        An effect that is a geometry rule (`contact_geometry`) is not kept: it sets `geometry`.
    thrust_form
        The law of thrust, one of `physics.traction.ThrustForm`.

    Raises
    ------
    ModelError
        Without a soil, and for a geometry or thrust form that does not exist.
    """

    soils: tuple[Soil, ...]
    geometry: Geometry = "contact_integral"
    effects: tuple[Effect, ...] = ()
    thrust_form: ThrustForm = "stress_integral"

    def __init__(
        self,
        soils: Soil | str | Sequence[Soil | str],
        geometry: Geometry = "contact_integral",
        effects: Sequence[Effect | type[Effect] | str] = (),
        thrust_form: ThrustForm = "stress_integral",
    ) -> None:
        given = (
            tuple(soils) if isinstance(soils, Iterable) and not isinstance(soils, str) else (soils,)
        )
        taken = tuple(soil(one) if isinstance(one, str) else one for one in given)
        for one in taken:
            if not isinstance(one, Soil):
                raise ModelError(f"soils: found {type(one).__name__}, expected a soil or its name")
        made = tuple(map(as_effect, effects))
        for effect in made:
            if effect.geometry:
                geometry = cast(Geometry, effect.geometry)
        for what, value, known in (
            ("geometry", geometry, GEOMETRIES),
            ("thrust form", thrust_form, get_args(ThrustForm)),
        ):
            if value not in known:
                raise ModelError(f"no {what} '{value}': {nearest(value, list(known))}")
        object.__setattr__(self, "soils", taken)
        object.__setattr__(self, "geometry", geometry)
        object.__setattr__(self, "effects", tuple(e for e in made if not e.geometry))
        object.__setattr__(self, "thrust_form", thrust_form)
        if not self.soils:
            raise ModelError("a model needs at least one soil")

    def __add__(self, effect: Effect | type[Effect] | str) -> Model:
        """The model with one more effect, which acts last; the effect itself, its class or its id."""
        return replace(self, effects=(*self.effects, as_effect(effect)))

    @classmethod
    def load(cls, path: str | PathLike[str], effects: Registry | None = None) -> CalibratedModel:
        """Read a model file, with its statement of uncertainty.

        Parameters
        ----------
        path
            The file, YAML.
        effects
            Effects that the file may name (`smallwheel_ros.effects.load`, for your own); if not given, those
            of the package and of installed packages.

        Raises
        ------
        ModelFileError
            If it cannot be used; the message names file, key, what was found and what was expected.
        """
        read = cls._view("read_model")
        assert read is not None
        loaded: CalibratedModel = read(Path(path), effects)
        return loaded

    from_file = load

    def headline(self) -> str:
        """Names of the soils, the geometry and the effects, in one line."""
        names = ", ".join(one.name for one in self.soils)
        effects = " and ".join(effect.id.replace("_", " ") for effect in self.effects)
        rule = self.geometry.replace("_", " ")
        return f"{names}, {rule}" + (f", with {effects}" if effects else "")

    def acting(self, conditions: Conditions) -> tuple[Effect, ...]:
        """All effects that a prediction applies: known physics whose columns exist, then the model's own.

        Known physics (`Effect.known_physics`, such as gravity on a slope) need not be in the model.
        """
        present = {effect.id for effect in self.effects}
        known = [
            form()
            for form in known_physics()
            if form.id not in present and all(name in conditions for name in form.needs)
        ]
        return (*known, *self.effects)

    def cautions(self, conditions: Conditions) -> tuple[str, ...]:
        """Warnings of the effects about rows outside the range in which they are known to hold."""
        found = [guarded(e, "caution", e.caution, conditions) for e in self.effects]
        return tuple(said for said in found if said)


class CalibratedModel(Model):
    """A model with the uncertainty and the provenance of its parameters.

    Attributes
    ----------
    names, covariance
        Names of the fitted parameters, and their covariance in the product of their SI units, shape (names,
        names): `SOIL.log_reference_pressure`, `SOIL.n`, `SOIL.m`, with drawbar pull or torque the soil's
        strength too (`model_file.SOIL_PARAMETERS`), and `EFFECT.PARAMETER`. Empty if the uncertainty is
        unknown.
    provenance
        Where the model comes from, as texts and numbers by name: data, sha256, date, held_out_rmse and so on.
    measured
        Ranges and scatter of the data.
    rivals
        Probability and model of each of those that the data could not tell apart; a prediction is then their
        mixture. Rounded probabilities are scaled so that they sum to 1. Empty where one model stands alone.

    Raises
    ------
    ModelError
        If the probabilities of the rivals do not sum to 1 within rounding.
    """

    names: tuple[str, ...]
    covariance: Array
    provenance: Mapping[str, Any]
    measured: Measured
    rivals: tuple[tuple[float, CalibratedModel], ...]

    def __init__(
        self,
        model: Model,
        names: tuple[str, ...] = (),
        covariance: Array | None = None,
        provenance: Mapping[str, Any] | None = None,
        measured: Measured | None = None,
        rivals: Sequence[tuple[float, CalibratedModel]] = (),
    ) -> None:
        super().__init__(model.soils, model.geometry, model.effects, model.thrust_form)
        known = {
            "names": names,
            "covariance": np.zeros((0, 0)) if covariance is None else covariance,
            "provenance": provenance or {},
            "measured": measured or Measured(),
            "rivals": _whole(rivals),
        }
        for name, value in known.items():
            object.__setattr__(self, name, value)

    def __eq__(self, other: object) -> bool:
        """Whether all is equal but the provenance, which is for people."""
        if not isinstance(other, CalibratedModel):
            return NotImplemented
        return (
            self.model == other.model
            and self.names == other.names
            and np.array_equal(self.covariance, other.covariance)
            and self.measured.plain() == other.measured.plain()
            and self.rivals == other.rivals
        )

    __hash__ = Model.__hash__

    def changed(self, **parts: Any) -> CalibratedModel:
        """A copy with other values for some of the constructor's arguments, given by name."""
        known: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("model", "names", "covariance", "provenance", "measured", "rivals")
        }
        return CalibratedModel(**known | parts)

    @property
    def model(self) -> Model:
        """The model without its uncertainty."""
        return Model(self.soils, self.geometry, self.effects, self.thrust_form)

    def __add__(self, effect: Effect | type[Effect] | str) -> CalibratedModel:
        """The model with one more effect, whose parameters' uncertainty is unknown, and without rivals."""
        return self.changed(model=self.model + effect, rivals=())

    def standard_deviation(self, name: str) -> float | None:
        """Standard deviation of a parameter, named as in `names`, in its unit; None if unknown."""
        if name not in self.names:
            return None
        at = self.names.index(name)
        return float(np.sqrt(self.covariance[at, at]))


def _whole(
    rivals: Sequence[tuple[float, CalibratedModel]],
) -> tuple[tuple[float, CalibratedModel], ...]:
    """Scale rivals' probabilities to sum to 1. Raises ModelError where they miss it by more than rounding."""
    total = sum(share for share, _ in rivals)
    if rivals and not abs(total - 1.0) <= _ROUNDED * len(rivals):
        raise ModelError(
            f"the probabilities of the rivals sum to {total:.4g}, expected 1: one is missing, or there twice"
        )
    return tuple((share / total, rival) for share, rival in rivals)


@dataclass(frozen=True)
class Prediction:
    """Predictions for each row; arrays of shape (rows,), SI units.

    Attributes
    ----------
    sinkage, resistance
        m, N, as the instruments would show them.
    true_sinkage, true_resistance
        The same without errors of instruments; equal if the model has no effect of an instrument.
    compaction_resistance
        N, the part of true_resistance due to compaction: the work of pressing a metre of rut (eq. 14 of
        Meirion-Griffith and Spenko 2011).
    thrust, rolling_resistance, drawbar_pull, torque
        N, torque in N m; None if the conditions have no slip, 0 in rows that do not roll. rolling_resistance
        is that of a wheel that carries its load by pressure and shear, effects included, and drawbar_pull is
        thrust less rolling_resistance. With the thrust forms `integrated` and `exponential`,
        rolling_resistance is true_resistance.
    immobilised
        Whether the wheel is sunk to its axle; its numbers are then a continuation for fits, not predictions.
    """

    sinkage: Array
    compaction_resistance: Array
    resistance: Array
    immobilised: NDArray[np.bool_]
    true_sinkage: Array
    true_resistance: Array
    thrust: Array | None = None
    rolling_resistance: Array | None = None
    drawbar_pull: Array | None = None
    torque: Array | None = None


def _soil_columns(model: Model, conditions: Conditions) -> dict[str, Array]:
    """The numbers `SOIL_NUMBERS` of each row's soil, by name, shape (rows,) each."""
    if len(model.soils) == 1:
        rows: NDArray[np.intp] = np.zeros(len(conditions), dtype=np.intp)
    else:
        known = [s.name for s in model.soils]
        if conditions.soil is None:
            raise ModelError(
                f"the model has several soils ({', '.join(known)}) and the rows name none"
            )
        present = np.unique(conditions.soil)
        unknown = [str(name) for name in present if name not in known]
        if unknown:
            raise ModelError(f"the model has no soil '{unknown[0]}': {nearest(unknown[0], known)}")
        order = np.argsort(known)
        rows = order[np.searchsorted(np.asarray(known)[order], conditions.soil)]
    return {name: np.array([getattr(s, name) for s in model.soils])[rows] for name in SOIL_NUMBERS}


def _static_sinkage(
    model: Model, stages: Stages, wheel: LoadedRows
) -> tuple[Array, NDArray[np.bool_]]:
    """Sinkage (m) at which the soil carries the load, before any digging, and rows sunk to the axle.

    By each row's contact: of a plate, a pressed or a rolling wheel; both of shape (rows,).
    """
    conditions, plate = stages.conditions, stages.conditions.plate
    load, diameter, modulus, n = wheel
    # A pressed wheel meets the soil on both sides of its lowest point: each side carries half.
    carried = np.where(conditions.pressed, 0.5 * load, load)
    width = np.where(plate, diameter, conditions.width)
    if stages.layered:
        z, sunk = _layered_sinkage(stages, wheel._replace(load=carried), width)
    elif plate.all():
        return plate_sinkage(load, diameter, modulus, n), np.zeros(len(conditions), dtype=bool)
    elif model.geometry == "closed_form":
        bad = np.flatnonzero(~(n < 3.0))
        if bad.size:
            raise ModelError(
                f"the closed form needs n < 3, row {bad[0] + 1} has n = {n[bad[0]]:.3g}; "
                "the contact integral (geometry contact_integral) has no such limit"
            )
        z = closed_form_sinkage(carried, diameter, width, modulus, n)
        sunk = z > AXLE_RATIO * diameter
    else:
        solved = contact_sinkage(carried, diameter, width, modulus, n, with_exponent=False)
        z, sunk = solved.sinkage, solved.sunk_to_axle
    if plate.any() and not stages.layered:
        z = np.where(plate, plate_sinkage(load, diameter, modulus, n), z)
    return z, sunk & ~plate


def _layered_sinkage(
    stages: Stages, wheel: LoadedRows, width: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """As `_static_sinkage`, where effects make pressure other than a power of depth."""
    load, diameter, modulus, n = wheel
    factor, plate = stages.pressure_factor, stages.conditions.plate

    def load_at(z: Array) -> Array:
        on_plate = np.pi / 4.0 * diameter**2 * modulus * z**n * factor(z) if plate.any() else load
        if plate.all():
            return on_plate
        depth, borne = loads_by_depth(z, diameter, width, modulus, n)
        return np.where(plate, on_plate, np.sum(borne * factor(depth), axis=0))

    return solve_layered(load, np.where(plate, _DEEPEST_PLATE, 0.5) * diameter, load_at)


def _check_covariates(model: Model, effects: Sequence[Effect], conditions: Conditions) -> None:
    """Check that the effects can be computed on these rows.

    Raises ModelError where one lacks a column, has a blank in a rolling row, or objects to the rows.
    """
    lacking = [(e.id, name) for e in model.effects for name in e.needs if name not in conditions]
    for id, name in lacking:
        there = ", ".join(("load", "diameter", "width", *conditions.covariates))
        raise ModelError(f"effect '{id}' needs the column '{name}'. The columns are {there}")
    for effect in effects:
        for name in effect.needs:
            blank = np.flatnonzero(np.isnan(conditions[name]) & conditions.rolling)
            if blank.size:
                raise ModelError(
                    f"effect '{effect.id}' needs '{name}', which is blank in row {blank[0] + 1}, "
                    "a rolling wheel"
                )
        objection = guarded(effect, "objection", effect.objection, conditions)
        if objection:
            raise ModelError(f"effect '{effect.id}': {objection}")


def predict(
    model: Model,
    conditions: Conditions,
    *,
    with_forces: bool = True,
    soil: Mapping[str, Array] | None = None,
) -> Prediction:
    """Predict sinkage and resistance of each row, and with slip thrust, drawbar pull and torque.

    Parameters
    ----------
    model
        Soils, geometry, effects and law of thrust.
    conditions
        Settings, SI units, shape (rows,) each; the load is what the load cell shows.
    with_forces
        Whether to compute thrust, pull and torque, which take a third of the time; only where there is slip.
    soil
        The numbers `SOIL_NUMBERS` by name, shape (rows,) each, in place of those of the model's soils.

    Returns
    -------
    Prediction
        Arrays of shape (rows,).

    Raises
    ------
    ModelError
        Where an effect's covariate or a rolling row's slip is missing, an effect objects to the rows, or a
        row's soil is not the model's.
    EffectError
        Where an effect fails, or makes a load or a diameter that is not above 0.
    """
    effects = model.acting(conditions)
    _check_covariates(model, effects, conditions)
    stages = Stages(effects, conditions)
    conditions = stages.conditions  # with the load itself
    soil = soil or _soil_columns(model, conditions)
    rolling = stages.rolling
    wheel = stages.loaded(soil["k"], soil["n"], soil["m"])
    load, diameter, modulus, n = wheel
    static, sunk = _static_sinkage(model, stages, wheel)
    if model.thrust_form == "wong_reece" and "slip" in conditions:
        deeper, sunk_deeper = _with_shear(stages, soil, wheel)
        static, sunk = np.where(rolling, deeper, static), np.where(rolling, sunk_deeper, sunk)
    z = stages.change("sinkage", static)
    compacted = z
    if stages.acting_at("compaction_sinkage"):
        compacted = static
        for effect in effects:
            if not {"sinkage", "compaction_sinkage"}.isdisjoint(effect.acts):
                deeper = stages.call(effect, "compaction_sinkage", compacted, compacted)
                compacted = np.where(rolling, deeper, compacted)
    if stages.layered and rolling.any():
        work = layered_work(compacted, modulus, n, stages.pressure_factor)
        compaction = conditions.width * work
    else:
        compaction = compaction_resistance(compacted, conditions.width, modulus, n)
    strength = (soil["cohesion"], soil["friction_angle"])
    state = WheelState(load, diameter, conditions.width, z, modulus, n, *strength)
    added = np.zeros(len(conditions)) + stages.total("added_resistance", state)
    if not stages.all_rolling:
        compaction, added = (np.where(rolling, a, 0.0) for a in (compaction, added))
    resistance = compaction + added
    forces = None
    if with_forces and "slip" in conditions:
        forces = _forces(model, stages, soil, state, compaction)
    prediction = Prediction(
        sinkage=stages.change("measured_sinkage", z),
        compaction_resistance=compaction,
        resistance=stages.change("measured_resistance", resistance),
        immobilised=sunk | ((z > AXLE_RATIO * diameter) & ~conditions.plate),
        true_sinkage=z,
        true_resistance=resistance,
    )
    if forces is None:
        return prediction
    return replace(
        prediction,
        thrust=forces.thrust,
        rolling_resistance=forces.resistance + added,
        drawbar_pull=forces.thrust - forces.resistance - added,
        torque=forces.torque,
    )


def _slip(stages: Stages) -> Array:
    slip = stages.conditions["slip"]
    blank = np.flatnonzero(np.isnan(slip) & stages.rolling)
    if blank.size:
        raise ModelError(f"slip is blank in row {blank[0] + 1}, a rolling wheel")
    return np.nan_to_num(slip)


def _optional(conditions: Conditions, name: str) -> Array:
    """A covariate, shape (rows,); 0 in rows where it is blank, and everywhere if there is no such column."""
    return np.nan_to_num(conditions[name]) if name in conditions else np.zeros(len(conditions))


def _wong_reece(soil: Mapping[str, Array], slip: Array, pressure: Array) -> dict[str, Any]:
    """Keyword arguments of `wheel_forces` for the law of Wong and Reece (1967); pressure: Pa, (rows,)."""
    shear = ShearLaw(soil["cohesion"], soil["friction_angle"], soil["shear_displacement"])
    peak = _PEAK + _PEAK_BY_SLIP * np.maximum(slip, 0.0)
    return {"shear": shear, "peak": peak, "pressure": pressure}


def _with_shear(
    stages: Stages, soil: Mapping[str, Array], wheel: LoadedRows
) -> tuple[Array, NDArray[np.bool_]]:
    """Sinkage (m) at which pressure and shear carry the load together, and rows sunk to the axle.

    After Wong and Reece (1967); for rolling wheels, both of shape (rows,).
    """
    load, diameter, modulus, n = wheel
    slip, width = _slip(stages), np.nan_to_num(stages.conditions.width, nan=1.0)

    def load_at(z: Array) -> Array:
        law = _wong_reece(soil, slip, modulus * z**n)
        return np.maximum(wheel_forces(load, z, diameter, width, slip, n, **law).load, 1e-9)

    return solve_layered(load, 0.5 * diameter, load_at)


def _forces(
    model: Model, stages: Stages, soil: Mapping[str, Array], state: WheelState, compaction: Array
) -> WheelForces:
    """Thrust and the resistance to subtract from it for the pull (N), and torque (N m), shape (rows,).

    0 in rows that do not roll. compaction: N, which is that resistance in all forms of thrust but those from
    stresses along the contact.
    """
    slip, conditions = _slip(stages), stages.conditions
    at = (state.load, state.sinkage, state.diameter, np.nan_to_num(state.width, nan=1.0), slip)
    if model.thrust_form == "stress_integral":
        lugs = _optional(conditions, "grouser_height")
        found = wheel_forces(
            *at, state.exponent,
            ShearLaw(
                state.cohesion, state.friction_angle, soil["shear_displacement"],
                soil["rolling_share"], rim_friction(soil["rim_friction"], lugs),
            ),
            lug_height=lugs,
            peak=soil["pressure_peak"] * np.maximum(slip, 0.0),
            slip_angle=_optional(conditions, "slip_angle"),
            factor=stages.pressure_factor if stages.layered else None,
        )  # fmt: skip
    elif model.thrust_form == "wong_reece":
        pressure = state.modulus * np.maximum(state.sinkage, 0.0) ** state.exponent
        found = wheel_forces(*at, state.exponent, **_wong_reece(soil, slip, pressure))
    else:
        load, sinkage, diameter, width, _ = at
        strength = (state.cohesion, state.friction_angle, soil["shear_displacement"])
        push = thrust(load, slip, sinkage, diameter, width, *strength, model.thrust_form)
        # The lever where shear stress is the same along the arc: r theta / sin theta.
        entry = 2.0 * contact_length(sinkage, diameter) / diameter
        found = WheelForces(push, compaction, push * 0.5 * diameter / np.sinc(entry / np.pi), load)
    share = stages.product("thrust_factor", state)
    found = found._replace(thrust=found.thrust * share, torque=found.torque * share)
    if stages.all_rolling:
        return found
    return WheelForces(*(np.where(stages.rolling, values, 0.0) for values in found))
