# SPDX-License-Identifier: Apache-2.0
"""`learn`: which law a model of the measurements lacks."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from smallwheel_ros.api.read import read
from smallwheel_ros.arguments import EffectId, Ids, Laws, Levels, Seed, unheard
from smallwheel_ros.measurements.given import Data
from smallwheel_ros.model.given import AnyModel, OwnEffects

if TYPE_CHECKING:
    from smallwheel_ros.learn.learning import Learnt


def learn(
    data: Data,
    model: AnyModel | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    name: EffectId | None = None,
    most: Laws = 1,
    can: Levels | None = None,
    seed: Seed = 0,
    progress: Callable[[str, int, int], object] = unheard,
) -> "Learnt":
    """Learn which law a model of the measurements lacks, where no known effect explains it.

    The program searches some 40,000 formulas inside the model. It drafts a law only where chance would not
    gain as much, and where the law also predicts settings that the search never saw. That nothing could be
    learnt is a normal answer.

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
        Effects to take out of the model, by id; the law is not compared with them.
    name : str, optional
        Id of the law; without it, one made from the settings on which the law depends.
    most : int, optional
        Largest number of laws to learn, one after the other.
    can : dict, as ``{"slip": [0, 0.3, 0.6]}``, optional
        Levels that you can set in further measurements (SI units, angles in rad).
    seed : int, optional
        Seed of permutations and folds: the same seed gives the same result, to the byte.
    progress : callable, optional
        Called with the name of each step, the number of its parts done, and their total (0: not known).

    Returns
    -------
    Learnt
        The `verdict`, and the `law` with its formula, constants and drivers; None if none was learnt.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.learn("rig.csv")
    >>> found.verdict, found.law["drivers"]
    ('law', ['slip'])
    """
    from smallwheel_ros.diagnosis.pipeline import start_of
    from smallwheel_ros.learn.learning import learnt

    return learnt(start_of(read(data), model, effects, without, can, seed), name, most, progress)
