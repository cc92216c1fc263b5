"""What to measure next: the runs at which two rivals, each fitted to all that there is, differ most.

For a setting x the rivals predict f_A(x) and f_B(x). With r runs there, the difference is seen against

    V = V_runs(x) / r + J_B C_B J_B'      T = (f_A - f_B)' V^-1 (f_A - f_B)

where the second term is what B could still give way: it is refitted with the new data (T-optimality,
Atkinson and Fedorov 1975). The rivals are told apart where -2 log likelihood differs by 10 or more.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from smallwheel_ros.diagnosis.search import RIVAL_GAP
from smallwheel_ros.diagnosis.ties import Tie, drivers
from smallwheel_ros.diagnosis.workbench import Explanation, Workbench
from smallwheel_ros.fitting.jacobian import Predictor
from smallwheel_ros.fitting.observations import Observations
from smallwheel_ros.model import predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]

RUNS = 6
_LEVELS = 3
_MOST_SETTINGS = 6
_DEEPEST = 0.3  # of the diameter: deeper, rigs and models fail
_ROWS_PER_RUN = 3
_BREAK = 0.5  # of the range: how far off their rule a run must set two tied settings


@dataclass(frozen=True)
class Proposal:
    """Runs to make. settings: SI. separates: two effects. power: chance that they then are apart."""

    settings: dict[str, float]
    separates: tuple[str, str]
    runs: int
    power: float
    text: str


def _levels(column: Array, name: str) -> list[float]:
    values = np.unique(column)
    if values.size <= _LEVELS or name in ("diameter", "width", "pass_number"):
        picks = values[np.unique(np.linspace(0, values.size - 1, _LEVELS).round().astype(int))]
        return [float(v) for v in picks]
    low, high = np.quantile(column, [0.02, 0.98])
    if low > 0 and high > 8.0 * low:
        return [float(v) for v in np.geomspace(low, high, _LEVELS)]
    return [float(v) for v in np.linspace(low, high, _LEVELS)]


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def candidate_runs(observations: Observations) -> tuple[Conditions, list[dict[str, float]]]:
    """A grid of what can be set: low, middle and high of each setting that varies."""
    rows = np.unique(observations.row)
    varied = drivers(observations)
    order = sorted(varied, key=lambda n: (n not in ("load", "slip", "speed", "width"), n))
    used = order[:_MOST_SETTINGS]
    choices = {name: [_rounded(v) for v in _levels(varied[name], name)] for name in used}
    combined = [
        dict(zip(choices, picks, strict=True)) for picks in itertools.product(*choices.values())
    ]
    c = observations.conditions
    fixed = {"load": c.load, "diameter": c.diameter, "width": c.width} | dict(c.covariates)
    columns = {}
    for name, column in fixed.items():
        if name in used:
            columns[name] = np.array([run[name] for run in combined])
        else:
            middle = float(np.median(column[rows]))
            if name in ("diameter", "width", "pass_number"):  # one that exists
                values = column[rows]
                middle = float(values[np.argmin(np.abs(values - middle))])
            columns[name] = np.full(len(combined), middle)
    rolling = np.full(len(combined), "rolling")
    soil = None
    if c.soil is not None:
        names, counts = np.unique(c.soil[rows], return_counts=True)
        soil = np.full(len(combined), names[np.argmax(counts)])
    conditions = Conditions(
        columns.pop("load"), columns.pop("diameter"), columns.pop("width"), rolling, soil, columns
    )
    shown = ("load", "diameter", "width", *(n for n in varied if n in columns))
    settings = [
        {name: _rounded(float(conditions[name][i])) for name in dict.fromkeys(shown)}
        for i in range(len(combined))
    ]
    return conditions, settings


def _as_observations(observations: Observations, conditions: Conditions) -> Observations:
    """One row of each channel at each condition, every row a run."""
    count, channels = len(conditions), len(observations.channels)
    row = np.tile(np.arange(count), channels)
    return Observations(
        conditions,
        observations.channels,
        tuple(str(i) for i in range(count)),
        np.zeros(row.size),
        row,
        np.repeat(np.arange(channels), count),
        row,
        np.full(row.size, np.nan),
    )


def _breaks(observations: Observations, conditions: Conditions, tie: Tie) -> NDArray[np.bool_]:
    """Candidates in which the one setting is where the other, by their tie, would not have it."""
    varied = drivers(observations)

    def share(name: str) -> Array:
        low, high = varied[name].min(), varied[name].max()
        return np.asarray((conditions[name] - low) / (high - low))

    first, second = share(tie.first), share(tie.second)
    expected = second if tie.correlation > 0 else 1.0 - second
    return np.asarray(np.abs(first - expected) > _BREAK)


def propose(
    workbench: Workbench,
    first: Explanation,
    second: Explanation,
    names: tuple[str, str],
    ties: Sequence[Tie] = (),
) -> Proposal | None:
    """Find the best single setting to tell two explanations apart, made in six runs.

    ties: of what the two follow; the setting must break each of them.
    """
    conditions, settings = candidate_runs(workbench.observations)
    there = _as_observations(workbench.observations, conditions)
    count, channels = len(conditions), len(there.channels)
    a = Predictor(there, first.layout)(first.theta).reshape(channels, count)
    predicted, slopes = Predictor(there, second.layout).with_slopes(second.theta)
    b = predicted.reshape(channels, count)
    slopes = slopes.reshape(channels, count, -1)
    spread = np.einsum("cip,pq,diq->icd", slopes, second.covariance(), slopes)
    scatter = _scatter(workbench, second, b)
    # Runs share nothing but the soil's law: their scatter averages out.
    variance = spread + scatter / RUNS
    apart = (a - b).T
    gain = np.einsum("ic,icd,id->i", apart, np.linalg.inv(variance), apart)
    deep = np.zeros(count, dtype=bool)
    seen = workbench.observations
    sinkages = seen.value[seen.of_channel("sinkage")] if "sinkage" in seen.channels else np.zeros(1)
    least = 0.7 * float(sinkages.min())  # shallower than anything measured, an instrument is blind
    for explanation in (first, second):
        said = predict(explanation.model(), conditions)
        deep |= said.immobilised | (said.sinkage > _DEEPEST * conditions.diameter)
        deep |= ~np.isfinite(said.sinkage) | (said.sinkage <= least)
    for tie in ties:
        deep |= ~_breaks(workbench.observations, conditions, tie)
    gain = np.where(deep | ~np.isfinite(gain), -1.0, gain)
    best = int(np.argmax(gain))
    if gain[best] <= 0:
        return None
    power = float(norm.cdf(np.sqrt(gain[best]) - np.sqrt(RIVAL_GAP)))
    return Proposal(settings[best], names, RUNS, power, _words(names, settings[best]))


def _scatter(workbench: Workbench, explanation: Explanation, level: Array) -> Array:
    """Covariance of one run's mean, by channel, at each candidate: shape (count, channels, channels)."""
    channels, count = level.shape
    noise = workbench.calibration.noise.channels
    names = workbench.observations.channels
    found = np.zeros((count, channels, channels))
    tau = dict(zip(workbench.effects.names, explanation.fit.scatter.tau, strict=True))
    n = float(np.mean([s.n for s in explanation.model().soils]))
    pull = np.zeros((channels, count))
    for c, name in enumerate(names):
        found[:, c, c] += noise[name].variance(level[c]) / _ROWS_PER_RUN
        found[:, c, c] += (tau.get(name, 0.0) * level[c]) ** 2
        slope = -1.0 if name == "sinkage" else -0.5  # d ln z, d ln R over d ln k, times (n + 1/2)
        pull[c] = tau.get("ln k", 0.0) * slope / (n + 0.5) * level[c]
    return np.asarray(found + np.einsum("ci,di->icd", pull, pull))


def _words(names: Sequence[str], settings: dict[str, float]) -> str:
    shown = ", ".join(f"{name} {value:g}" for name, value in settings.items())
    text = f"{RUNS} runs at {shown} tell {names[0]} from {names[1]}"
    if "sinkage_offset" in names:
        text += "; or take the touch-down zero at the lightest load"
    if "bulldozing" in names:
        text += "; measure the towing force"
    return text
