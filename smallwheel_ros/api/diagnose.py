# SPDX-License-Identifier: Apache-2.0
"""`diagnose`: which physical effect a model of the measurements is missing."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from smallwheel_ros.api.read import read
from smallwheel_ros.arguments import Ids, Levels, Seed, unheard
from smallwheel_ros.measurements.given import Data
from smallwheel_ros.model.given import AnyModel, OwnEffects

if TYPE_CHECKING:
    from smallwheel_ros.diagnosis.pipeline import Diagnosis


def diagnose(
    data: Data,
    model: AnyModel | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    can: Levels | None = None,
    seed: Seed = 0,
    progress: Callable[[str], object] = unheard,
) -> "Diagnosis":
    """Say which physical effect a model of the measurements is missing.

    Other verdicts are that none is missing, that no known effect explains the misfit, that several explain
    it equally well, and that there is too little data. The result also says where the model fails, what the
    data cannot show, and what to measure next.

    Parameters
    ----------
    data : path, DataFrame, or what `sw.read` returned
        The measurements.
    model : Model, Soil, result with a model, name or path, optional
        Start from this model; its soil is refitted within its covariance. Without it: the contact integral
        alone.
    effects : path, or what `sw.effects.load` returned, optional
        A Python file with effects of your own. It is run: name only files that you trust.
    without : str or several, optional
        Ids of effects to leave out as candidates; `unknown` leaves out the smooth curves that stand for an
        effect that is in no library.
    can : dict, as ``{"slip": [0, 0.3, 0.6]}``, optional
        Levels that you can set in further measurements (SI units, angles in rad).
    seed : int, optional
        Seed of the simulations behind the p-values: the same seed gives the same result.
    progress : callable, optional
        Called with the name of each step as it begins.

    Returns
    -------
    Diagnosis
        The `verdict`, the ids of `missing_effects` and `candidates`, and the model fitted with what is
        missing.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.diagnose("rig.csv")
    >>> found.verdict, found.missing_effects
    ('missing_effect', ['slip_sinkage'])
    """
    from smallwheel_ros.diagnosis.pipeline import diagnosis_of, start_of

    return diagnosis_of(start_of(read(data), model, effects, without, can, seed), progress)
