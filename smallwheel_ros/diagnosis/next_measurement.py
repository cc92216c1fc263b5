# SPDX-License-Identifier: Apache-2.0
"""What to measure next: the runs at which two rival models, each fitted to all of the data, differ most.

For a setting x the rivals predict f_A(x) and f_B(x). With r runs there, the difference is compared with

    V = V_runs(x) / r + J_B C_B J_B'      T = (f_A - f_B)' V^-1 (f_A - f_B)

where V_runs is the scatter of a run, J_B the derivatives of f_B with respect to its parameters and C_B
their covariance: the second term allows B to adapt, as it is refitted with the new data (T-optimality,
Atkinson and Fedorov 1975). T is twice the gain in nats; a name needs ln 20 = 3 of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from smallwheel_ros.diagnosis.competitors import independent
from smallwheel_ros.diagnosis.search import Candidate, Search
from smallwheel_ros.diagnosis.verdict import Verdict
from smallwheel_ros.fitting.constants import LEAST_POWER, TIE
from smallwheel_ros.fitting.fit import FAILURES, Fit, Fitter, Predictor
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.measurements.display import setting_words, to_tell, words
from smallwheel_ros.model.model import predict
from smallwheel_ros.physics.conditions import ROLLING, Conditions

Array = NDArray[np.float64]
Limits = Mapping[str, Sequence[float]]

RUNS = 6  # as many as a verdict needs at least
_LEVELS = 3
_MOST_SETTINGS = 6
_DEEPEST = 0.3  # of the diameter: deeper, rigs and models fail
_ROWS_PER_RUN = 3
_MOST_PROPOSALS = 3
_SAME = 0.1  # of a setting's range: nearer is the same setting


@dataclass(frozen=True)
class Proposal:
    """Runs that are proposed to separate two explanations.

    Attributes
    ----------
    settings
        Settings of the runs by name, SI.
    separates
        The two effects that the runs separate; `none` stands for no effect.
    runs
        Number of runs.
    expected_power
        Probability that these runs separate them.
    text
        The proposal in words.
    """

    settings: dict[str, float]
    separates: tuple[str, str]
    runs: int
    expected_power: float
    text: str


def _levels(column: Array, name: str, limits: Limits) -> list[float]:
    if name in limits:
        return [float(v) for v in limits[name]]
    values = np.unique(column)
    if values.size <= _LEVELS or name in ("diameter", "width", "pass_number"):
        picks = np.unique(np.linspace(0, values.size - 1, _LEVELS).round().astype(int))
        return [float(v) for v in values[picks]]
    low, high = np.quantile(column, [0.02, 0.98])
    spaced = np.geomspace if low > 0 and high > 8.0 * low else np.linspace
    return [float(v) for v in spaced(low, high, _LEVELS)]


@dataclass(frozen=True)
class Runs:
    """A grid of possible runs.

    Attributes
    ----------
    conditions
        Conditions of each run, shape (runs,).
    settings
        Settings to show to the user, by name, SI, shape (runs,) each.
    known
        Whether the table already has at least six runs near these settings, shape (runs,).
    """

    conditions: Conditions
    settings: Mapping[str, Array]
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, points: Points, limits: Limits) -> Runs:
        """Make a run for every combination of the levels of up to six settings.

        Settings for which the user gave levels are taken first. The others have up to three levels over the
        measured range; settings beyond six have one, the measured value nearest to the median.

        Parameters
        ----------
        points
            Measured values, each a mean over rows of one run and setting.
        limits
            Levels that the user can set, SI, by setting.
        """
        columns, conditions = independent(points), points.conditions
        settable = [n for n in columns if n != points.order]  # a time is not set
        order = [*(n for n in limits if n in conditions), *(n for n in settable if n not in limits)]
        order.sort(key=lambda n: (n not in limits, n not in ("load", "slip", "speed", "width")))
        used = order[:_MOST_SETTINGS]
        choices = [_levels(columns.get(n, points.column(n)), n, limits) for n in used]
        rounded = [[float(f"{v:.3g}") for v in levels] for levels in choices]
        combined = np.array([*itertools.product(*rounded)])
        count = len(combined)
        made = dict(zip(used, combined.T, strict=True))
        for name in ("load", "diameter", "width", *conditions.covariates):
            column = points.column(name)
            middle = column[np.argmin(np.abs(column - np.median(column)))]  # one that exists
            made.setdefault(name, np.full(count, middle))
        soil = None
        if conditions.soil is not None:
            names, counts = np.unique(conditions.soil[points.row], return_counts=True)
            soil = np.full(count, names[np.argmax(counts)])
        rolling = conditions.rolling[points.row].any()
        contact = np.full(count, ROLLING if rolling else conditions.contact[points.row[0]])
        covariates = {name: made[name] for name in conditions.covariates}
        there = Conditions(made["load"], made["diameter"], made["width"], contact, soil, covariates)
        shown = {name: made[name] for name in dict.fromkeys(("load", "diameter", "width", *used))}
        near = np.ones((count, len(points)), dtype=bool)
        for name in (n for n in shown if n in columns):
            column = points.column(name)
            span = max(float(np.ptp(column)), 1e-12)
            near &= np.abs(there[name][:, None] - column) <= _SAME * span
        known = np.array([np.unique(points.run[row]).size >= RUNS for row in near])
        return cls(there, shown, known)


def propose(
    fitter: Fitter, runs: Runs, first: Fit, second: Fit, names: tuple[str, str], hint: str = ""
) -> Proposal | None:
    """Find the setting at which six runs distinguish two models best (formula: module's docstring).

    Runs that the table already has are not proposed, nor those in which a wheel would sink over 0.3 of its
    diameter.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    runs
        Possible runs.
    first, second
        Fits of the two models, A and B. B is treated as if it were refitted to the new runs: only differences
        that no change of its parameters could imitate count.
    names
        Names of the two models.
    hint
        Sentence on how to check one of them, which is appended to the text; none if empty.

    Returns
    -------
    Proposal or None
        None where no run distinguishes them.
    """
    there, channels = runs.conditions, fitter.points.channels
    shape = len(channels), len(there)
    channel, row = (index.reshape(-1) for index in np.indices(shape))
    predictor = Predictor(there, channels, channel, row)
    a = predictor(first.vector, first.theta).reshape(shape)
    predicted, slopes = predictor.with_slopes(second.vector, second.theta)
    b = predicted.reshape(shape)
    stiff = replace(second, slopes=slopes).stiffness.reshape(shape)
    slopes = slopes.reshape(*shape, -1)
    spread = np.einsum("cip,pq,diq->icd", slopes, second.covariance, slopes)
    variance = spread + _scatter(fitter, second, b, stiff) / RUNS
    gain = np.einsum("ic,icd,id->i", (a - b).T, np.linalg.inv(variance), (a - b).T)
    bad = runs.known
    for model in (first.model, second.model):
        said = predict(model, there, with_forces=False)
        too_deep = ~(said.sinkage > 0) | (said.sinkage > _DEEPEST * there.diameter)
        bad = bad | said.immobilised | too_deep
    gain = np.where(bad | ~np.isfinite(gain), -1.0, gain)
    best = int(np.argmax(gain))
    if gain[best] <= 0:
        return None
    power = float(ndtr(np.sqrt(gain[best]) - np.sqrt(2.0 * TIE)))
    settings = {name: float(f"{column[best]:.3g}") for name, column in runs.settings.items()}
    shown = ", ".join(f"{words(n)} {setting_words(n, v)}" for n, v in settings.items())
    text = f"{RUNS} runs at {shown} tell {to_tell(names)}"
    return Proposal(settings, names, RUNS, power, text + (f"; {hint}" if hint else ""))


def _scatter(fitter: Fitter, fit: Fit, level: Array, stiff: Array) -> Array:
    """Covariance of one run's mean between channels, shape (runs, channels, channels)."""
    deviations = fit.scatter.deviations
    found = deviations["tau"] ** 2 * np.einsum("ci,di->icd", stiff, stiff)
    for c, name in enumerate(fitter.points.channels):
        noise = fitter.repeats.channels[name].variance(level[c]) / _ROWS_PER_RUN
        own = deviations[f"own:{name}"] * level[c]
        zero = deviations.get(f"zero:{name}", 0.0) * float(np.median(np.abs(level[c])))
        found[:, c, c] += noise + own**2 + zero**2
    return np.asarray(found)


def proposals(found: Search, verdict: Verdict, limits: Limits) -> list[Proposal]:
    """Propose runs that would decide between the best explanation and the next best ones.

    Parameters
    ----------
    found
        All models that were fitted.
    verdict
        The verdict, with its rivals.
    limits
        Levels that the user can set, SI, by setting.

    Returns
    -------
    list of Proposal
        Up to three, first those between rivals, each with a probability to decide over `LEAST_POWER`.
    """
    ordered = found.ordered
    first = ordered[0] if verdict.word != "missing_effect" else verdict.best
    models = [_explained_by(found, verdict, rival) for rival in verdict.rivals]
    known = [m for m in models if m is not None]
    pairs = [(known[0], other) for other in known[1:]]
    pairs += [(first, m) for m in ordered if m.families != first.families][:_MOST_PROPOSALS]
    runs, made = Runs.of(found.fitter.points, limits), list[Proposal]()
    for one, other in pairs:
        apart = one.families - other.families, other.families - one.families
        names = tuple(min(families, default="none") for families in apart)
        if not any(apart) or any(set(p.separates) == set(names) for p in made):
            continue
        hints = [c.effect.next_step for m in (one, other) for c in m.competitors
                 if c.family in names and c.effect is not None and c.effect.next_step]  # fmt: skip
        hint = hints[0] if hints else ""
        try:
            one_of = propose(found.fitter, runs, one, other, (names[0], names[1]), hint)
        except FAILURES:
            continue
        made += [one_of] if one_of is not None and one_of.expected_power > LEAST_POWER else []
    return made[:_MOST_PROPOSALS]


def _explained_by(found: Search, verdict: Verdict, rival: str) -> Candidate | None:
    """Best model with a rival in place of the first of the rivals; None if there is none.

    A rival that is only tied by its setting was not fitted before, and is fitted here.
    """
    name = verdict.rivals[0]
    named = next((m for m in found.ordered if name in m.families), None)
    taken = {name} - {rival}  # a model with both tells nothing between them
    known = next((m for m in found.ordered if rival in m.families and not taken & m.families), None)
    if known is not None or named is None:
        return known
    tied = next(c for c in named.competitors if c.family == name)
    forms = [c for c in found.field.competitors if c.family == rival]
    made = [found.made(named, form, out=tied) for form in forms]
    return max((m for m in made if m is not None), key=lambda m: m.weight, default=None)
