"""Which effects could be missing from a model, as far as this data has what they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.effects.base import Effect, Parameter
from smallwheel_ros.effects.registry import Registry, covariate, default_registry
from smallwheel_ros.fitting.observations import Observations
from smallwheel_ros.physics.conditions import ROLLING, Conditions

Array = NDArray[np.float64]

# What a column of section 5 stands for: any other is a covariate that nobody has a law for.
STANDARD = ("slip", "slip_angle", "slope", "speed", "pass_number", "grouser_height", "moisture")
# Families whose driver is not a covariate.
_DRIVERS = {
    "load_dependent_modulus": ("load",),
    "width_dependent_modulus": ("width",),
}
_KNOWN = "known physics: applied by default where its columns are there, not a discovery"
_GEOMETRY = "the base model has this geometry already"
_FEWEST_VALUES = 8  # runs with different values that an unknown column must have
_KINEMATIC = 0.02


@dataclass(frozen=True)
class Form:
    """One form of a family, ready to be fitted."""

    family: str
    effect: Effect

    @property
    def parameter(self) -> Parameter:
        """The strength: the first parameter that has a value at which the effect is absent."""
        return next(p for p in self.effect.parameters() if p.neutral is not None)

    @property
    def neutral(self) -> float:
        """The strength at which the effect is absent."""
        return float(self.parameter.neutral or 0.0)

    @property
    def one_sided(self) -> bool:
        """Whether the strength can only be over its neutral value."""
        return self.parameter.bounds[0] >= self.neutral

    def at(self, strength: float, **shape: float) -> Effect:
        """The effect at that strength, within its bounds."""
        low, high = self.parameter.bounds
        values = {self.parameter.name: float(np.clip(strength, low, high)), **shape}
        return replace(self.effect, **values)

    def shapes(self) -> list[dict[str, float]]:
        """Values of the parameters that only shape the effect: where they start, and further off."""
        found: list[dict[str, float]] = [{}]
        for p in self.effect.parameters():
            if p.neutral is None:
                low, high = p.bounds
                if low > 0 and high / low > 20:
                    apart = [p.start / 2.5, p.start * 2.5]
                else:
                    apart = [low + 0.25 * (high - low), low + 0.75 * (high - low)]
                found += [{p.name: float(np.clip(v, low, high))} for v in apart]
        return found


@dataclass(frozen=True)
class Family:
    """One physical idea. drivers: the columns that it follows. blocked: why it cannot be tested."""

    name: str
    forms: tuple[Form, ...]
    drivers: tuple[str, ...]
    blocked: str = ""


def settings_of(observations: Observations) -> dict[str, Array]:
    """What was set or recorded, by row: load, diameter, width and every covariate."""
    c = observations.conditions
    columns = {"load": c.load, "diameter": c.diameter, "width": c.width}
    return columns | dict(c.covariates)


def run_means(observations: Observations, column: Array) -> Array:
    """Mean of a column in each run that has observations, shape (runs met,)."""
    _, codes = np.unique(observations.run, return_inverse=True)
    codes = codes.reshape(-1)
    total = np.bincount(codes, column[observations.row])
    return np.asarray(total / np.bincount(codes))


def varies(column: Array) -> bool:
    """Whether a column differs by more than its rounding."""
    size = np.max(np.abs(column), initial=0.0)
    return bool(size > 0 and np.ptp(column) > 2e-3 * size)


def kinematic(conditions: Conditions) -> tuple[str, ...]:
    """Columns that say again what slip and speed say: the rim's speed is speed / (1 - slip)."""
    if "slip" not in conditions or "speed" not in conditions:
        return ()
    slip, speed = conditions["slip"], conditions["speed"]
    with np.errstate(divide="ignore", invalid="ignore"):
        rim = np.where(slip >= 0, speed / np.maximum(1.0 - slip, 1e-9), speed * (1.0 + slip))
    found = []
    for name, column in conditions.covariates.items():
        if name in STANDARD or not varies(column) or not varies(slip):
            continue
        size = float(np.median(np.abs(rim)))
        ratio = float(rim @ column) / max(float(rim @ rim), 1e-300)
        left = column - ratio * rim
        if np.sqrt(np.mean(left**2)) < _KINEMATIC * abs(ratio) * max(size, float(np.std(rim))):
            found.append(name)
    return tuple(found)


def _why_not(name: str, needs: Sequence[str], observations: Observations) -> str:
    columns = settings_of(observations)
    for need in needs:
        if need not in columns:
            return f"the data has no column '{need}'"
        used = columns[need][np.unique(observations.row)]
        rolling = observations.conditions.contact[np.unique(observations.row)] == ROLLING
        if need not in ("load", "width", "diameter"):
            used = used[rolling]
        if used.size == 0 or not varies(used):
            value = f" ({used[0]:.4g} in every row)" if used.size else ""
            return f"{need} never varies in this data{value}"
        if name == "slip_sinkage" and np.mean(used > 0.02) == 0:
            return "no row has a driven wheel that slips (slip over 0.02)"
        if name == "skid_sinkage" and np.mean(used < -0.02) == 0:
            return "no row has a wheel that skids (slip under -0.02)"
        if need == "pass_number" and used.max() < 2:
            return "no row is of a second pass"
    return ""


def measured_forces(units: Mapping[str, str]) -> tuple[str, ...]:
    """Columns in units of force or torque beside the load: what a run gave, not what was set."""
    known = ("load", "resistance", "drawbar_pull")
    return tuple(
        name for name, unit in units.items() if unit in ("N", "N*m", "N m") and name not in known
    )


def _generic(name: str, observations: Observations) -> str:
    """Why a column that nobody has a law for cannot be tested, or an empty string."""
    means = run_means(observations, settings_of(observations)[name])
    distinct = np.unique(np.round(means / max(np.ptp(means), 1e-300), 3)).size
    if distinct < min(_FEWEST_VALUES, means.size) and distinct < 3:
        return f"'{name}' has only {distinct} values in {means.size} runs"
    if means.size < _FEWEST_VALUES:
        return (
            f"{means.size} runs are too few for a column without a known law "
            f"(at least {_FEWEST_VALUES})"
        )
    return ""


def list_families(
    observations: Observations,
    present: Sequence[str] = (),
    geometry: str = "contact_integral",
    registry: Registry | None = None,
    responses: Sequence[str] = (),
) -> list[Family]:
    """Every family, the extra columns' too, with the reason where one cannot be tested.

    present: ids of effects that the model has already. geometry: the model's rule of contact.
    responses: columns that are results rather than settings (`measured_forces`).
    """
    found: list[Family] = []
    conditions = observations.conditions
    derived = kinematic(conditions)
    known = dict((registry or default_registry()).families)
    for name in conditions.covariates:
        if name not in STANDARD:
            generic = covariate(name)
            known[generic[0].id] = generic
    for name, classes in known.items():
        needs = tuple(classes[0].needs or _DRIVERS.get(name, ()))
        blocked = _KNOWN if classes[0].known_physics else ""
        if name in present:
            blocked = "the model has it already"
        elif classes[0].geometry and classes[0].geometry == geometry:
            blocked = _GEOMETRY
        blocked = blocked or _why_not(name, needs, observations)
        if not blocked and name.startswith("covariate:"):
            if needs[0] in derived:
                blocked = f"'{needs[0]}' only says again what slip and speed say"
            elif needs[0] in responses:
                blocked = f"'{needs[0]}' is a measured force: a result of the run, not a setting"
            blocked = blocked or _generic(needs[0], observations)
        usable: list[Form] = []
        objection = ""
        for cls in classes if not blocked else ():
            more = [need for need in cls.needs if need not in needs]
            if _why_not("", more, observations):
                continue  # this form needs a column that the family does not
            effect = cls.suited_to(conditions)
            objection = effect.objection(conditions) or objection
            fitted = any(p.neutral is not None for p in cls.parameters())
            seen = any(channel in cls.channels for channel in observations.channels)
            if fitted and seen and not effect.objection(conditions):
                usable.append(Form(name, effect))
        if not blocked and not usable:
            touched = " or ".join(c for c in classes[0].channels)
            blocked = objection or f"it acts on {touched}, which this data does not measure"
            if not any(cls.parameters() for cls in classes):
                blocked = "it has no parameter to fit: a rule, to be set in the model"
        found.append(Family(name, tuple(usable), needs, blocked))
    return found
