# SPDX-License-Identifier: Apache-2.0
"""What a model file keeps of the data: ranges, scatter of the runs, and the accuracy of pull and torque."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from smallwheel_ros.fitting.constants import (
    CHANNEL_SCATTER,
    FORCE_LAW,
    LACK_OF_FIT,
    TOGETHER,
)
from smallwheel_ros.fitting.fit import Fit, Fitter
from smallwheel_ros.fitting.noise import wheel_discrepancy
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.posterior import over_scatter
from smallwheel_ros.fitting.variance import Covariance, Scatter
from smallwheel_ros.measurements.columns import FORCES, SETTINGS
from smallwheel_ros.measurements.settings import setting_columns
from smallwheel_ros.model.measured import ForceLaw, Measured, RunScatter, Tied

Array = NDArray[np.float64]

_SIZES = ("load", "diameter", "width")
_OF_ANY_BODY = ("load", "diameter")  # the others are settings of a wheel that rolls
_FEWEST_LEVELS = 3  # of a setting, from which it shows whether another follows it
_LEAST_OFF = 0.01  # of a setting's range: nearer to a line it was not set


def measured_of(fitter: Fitter, fit: Fit, scatter: Scatter) -> Measured:
    """Collect what a prediction needs to know of the data: ranges, wheels, scatter, and errors of the laws.

    Parameters
    ----------
    fitter
        Holds the measured points and their noise.
    fit
        A converged fit by `fitter`.
    scatter
        Estimated variance components: `Fitter.true_scatter`.

    Returns
    -------
    Measured
        The entry `measured` of a model file.
    """
    points = fitter.points
    return Measured(
        _ranges(points),
        _wheels(points),
        scatter.deviations["tau"],
        {name: _run_scatter(fitter, scatter, name) for name in points.channels},
        _force_laws(fitter, fit, scatter),
        tied_settings(points),
    )


def _ranges(points: Points) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each setting, SI; of a setting of wheels only rows that roll count."""
    there, found = points.conditions.take(np.unique(points.row)), {}
    names = [n for n in setting_columns(points.measurements) if n in there or n in _SIZES]
    for name in names:
        values = there[name] if name in _OF_ANY_BODY else there[name][there.rolling]
        if values.size:
            found[name] = float(values.min()), float(values.max())
    return found


def _wheels(points: Points) -> tuple[tuple[float, float, float], ...]:
    """Diameter, width and height of lugs (m) of each wheel that rolled."""
    there = points.conditions.take(np.unique(points.row))
    lugs = there.covariates.get("grouser_height", np.zeros(len(there)))
    sizes = np.column_stack([there.diameter, there.width, lugs])[there.rolling]
    return tuple((d, b, h) for d, b, h in np.unique(np.round(sizes, 6), axis=0).tolist())


def _run_scatter(fitter: Fitter, scatter: Scatter, channel: str) -> RunScatter:
    """Scatter of the runs and rows of a channel, and error of its law from setting to setting.

    Where no setting was repeated the two cannot be told apart: their sum is divided as the priors are
    (`CHANNEL_SCATTER`, `LACK_OF_FIT`). The error of the law of pull and torque stands elsewhere
    (`ForceLaw`).
    """
    noise, deviations = fitter.repeats.channels[channel], scatter.deviations
    middle = float(np.median(fitter.level[fitter.points.of_channel(channel)]))
    run, law = deviations[f"own:{channel}"], deviations.get(f"fit:{channel}", 0.0)
    if channel in FORCES:
        run, law = float(np.hypot(run, law)), 0.0
    elif f"fit:{channel}" not in scatter.names:
        whole = np.hypot(LACK_OF_FIT, CHANNEL_SCATTER)
        run, law = (run * float(part / whole) for part in (CHANNEL_SCATTER, LACK_OF_FIT))
    return RunScatter(
        run=run,
        zero=deviations.get(f"zero:{channel}", 0.0) * middle,
        absolute=deviations.get(f"declared:{channel}", 1.0) * noise.absolute,
        relative=noise.relative,
        law=law,
    )


def _force_laws(fitter: Fitter, fit: Fit, scatter: Scatter) -> dict[str, ForceLaw]:
    """Error of the law of pull and torque by channel, from its prior and this table together."""
    points = fitter.points
    if not points.forces or not fitter.working:
        return {}
    # ln phi is known to this variance: the mean of phi^2 is exp(2 variance) times the middle's.
    variances = np.diag(fitter.scatter_covariance(fit, scatter))
    mean = dict(zip(scatter.names, np.exp(variances), strict=True))
    own = wheel_discrepancy(points.conditions)[points.row]
    known = over_scatter(
        fitter, fit, scatter, lambda there: _off_where_measured(fitter, fit, there)
    )
    found, deviations = {}, scatter.deviations
    for i, name in enumerate(points.forces):
        law, wheel = (deviations[f"{of}:{name}"] * float(mean[f"{of}:{name}"])
                      for of in ("law", "wheel"))  # fmt: skip
        middle = float(np.median(own[points.of_channel(name)]))
        found[name] = ForceLaw(float(np.sqrt(known[i])), law * FORCE_LAW, wheel * middle)
    return found


def _off_where_measured(fitter: Fitter, fit: Fit, scatter: Scatter) -> Array:
    """Mean square error of the predictions where measured, relative to the levels, by force channel.

    Shape (force channels,). The truth t = f + d, with d the error of the law, is estimated from all values:
    with the prediction t0 at the prior's centre, S = J P^-1 J' + V_d, and K = S + the scatter of runs and
    rows, it is t0 + S K^-1 (y - t0) with covariance S - S K^-1 S (Gaussian conditioning).
    """
    points, model = fitter.points, fitter.true_variance
    mine, seen = fitter.blocks(fit)[-1]
    slopes, level = fit.slopes[np.ix_(seen, mine)], fitter.level[seen]
    precision = fit.vector.precision(fit.theta)[np.ix_(mine, mine)]
    by_prior = slopes @ np.linalg.inv(precision) @ slopes.T
    left = (points.value - fit.predicted)[seen]
    away = left + slopes @ (fit.theta - fit.vector.centre)[mine]
    total = model.covariance(scatter, fit.stiffness).matrix[np.ix_(seen, seen)]
    true = by_prior + model.of_law(scatter.log_deviation)[np.ix_(seen, seen)]
    k = Covariance(by_prior + total)
    off = true @ k.solve(away) - (away - left)
    square = (off**2 + np.diag(true) - np.sum(k.whiten(true) ** 2, axis=0)) / level**2
    return np.array([square[points.of_channel(name)[seen]].mean() for name in points.forces])


def tied_settings(points: Points) -> tuple[Tied, ...]:
    """Pairs of settings that were varied together: one explains at least `TOGETHER` of the other's variance.

    The other setting is described as a linear function of the first, with the scatter about it, SI.
    """
    rows = np.unique(points.row, return_index=True)[1]
    columns = {n: c[rows] for n, c in points.varied.items()
               if n in ("load", *SETTINGS) and np.isfinite(c).all()}  # fmt: skip
    return tuple(_ties(columns))


def _ties(columns: Mapping[str, Array]) -> Iterator[Tied]:
    for (a, x), (b, y) in itertools.combinations(columns.items(), 2):
        few = np.unique(np.round(x, 9)).size < _FEWEST_LEVELS
        if few or np.corrcoef(x, y)[0, 1] ** 2 < TOGETHER:
            continue
        slope, at = np.polyfit(x, y, 1)
        left = float(np.std(y - at - slope * x, ddof=2))
        yield Tied(a, b, float(at), float(slope), max(left, _LEAST_OFF * float(np.ptp(y))))
