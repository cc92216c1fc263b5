"""What a fit found: a model, how well each parameter is known, and what the data could not determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.calibrate import Calibration
from smallwheel_ros.fitting.noise import ChannelNoise
from smallwheel_ros.fitting.solve import Weights
from smallwheel_ros.model import Model, Prediction, predict
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]
Status = Literal["determined", "at its bound", "not determined", "held"]

# As in the estimator: at half of the prior's deviation, three quarters of what is known is data.
_SHRUNK = 0.5
_TIED = 0.98

_REMEDIES = {
    "log_reference_pressure": "measure sinkage at a few loads",
    "n": "measure over a wider range of loads (4 to 1), or measure resistance too",
    "m": "measure with a second wheel diameter (1.5 to 1)",
    "friction_angle": "measure drawbar pull at slip over 0.5",
    "log_shear_displacement": "measure drawbar pull at slips from 0.05 to 0.3",
    "cohesion": "measure drawbar pull at high slip under a light and a heavy load",
}


@dataclass(frozen=True)
class FittedParameter:
    """One parameter. owner: the soil or effect. std: None where it is held or at its bound.

    remedy: what measurement would determine it, empty where it is determined.
    """

    owner: str
    name: str
    value: float
    std: float | None
    unit: str
    bounds: tuple[float, float]
    status: Status
    remedy: str

    @property
    def full_name(self) -> str:
        """`dry_sand.n`, `slip_sinkage.a`."""
        return f"{self.owner}.{self.name}"


@dataclass(frozen=True)
class FitResult:
    """A fitted model. Arrays by channel are of shape (rows,), NaN where a row did not measure the channel.

    names, covariance: of the free parameters, in the numbers that the fit works with: a soil is (ln of the
    pressure at 10 mm and D = 0.2 m, n, m), shape (parameters, parameters). noise: of one row, by channel.
    run_scatter: standard deviation of what differs from run to run (ln k; a channel's own, relative).
    scale: factor on all noise that the fit found. outliers: by channel, the rows that were left out.
    """

    model: Model
    parameters: tuple[FittedParameter, ...]
    names: tuple[str, ...]
    covariance: Array
    noise: Mapping[str, ChannelNoise]
    run_scatter: Mapping[str, float]
    scale: float
    residuals: Mapping[str, Array]
    predicted: Mapping[str, Array]
    outliers: Mapping[str, NDArray[np.intp]]
    minus_two_log_likelihood: float
    notes: tuple[str, ...]

    @property
    def correlation(self) -> Array:
        """Correlations of the free parameters, shape (parameters, parameters)."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return np.asarray(self.covariance / np.outer(std, std))

    @property
    def not_determined(self) -> tuple[FittedParameter, ...]:
        """The parameters that this data does not determine; `remedy` says what would."""
        return tuple(p for p in self.parameters if p.status in ("not determined", "held"))

    def predict(self, conditions: Conditions) -> Prediction:
        """What the fitted model says of other conditions."""
        return predict(self.model, conditions)

    def soil_covariance(self, soil: str) -> Array:
        """Covariance of (ln p_ref, n, m) of that soil, shape (3, 3); a held parameter's is its prior's."""
        fields = ("log_reference_pressure", "n", "m")
        full = np.diag([9.0, 0.36, 1.0])
        at = {f: self.names.index(f"{soil}.{f}") for f in fields if f"{soil}.{f}" in self.names}
        for i, a in enumerate(fields):
            for j, b in enumerate(fields):
                if a in at and b in at:
                    full[i, j] = self.covariance[at[a], at[b]]
        return full


def covariance_of(calibration: Calibration) -> Array:
    """Covariance of the free parameters; zero rows and columns for one that sits at its bound."""
    solution = calibration.fit.solution
    free = ~solution.frozen
    full = np.zeros((free.size, free.size))
    block = solution.information[np.ix_(free, free)]
    inverse = np.asarray(np.linalg.pinv(block, hermitian=True), dtype=float)
    found = calibration.fit.scatter.scale**2 * inverse
    part = calibration.kept_observations
    runs = np.unique(part.run).size
    if part.curves.any() and runs > 2 * int(free.sum()):
        wider = np.sqrt(np.maximum(_clustered(calibration, inverse, runs) / np.diag(found), 1.0))
        found = found * np.outer(wider, wider)
    full[np.ix_(free, free)] = found
    return full


def _clustered(calibration: Calibration, inverse: Array, runs: int) -> Array:
    """Variances from what whole runs differ by: a curve's errors are not independent.

    Liang and Zeger 1986, the sandwich with runs as clusters.
    """
    solution = calibration.fit.solution
    part = calibration.kept_observations
    design = solution.slopes[:, ~solution.frozen]
    weights = Weights(calibration.effects, calibration.fit.scatter.tau)
    residual = (part.value - solution.predicted)[:, None]
    pulls = weights.by_run(design, residual)[1][:, :, 0]
    middle = pulls.T @ pulls * runs / (runs - 1.0)
    return np.asarray(np.diag(inverse @ middle @ inverse))


def _statuses(calibration: Calibration, covariance: Array) -> list[FittedParameter]:
    layout, solution = calibration.layout, calibration.fit.solution
    prior = np.sqrt(1.0 / np.maximum(np.diag(layout.precision), 1e-300))
    found = []
    for j, slot in enumerate(layout.slots):
        if slot.owner < 0:
            continue
        owner = layout.owner_name(slot)
        value, std = float(solution.theta[j]), float(np.sqrt(covariance[j, j]))
        width = slot.bounds[1] - slot.bounds[0]
        wide = _SHRUNK * prior[j] if not slot.of_effect else 0.25 * width
        status: Status = "determined"
        remedy = _REMEDIES.get(slot.field, "") if not slot.of_effect else ""
        if solution.frozen[j]:
            status = "at its bound"
        elif std > wide:
            status = "not determined"
        if slot.of_effect and status != "determined":
            remedy = f"vary what '{owner}' depends on over a wider range, with the rest held"
        found.append(
            FittedParameter(
                owner,
                slot.field,
                value,
                None if solution.frozen[j] else std,
                slot.unit,
                slot.bounds,
                status,
                "" if status == "determined" else remedy,
            )
        )
    for soil in layout.model.soils:
        if f"{soil.name}.m" not in layout.names:
            found.append(
                FittedParameter(
                    soil.name, "m", soil.m, None, "1", (-3.0, 3.0), "held", _REMEDIES["m"]
                )
            )
    return found


def _notes(
    calibration: Calibration, parameters: list[FittedParameter], covariance: Array
) -> list[str]:
    notes = list(calibration.observations.notes)
    for p in parameters:
        if p.status == "held":
            notes.append(
                f"{p.full_name} is held at {p.value:g}: only k D^m is determined with one wheel diameter; "
                f"{p.remedy}"
            )
        elif p.status == "at its bound":
            notes.append(
                f"{p.full_name} is at its bound, {p.value:g}: the data wants to go further"
            )
        elif p.status == "not determined":
            notes.append(f"{p.full_name} is not determined by this data: {p.remedy}")
    names = calibration.layout.names
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    for i in range(len(names)):
        for j in range(i):
            r = covariance[i, j] / (std[i] * std[j])
            if abs(r) > _TIED:
                notes.append(
                    f"{names[j]} and {names[i]} are tied (correlation {r:.3f}): only a combination of "
                    "them is determined"
                )
    flagged = int((~calibration.kept).sum())
    if flagged:
        notes.append(
            f"{flagged} measurements are outliers (over 4.5 standard deviations) and were left out"
        )
    if not calibration.fit.solution.converged:
        notes.append("the fit did not come to rest: take its numbers with care")
    return notes


def result_of(calibration: Calibration) -> FitResult:
    """Turn a calibration into a result for people and for model files."""
    observations, layout = calibration.observations, calibration.layout
    solution = calibration.fit.solution
    model = layout.model_at(solution.theta)
    covariance = covariance_of(calibration)
    parameters = _statuses(calibration, covariance)
    prediction = predict(model, observations.conditions)
    rows = len(observations.conditions)
    residuals, predicted, outliers = {}, {}, {}
    for name in observations.channels:
        mask = observations.of_channel(name)
        measured = np.full(rows, np.nan)
        measured[observations.row[mask]] = observations.value[mask]
        values = np.asarray(getattr(prediction, name))
        predicted[name] = np.where(np.isfinite(measured), values, np.nan)
        residuals[name] = measured - values
        outliers[name] = np.sort(observations.row[mask & ~calibration.kept])
    return FitResult(
        model,
        tuple(parameters),
        layout.names,
        covariance,
        dict(calibration.noise.channels),
        dict(zip(calibration.effects.names, map(float, calibration.fit.scatter.tau), strict=True)),
        calibration.fit.scatter.scale,
        residuals,
        predicted,
        outliers,
        calibration.fit.minus_two_log_likelihood,
        tuple(_notes(calibration, parameters, covariance)),
    )
