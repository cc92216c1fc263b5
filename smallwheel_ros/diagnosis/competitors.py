# SPDX-License-Identifier: Apache-2.0
"""The competitors: every effect of the library, errors of instruments, and curves without a name.

Each has a prior for its strength, so that all compete on equal terms:

- soil: Student's t on the published range (a value outside costs, it is not forbidden); where nothing
  is published, about the value at which the effect is absent, with twice the starting strength as scale;
- instrument: about no fault, with `INSTRUMENT` of the reading as scale;
- an effect that the model has: in the same form about its present strength, in its other forms as above;
- unknown: a smooth function of one setting at one stage (`curves`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.diagnosis.curves import STAGES, CurveSpan, curve_part, distinct, spans_of
from smallwheel_ros.effects.base import Effect, Parameter
from smallwheel_ros.effects.registry import DRIFTS, Registry, is_of_column
from smallwheel_ros.fitting.constants import (
    ANSWERS,
    EXPECTED_EFFECTS,
    FEWEST_VALUES,
    SAME_ORDER,
    STUDENT,
    WAVERS,
)
from smallwheel_ros.fitting.parameters import (
    EffectPart,
    ParameterVector,
    Prior,
    instrument_prior,
    part_of,
    with_values,
)
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.display import setting_words
from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.measurements.settings import cluster, varies
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.sinkage import Geometry

Array = NDArray[np.float64]
Kind = Literal["soil", "instrument", "unknown"]

_MOST_TERMS = 3
# Settings that have effects of their own: any other column has no law.
SETTINGS = ("slip", "slip_angle", "slope", "speed", "pass_number", "grouser_height")
_ONE_RANK = 0.01  # of a column's range


@dataclass(frozen=True)
class Competitor:
    """One effect, instrument fault or curve that the model may lack.

    Attributes
    ----------
    family
        Id of the effect, which all its forms share; of a curve its own id, as `unknown:slip@sinkage`.
    form
        Name of the form of the effect; `curve` for a curve.
    kind
        `soil`, `instrument`, or `unknown` for a curve.
    part
        Its free parameters with their priors, as a fit uses them.
    effect
        The effect of the library; None for a curve.
    geometry
        Contact rule that it puts in place of the model's; None: the model's stays.
    replaces
        Whether the model already has an effect of the family, which it replaces.
    stage, span
        Where a curve acts (a name in `curves.STAGES`), and the setting that it follows; empty and None for
        an effect of the library.
    stands_for
        Stages (methods) of effects of which the curve is the most general form.
    share
        Prior odds of the competitor being missing, against nothing missing.
    """

    family: str
    form: str
    kind: Kind
    part: EffectPart
    effect: Effect | None = None
    geometry: Geometry | None = None
    replaces: bool = False
    stage: str = ""
    span: CurveSpan | None = None
    stands_for: tuple[str, ...] = ()
    share: float = 1.0

    @property
    def key(self) -> tuple[str, str]:
        """Family and form, which identify the competitor among all others."""
        return self.family, self.form

    @property
    def drivers(self) -> tuple[str, ...]:
        """Settings on which it depends."""
        if self.span is not None:
            return () if self.stage == "pressure" else (self.span.column,)
        return () if self.effect is None else self.effect.drivers

    def generalises(self, other: Competitor) -> bool:
        """Whether this is a curve, and the most general form of the effect of `other`."""
        if self.span is None or other.effect is None:
            return False
        kind = type(other.effect)
        if self.stage == "pressure":
            return "pressure_factor" in kind.acts
        if self.span.column not in other.drivers or self.span.side * kind.side < 0:
            return False
        return not set(self.stands_for).isdisjoint(kind.acts)


def changed(vector: ParameterVector, put_in: Competitor) -> ParameterVector:
    """Return a parameter vector with a competitor in it, in place of the effect that it replaces, if any.

    Parameters
    ----------
    vector
        Names, priors and bounds of the free parameters.
    put_in
        The competitor to add. A contact rule has no parameters: it replaces the vector's geometry.
    """
    parts = tuple(part for part in vector.parts if part.id != put_in.part.id)
    if put_in.geometry is not None:  # no effect with numbers
        return replace(vector, parts=parts, geometry=put_in.geometry)
    return replace(vector, parts=(*parts, put_in.part))


TAKEN_OUT = "taken out of the competition"  # why a family does not compete: the user said so


@dataclass(frozen=True)
class Field:
    """The competitors, and the families that this data cannot test.

    Attributes
    ----------
    competitors
        All competitors.
    blocked
        Families that cannot be tested, each with the reason in words.
    kinds
        Kind (`soil`, `instrument`, `unknown`) of every family.
    columns
        Settings on which effects can depend (`independent`), by name, shape (values,) each, SI units.
    """

    competitors: tuple[Competitor, ...]
    blocked: Mapping[str, str]
    kinds: Mapping[str, Kind]
    columns: Mapping[str, Array]

    def learnt_from(self, measurements: Measurements) -> frozenset[str]:
        """Families with a law learnt from this very table, which therefore cannot confirm it."""
        return frozenset(
            c.family
            for c in self.competitors
            if c.effect is not None and c.effect.learnt_from == measurements.sha256 != ""
        )

    def only(self, competitors: Sequence[Competitor], blocked: Mapping[str, str]) -> Field:
        """Return a field with only these competitors.

        The prior odds, `EXPECTED_EFFECTS`, are shared evenly among the families, and those of a family
        among its forms.

        Parameters
        ----------
        competitors
            Those that take part.
        blocked
            Further families that cannot be tested, each with the reason in words.
        """
        families = [c.family for c in competitors]
        each = EXPECTED_EFFECTS / max(len(set(families)), 1)
        shared = tuple(replace(c, share=each / families.count(c.family)) for c in competitors)
        return replace(self, competitors=shared, blocked={**self.blocked, **blocked})


def field_of(
    points: Points, model: Model, registry: Registry, without: Collection[str] = ()
) -> Field:
    """Choose all competitors that this data could reveal, before any residual is looked at.

    Parameters
    ----------
    points
        Measured values, each a mean over rows of one run and setting.
    model
        The base model.
    registry
        All effects of the library, and the user's own.
    without
        Families that do not take part; `unknown` stands for all curves.

    Returns
    -------
    Field
        The competitors with their prior odds, and the families that cannot be tested.
    """
    found: list[Competitor] = []
    blocked: dict[str, str] = {}
    columns = independent(points)
    free = [n for n in columns if n not in (*SETTINGS, "load", "diameter", "width")]
    own = {need for forms in registry.families.values() for f in forms for need in f.drivers}
    ids = [f"covariate:{name}" for name in free if name not in own]
    if points.order:
        ids += [f"{prefix}:{points.order}" for prefix in ("covariate", *DRIFTS)]
    families = {**registry.families, **{id: registry.family(id) for id in ids}}
    for family, forms in families.items():
        if family in without:
            blocked[family] = TAKEN_OUT
            continue
        listed, reason = _forms(family, forms, points, model, columns)
        found += listed
        if not listed:
            blocked[family] = reason
    if "unknown" not in without:
        found += _curves(points, columns, free)
    kinds: dict[str, Kind] = {family: forms[0].kind for family, forms in families.items()}
    kinds |= {c.family: c.kind for c in found}
    return Field((), {}, kinds, columns).only(found, blocked)


def _forms(
    family: str,
    forms: Sequence[type[Effect]],
    points: Points,
    model: Model,
    columns: Mapping[str, Array],
) -> tuple[list[Competitor], str]:
    """Forms of a family that can act on this data, as competitors, and the reason if there are none."""
    present = next((e for e in model.effects if e.id == family), None)
    found: list[Competitor] = []
    reason = ""
    for kind in forms:
        if kind.known_physics:
            why = "known physics: applied wherever its columns are present"
        elif kind.geometry and model.geometry == kind.geometry:
            why = "the model has this geometry"
        else:
            why = _why_not(family, kind, points, columns)
        if not why:
            effect = kind.suited_to(points.conditions)
            why = effect.objection(points.conditions)
        if not why:
            same = present is not None and type(present) is type(effect)
            if present is not None and same:
                effect = with_values(effect, dict(present.values()))
            values = dict(effect.values())
            priors = {
                p.name: _prior(p, effect, points, values[p.name] if same else None)
                for p in effect.parameters()
            }
            part = part_of(effect, priors, "" if present is None else family)
            geometry: Geometry | None = "contact_integral" if effect.geometry else None
            found.append(
                Competitor(
                    family, effect.form, effect.kind, part, effect, geometry, present is not None
                )
            )
        reason = reason or why
    return found, reason or "no form of it acts on this data"


def _why_not(family: str, kind: type[Effect], points: Points, columns: Mapping[str, Array]) -> str:
    if kind.kind == "instrument" and not set(kind.channels) & set(points.channels):
        return f"{' and '.join(kind.channels)} was not measured"
    known = points.settings
    for need in dict.fromkeys((*kind.needs, *kind.drivers)):
        if need not in known:
            return f"the data has no column '{need}'"
        if need == "load" and need not in columns and varies(known[need]):
            return (
                "the load was not set: it was swept, or wavers within runs and follows the settings"
            )
        if need == points.order and need not in columns:
            return f"{need} follows the settings: a drift cannot be distinguished from their effect"
        values = known[need]
        if need not in ("load", "width", "diameter"):
            values = values[points.conditions.rolling[points.row]]
        least = 0.0 if need == points.order else 1e-3 * float(np.max(np.abs(values), initial=0.0))
        if values.size == 0 or np.ptp(values) <= least:
            shown = (
                f" ({setting_words(need, float(values[0]))} in every row)" if values.size else ""
            )
            return f"{need} never varies in this data{shown}"
        if is_of_column(family) and np.unique(values).size < FEWEST_VALUES:
            return (
                f"{need} has {np.unique(values).size} different values: at least "
                f"{FEWEST_VALUES} are needed to tell it from the scatter of the runs"
            )
    return kind.never_acts(points.conditions.take(np.unique(points.row)))


def _prior(p: Parameter, effect: Effect, points: Points, present: float | None) -> Prior:
    """Prior of a parameter; `present` is its value where the model has the effect in this form, else None."""
    low, high = p.bounds
    if present is not None:
        centre, wide = present, max(0.5 * abs(present), 1e-3 * (high - low))
    elif p.published is not None:
        first, last = p.published
        centre, wide = 0.5 * (first + last), 0.5 * (last - first)
    elif effect.kind == "instrument":
        return instrument_prior(p, _size(p.unit, points))
    elif p.neutral is None:
        centre, wide = p.start, 0.25 * (high - low)
    else:
        centre, wide = p.neutral, 2.0 * abs(p.start - p.neutral) or 0.1 * (high - low)
    return Prior(centre, wide, low, high, STUDENT)


def _size(unit: str, points: Points) -> float:
    """Typical reading in a unit: of a force the median load, of a length the median sinkage, else 1."""
    if unit == "N":
        return float(np.median(points.column("load")))
    if unit == "m" and "sinkage" in points.channels:
        return float(np.median(points.value[points.of_channel("sinkage")]))
    return 1.0


def _curves(points: Points, columns: Mapping[str, Array], free: Sequence[str]) -> list[Competitor]:
    """Curves of each setting at each stage that this data can show, and one of the depth."""
    # In sinkage alone, stiffness and digging are one; in drawbar pull alone, a resistance is an error of
    # the law of thrust.
    rolling = points.conditions.rolling[points.row]
    together = STAGES["stiffness"].stands_for + STAGES["shown sinkage"].stands_for
    stages = dict.fromkeys(["sinkage"] if rolling.any() else [], together)
    stages |= dict.fromkeys([] if rolling.all() else ["stiffness"], together)
    if "resistance" in points.channels:
        shown = ["stiffness", "resistance", "drag", "force"]
        shown += ["sinkage", "shown sinkage", "height"] if "sinkage" in points.channels else []
        stages = {stage: STAGES[stage].stands_for for stage in shown}
    found: list[tuple[EffectPart, str, CurveSpan, tuple[str, ...]]] = []
    names = ["load", "diameter", "width", *SETTINGS, *free]
    for name in (n for n in names if n in columns):
        for span in spans_of(name, columns[name]):
            terms = min(_MOST_TERMS, distinct(columns[name], span))
            for stage, stands_for in stages.items() if terms > 0 else ():
                if name == "diameter" and stage in ("stiffness", "sinkage", "shown sinkage"):
                    continue  # m does that
                # k itself takes up a constant of the stiffness; that of a height is a zero, which competes
                # as such, under the prior of zeros.
                first = 1 if stage in ("stiffness", "height") or span.side else 0
                size = _size(STAGES[stage].unit, points)
                label = f"unknown:{name}{' < 0' if span.side < 0 else ''}@{stage}"
                part = curve_part(label, stage, span, first, terms + 1 - first, size)
                found.append((part, stage, span, stands_for))
    z = points.value[points.of_channel("sinkage")] if "sinkage" in points.channels else np.ones(0)
    depth = np.log(z[z > 0])
    if depth.size > 2 and np.ptp(depth) >= 1.0:  # a factor of e: less depth has no curve
        middle = float(0.5 * (depth.min() + depth.max()))
        span = CurveSpan("load", middle, float(0.5 * np.ptp(depth)))
        part = curve_part("unknown:depth@pressure", "pressure", span, 2, 2)
        found.append((part, "pressure", span, ()))
    return [
        Competitor(part.id, "curve", "unknown", part, stage=stage, span=span, stands_for=stands_for)
        for part, stage, span, stands_for in found
    ]


# --- Which settings an effect can follow: those that were varied, and not as answers to others


def independent(points: Points) -> dict[str, Array]:
    """Settings that were varied and do not follow from others, by name, SI, shape (values,) each.

    An effect can only be attributed to such a setting. The load is left out where it was not set: where it
    varies within runs, or is swept along curves.
    """
    columns = points.varied
    return {
        name: column
        for name, column in columns.items()
        if name in (*SETTINGS, "diameter", "width")
        or (name == "load" and not _wavers(points))
        or not follows_others(name, _at_runs(name, columns, points))
        if not (name == "load" and points.swept.all() and _sweeps(column, points))
    }


def _sweeps(load: Array, points: Points) -> bool:
    """Whether the load changes along the curves, where it is depth by another name."""
    change = np.log(load)
    along = change - _run_means(change, points)
    return float(np.var(along)) > WAVERS * float(np.var(change))


def _wavers(points: Points) -> bool:
    """Whether the load varies within runs by a fair share of its total variation.

    Then it was not set: it responds to the wheel's motion, and may follow other settings.
    """
    load = np.log(points.measurements.conditions.load)
    steady = [rows for rows, swept in zip(points.rows, points.swept, strict=True) if not swept]
    within = sum(float(np.sum((load[rows] - load[rows].mean()) ** 2)) for rows in steady)
    freedom = sum(rows.size - 1 for rows in steady)
    if not freedom:
        return False
    total = float(np.var(np.concatenate([load[rows] for rows in steady])))
    return within / freedom > WAVERS * total


def _at_runs(name: str, columns: dict[str, Array], points: Points) -> dict[str, Array]:
    """Return the columns, or, where the named one is constant along every run, their means over each run.

    Each run is then one piece of evidence on what that column follows, however many settings the others
    have in it.
    """
    means = {n: _run_means(c, points) for n, c in columns.items()}
    if not np.allclose(means[name], columns[name], rtol=1e-6, atol=0.0):
        return columns
    return {n: c for n, c in means.items() if np.ptp(c) > 0.0}


def _run_means(column: Array, points: Points) -> Array:
    """Mean over the value's run, shape (values,)."""
    run = np.unique(points.run, return_inverse=True)[1].reshape(-1)
    return np.asarray((np.bincount(run, column) / np.bincount(run))[run])


def follows_others(name: str, columns: Mapping[str, Array]) -> bool:
    """Whether a column can be computed from other settings (a rim's speed, a load that falls while skidding).

    Ranks are compared, so that any rising or falling relation counts: with one setting, or with all of
    them, their squares and their products (R^2 adjusted for the number of terms).

    Parameters
    ----------
    name
        Name of the column to judge.
    columns
        Varied columns by name, each of shape (values,). Of the others, load and settings with effects of
        their own (`SETTINGS`) count.
    """
    others = [c for n, c in columns.items() if n != name and n in SETTINGS]
    others += [columns["load"]] if "load" in columns and name != "load" else []
    if not others:
        return False
    met = np.unique(np.column_stack([columns[name], *others]), axis=0)  # once, not once a channel
    y, *scaled = [_ranks(column) for column in met.T]
    if any(abs(float(np.corrcoef(y, x)[0, 1])) > SAME_ORDER for x in scaled):
        return True
    terms = [np.ones(y.size), *scaled]
    terms += [a * b for i, a in enumerate(scaled) for b in scaled[i:]]
    design = np.column_stack(terms)
    spare = len(design) - design.shape[1]
    if spare < design.shape[1]:
        return False
    left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    return 1.0 - float(left @ left) / spare / max(float(y.var(ddof=1)), 1e-300) > ANSWERS


def _ranks(column: Array) -> Array:
    """Ranks scaled to a range of 2; values that agree to a hundredth of the range share a rank."""
    steps = cluster(column, _ONE_RANK * float(np.ptp(column)))
    _, place, count = np.unique(steps, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - 0.5 * count)[place.reshape(-1)]
    return np.asarray(2.0 * (ranks - ranks.mean()) / max(float(np.ptp(ranks)), 1.0))
