# SPDX-License-Identifier: Apache-2.0
"""`add`: one more effect in a model, and what it does to the held-out error."""

from typing import TYPE_CHECKING

from smallwheel_ros.api.read import read
from smallwheel_ros.arguments import Ids, Seed
from smallwheel_ros.common.errors import ArgumentError, kind_of
from smallwheel_ros.measurements.given import Data
from smallwheel_ros.model.given import AnyEffect, AnyModel, OwnEffects

if TYPE_CHECKING:
    from smallwheel_ros.diagnosis.apply import Added


def add(
    effect: AnyEffect,
    model: AnyModel | None = None,
    data: Data | None = None,
    *,
    effects: OwnEffects | None = None,
    without: Ids = (),
    seed: Seed = 0,
) -> "Added":
    """Add one effect to a model, fit it with the soil, and compare the held-out errors.

    Parameters
    ----------
    effect : str, Effect (with numbers to start from) or class of effects
        Its id, of which the form that fits best is taken, or id/form, as `slip_sinkage/exponential`.
    model : Model, Soil, result with a model, name or path, optional
        The model to add it to: a model file, or a soil of the library. Without it: the contact integral
        alone.
    data : path, DataFrame, or what `sw.read` returned
        Measurements to fit the model to; their diagnosis decides whether the effect is recommended.
    effects : path, or what `sw.effects.load` returned, optional
        A Python file with effects of your own. It is run: name only files that you trust.
    without : str or several, optional
        Ids of effects to leave out as candidates; `unknown` leaves out the smooth curves that stand for an
        effect that is in no library.
    seed : int, optional
        Seed of the simulations behind the p-values: the same seed gives the same result.

    Returns
    -------
    Added
        The fitted model with the effect, its held-out errors `before` and `after` by channel (m, N or N m),
        and whether it is `recommended`, with the reason.

    Raises
    ------
    ArgumentError, EffectError, MeasurementsError
        If `data` is missing or cannot be used, or the effect does not exist or cannot be fitted to it.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> added = sw.add("slip_sinkage", data="rig.csv")
    >>> added.recommended
    True
    """
    from smallwheel_ros.diagnosis.apply import added
    from smallwheel_ros.diagnosis.pipeline import start_of

    if data is None:
        raise ArgumentError("data: found nothing, expected the measurements to fit the effect to")
    if not isinstance(getattr(effect, "id", effect), str):
        raise ArgumentError(f"effect: found {kind_of(effect)}, expected an effect's id or class")
    return added(effect, start_of(read(data), model, effects, without, seed=seed))
