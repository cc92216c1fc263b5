"""The soil and the effects that the estimate starts with: of the library, or of a model file."""

from __future__ import annotations

from typing import NamedTuple

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import load_effects
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.model_file import read_model
from smallwheel_ros.physics.soil import Soil, SoilError, nearest, soil

_DEFAULT = "dry_sand"


class StartingModelError(SmallwheelError):
    """A model file that the estimate on board cannot go by."""


class StartingModel(NamedTuple):
    """A soil to start from, and the effects beside it."""

    soil: Soil
    effects: tuple[Effect, ...]


def start_from(
    model_file: str, effects_file: str = "", soil_name: str | None = None
) -> StartingModel:
    """Return soil and effects of a model file, or a soil of the library where there is none.

    Parameters
    ----------
    model_file, effects_file
        Empty: none. An effects file is run.
    soil_name
        Which soil; None: the only one of the model file, or dry sand of the library.

    Raises
    ------
    SmallwheelError
        If a file cannot be read, there is no such soil, or the estimate cannot follow the model.
    """
    if not model_file:
        if effects_file:
            raise StartingModelError(
                "parameter effects_file is given without model_file: an effect needs its numbers"
            )
        try:
            return StartingModel(soil(soil_name or _DEFAULT), ())
        except SoilError as error:
            raise StartingModelError(f"parameter soil.name: {error}") from None
    model = read_model(model_file, load_effects(effects_file) if effects_file else None).model
    if model.geometry != "contact_integral":
        raise StartingModelError(
            f"{model_file}: geometry is {model.geometry}, expected contact_integral: the estimate on"
            " board solves the contact exactly; fit the model again without the closed form"
        )
    soils = {kind.name: kind for kind in model.soils}
    if soil_name is None and len(soils) == 1:
        return StartingModel(model.soils[0], tuple(model.effects))
    if soil_name not in soils:
        asked = f"has no soil '{soil_name}'" if soil_name else "has several soils"
        listing = nearest(soil_name or "", list(soils))
        raise StartingModelError(f"{model_file} {asked}, parameter soil.name says which. {listing}")
    return StartingModel(soils[soil_name], tuple(model.effects))
