"""The soil and the effects that the estimate starts with: of the library, or of a model file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import load
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.model_file import read_model
from smallwheel_ros.physics.soil import Soil, SoilError, nearest, soil

_DEFAULT = "dry_sand"


class StartingModelError(SmallwheelError):
    """A model file that the estimate on board cannot go by."""


@dataclass(frozen=True)
class StartingModels:
    """What can be started from: the soils of one model file with its effects, or the library.

    model_file: empty for the library. soils: those of the file.
    """

    model_file: str = ""
    soils: tuple[Soil, ...] = ()
    effects: tuple[Effect, ...] = ()

    def choose(self, name: str | None) -> Soil:
        """Return the soil of that name; None: the only one of the file, or the library's dry sand.

        Raises StartingModelError where there is no such soil.
        """
        if not self.model_file:
            try:
                return soil(name or _DEFAULT)
            except SoilError as error:
                raise StartingModelError(f"parameter soil.name: {error}") from None
        found = {kind.name: kind for kind in self.soils}
        if name is None and len(found) == 1:
            return self.soils[0]
        if name not in found:
            asked = f"has no soil '{name}'" if name else "has several soils"
            raise StartingModelError(
                f"{self.model_file} {asked}, parameter soil.name says which."
                f" {nearest(name or '', list(found))}"
            )
        return found[name]


def read_starting_models(model_file: str | None, effects_file: str | None) -> StartingModels:
    """Read the files that the parameters of these names give, if any. An effects file is run.

    Raises
    ------
    SmallwheelError
        If a file cannot be read, or the estimate cannot follow the model.
    """
    if not model_file:
        if effects_file:
            raise StartingModelError(
                "parameter effects_file is given without model_file: an effect needs its numbers"
            )
        return StartingModels()
    effects = load(Path(effects_file).expanduser()) if effects_file else None
    model = read_model(Path(model_file).expanduser(), effects).model
    if model.geometry != "contact_integral":
        raise StartingModelError(
            f"{model_file}: geometry is {model.geometry}, expected contact_integral: the estimate on"
            " board solves the contact exactly; fit the model again without the closed form"
        )
    return StartingModels(model_file, tuple(model.soils), tuple(model.effects))
