"""Score tests: what each effect would explain of the residuals, were it added to a fitted model.

About a fit everything is linear. Each form of each effect becomes a column (the change of the
prediction with its strength), and its statistic is the improvement of -2 log restricted likelihood

    T = min over tau of l(base) - min over tau of l(base + column)

with the runs' scatter tau fitted anew on each side, and the scale of the noise too. The law of the
largest T under "nothing is missing" comes from data simulated from the fit, through the same
arithmetic: no approximation of its law, no correction for having looked at many effects.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from smallwheel_ros.diagnosis.candidates import Family, Form
from smallwheel_ros.diagnosis.workbench import Explanation
from smallwheel_ros.fitting.mixed import RunEffects, woodbury
from smallwheel_ros.fitting.parameters import replace_model
from smallwheel_ros.model import predict

Array = NDArray[np.float64]

_SHARES = (0.02, 1.0, 3.0)  # of an effect's start: a slope at zero, and for what is not a line
_NO_START = 0.03  # of the range, where an effect starts at zero
_ALIKE = 0.999
_EXACT = 0.03  # of the noise: an error under that, as of computed data, is nothing to explain
_TAIL = 25  # draws that carry the tail of a p-value


@dataclass(frozen=True)
class Columns:
    """Sensitivities, shape (observations, columns), with the group that each belongs to.

    forms, shapes: of the effect that a column stands for. one_sided: it can only have one sign.
    """

    matrix: Array
    groups: tuple[str, ...]
    forms: tuple[Form | None, ...]
    shapes: tuple[dict[str, float], ...]
    one_sided: NDArray[np.bool_]

    def of(self, group: str) -> NDArray[np.intp]:
        """Indices of a group's columns."""
        return np.flatnonzero([g == group for g in self.groups])


def sensitivities(
    explanation: Explanation, families: Sequence[Family], effects: RunEffects
) -> Columns:
    """The columns of every testable family that the explanation does not have."""
    observations = explanation.predictor.observations
    model = explanation.model()
    zero = observations.pick(predict(model, observations.conditions))
    size = 1.0 / np.sqrt(effects.variance)
    found: list[tuple[Array, str, Form, dict[str, float]]] = []
    for family in families:
        if family.blocked or family.name in explanation.families:
            continue
        kept: list[Array] = []
        for form, shape, strength in _trials(family):
            changed = replace_model(
                model, model.soils, (*model.effects, form.at(strength, **shape))
            )
            moved = observations.pick(predict(changed, observations.conditions))
            column = (moved - zero) / (strength - form.neutral)
            norm = float(np.linalg.norm(column * size))
            if not np.isfinite(norm) or norm < 1e-9:
                continue
            unit = column * size / norm
            if any(abs(float(unit @ other)) > _ALIKE for other in kept):
                continue
            kept.append(unit)
            found.append((column, family.name, form, shape))
    if not found:
        return Columns(np.zeros((len(observations), 0)), (), (), (), np.zeros(0, dtype=bool))
    matrix, groups, forms, shapes = zip(*found, strict=True)
    sided = np.array([form.one_sided for form in forms])
    return Columns(np.column_stack(matrix), groups, forms, shapes, sided)


def _trials(family: Family) -> Iterator[tuple[Form, dict[str, float], float]]:
    for form in family.forms:
        p = form.parameter
        low, high = p.bounds
        size = p.start - form.neutral or _NO_START * (high - low)
        for shape in form.shapes():
            for share in _SHARES if not shape else _SHARES[1:2]:
                strength = float(np.clip(form.neutral + share * size, 0.9 * low, 0.9 * high))
                if strength != form.neutral:
                    yield form, shape, strength


def join(first: Columns, second: Columns) -> Columns:
    """Both."""
    return Columns(
        np.column_stack([first.matrix, second.matrix]),
        first.groups + second.groups,
        first.forms + second.forms,
        first.shapes + second.shapes,
        np.concatenate([first.one_sided, second.one_sided]),
    )


@dataclass(frozen=True)
class Scores:
    """Statistics: shape (columns, responses). strength: the linear estimate, with its deviation.

    left: share of a column's length that the base cannot imitate; direction: what is left of it, of
    unit length, shape (columns, columns) as cosines.
    """

    statistic: Array
    strength: Array
    deviation: Array
    left: Array
    cosine: Array


def _tau_grid(tau: Array, typical: Array, least: Array) -> Array:
    values = []
    for at, unit, lowest in zip(tau, typical, least, strict=True):
        middle = at if at > 0.4 * unit else 0.5 * unit
        points = (0.0, 0.6 * middle, 1.1 * middle)
        values.append(tuple(dict.fromkeys(max(point, lowest) for point in points)))
    return np.array(list(itertools.product(*values))).reshape(-1, tau.size)


def scores(
    effects: RunEffects,
    typical: Array,
    tau: Array,
    design: Array,
    precision: Array,
    columns: Columns,
    responses: Array,
) -> Scores:
    """Statistics of every column for every response (observations, responses), all at once."""
    u = effects.loadings
    p = design.shape[1]
    c = columns.matrix
    sided = columns.one_sided[:, None]
    x = np.column_stack([design, c])
    weight = 1.0 / effects.variance
    uu = effects.products(u, u)
    ux = effects.products(u, x)
    uy = effects.products(u, responses)
    jx = design.T @ (x * weight[:, None])
    cc = np.sum(c**2 * weight[:, None], axis=0)
    xy = x.T @ (responses * weight[:, None])
    yy = np.sum(responses**2 * weight[:, None], axis=0)
    runs, q = uu.shape[0], uu.shape[1]
    flat_x, flat_y = ux.reshape(runs * q, -1), uy.reshape(runs * q, -1)
    freedom = responses.shape[0] - p
    best_base = np.full(responses.shape[1], np.inf)
    best_with = np.full((c.shape[1], responses.shape[1]), np.inf)
    for point in _tau_grid(tau, typical, effects.least):
        w, log_det = woodbury(uu, point, effects.log_noise)
        wx = w @ ux
        flat = wx.reshape(runs * q, -1)
        jvx = jx - flat_x[:, :p].T @ flat
        cvc = cc - np.sum(flat_x[:, p:] * flat[:, p:], axis=0)
        xvy = xy - flat.T @ flat_y
        yvy = yy - np.sum(uy * (w @ uy), axis=(0, 1))
        factor = np.linalg.cholesky(jvx[:, :p] + precision)
        hx = np.linalg.solve(factor, jvx[:, p:])
        hy = np.linalg.solve(factor, xvy[:p])
        constant = log_det + 2.0 * np.sum(np.log(np.diag(factor)))
        rss = yvy - np.sum(hy**2, axis=0)
        scy = xvy[p:] - hx.T @ hy
        scc = np.maximum(cvc - np.sum(hx**2, axis=0), 1e-10 * cvc + 1e-300)
        scy = np.where(sided, np.maximum(scy, 0.0), scy)
        gain = scy**2 / scc[:, None]
        least = _EXACT**2 * freedom
        best_base = np.minimum(best_base, freedom * np.log(np.maximum(rss, least)) + constant)
        best_with = np.minimum(
            best_with, freedom * np.log(np.maximum(rss - gain, least)) + constant
        )
    w, _ = woodbury(uu, tau, 0.0)
    flat = (w @ ux).reshape(runs * q, -1)
    inner = x.T @ (x * weight[:, None]) - ux.reshape(runs * q, -1).T @ flat
    y = xy[:, 0] - flat.T @ flat_y[:, 0]
    solved = np.linalg.solve(inner[:p, :p] + precision, np.column_stack([inner[:p, p:], y[:p]]))
    rest = inner[p:, p:] - inner[p:, :p] @ solved[:, :-1]
    length = np.maximum(np.diag(rest), 1e-12 * np.diag(inner)[p:] + 1e-300)
    slope = (y[p:] - inner[p:, :p] @ solved[:, -1]) / length
    return Scores(
        best_base[None, :] - best_with,
        slope,
        1.0 / np.sqrt(length),
        np.sqrt(np.clip(length / np.maximum(np.diag(inner)[p:], 1e-300), 0.0, 1.0)),
        rest / np.outer(np.sqrt(length), np.sqrt(length)),
    )


def simulate(effects: RunEffects, tau: Array, count: int, generator: np.random.Generator) -> Array:
    """Residuals under "nothing is missing", shape (observations, count)."""
    rows = effects.variance.size
    noise = generator.standard_normal((rows, count)) * np.sqrt(effects.variance)[:, None]
    pad = effects.padding
    run = np.zeros(rows, dtype=np.intp)
    numbers = np.broadcast_to(np.arange(pad.index.shape[0])[:, None], pad.index.shape)
    run[pad.index[pad.real]] = numbers[pad.real]
    for j, scatter in enumerate(tau):
        special = generator.standard_normal((pad.index.shape[0], count)) * scatter
        noise += effects.loadings[:, [j]] * special[run]
    return np.asarray(noise)


def p_value(observed: float, null: Array) -> float:
    """Chance of a value this large under the null; beyond the draws, by the tail of a chi-square.

    The tail is that of chi-square with one degree of freedom from the draws' own upper quantile on.
    """
    above = int(np.sum(null >= observed))
    if above >= _TAIL or observed <= 0:
        return float((1 + above) / (1 + null.size))
    edge = float(np.sort(null)[-_TAIL])
    share = (1 + _TAIL) / (1 + null.size)
    if observed <= edge:
        return share
    return float(share * chi2.sf(observed, 1) / max(chi2.sf(edge, 1), 1e-300))


def group_maximum(statistic: Array, columns: Columns, names: Sequence[str]) -> Array:
    """Largest statistic of each group, shape (groups, responses); 0 where a group has no column."""
    found = np.zeros((len(names), statistic.shape[1]))
    for i, name in enumerate(names):
        rows = columns.of(name)
        if rows.size:
            found[i] = statistic[rows].max(axis=0)
    return found
