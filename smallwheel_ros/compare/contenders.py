# SPDX-License-Identifier: Apache-2.0
"""The models that a comparison sets side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from smallwheel_ros.effects.registry import Registry, effect
from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.parameters import EffectPart, part_of
from smallwheel_ros.fitting.points import Points
from smallwheel_ros.fitting.problem import one_diameter, soil_names
from smallwheel_ros.model.given import Models, list_of, model_of
from smallwheel_ros.model.mixture import mixed, rivals_text
from smallwheel_ros.model.model import Model
from smallwheel_ros.physics.conditions import PLATE
from smallwheel_ros.physics.soil import Soil, soil

# Names of the standard contenders.
STANDARD = ("constant", "bekker", "meirion_griffith_spenko", "wong_reece", "contact_integral")
REGRESSION = "log_log_regression"


@dataclass(frozen=True)
class Contender:
    """A model to compare.

    Attributes
    ----------
    name
        Name in tables and plots.
    description
        What it is, for people.
    model
        A `Base` is fitted to the data, a `Model` is used as it is. None for a model without physics: a
        constant, which is the mean of the channel over the training rows, or a regression on the settings
        (`fitting.noise`), which does not predict pull and torque.
    file, fitted_to
        File of a model used as it is, and the SHA-256 of the data that it was fitted to; empty if unknown.
    """

    name: str
    description: str
    model: Base | Model | None
    file: str = ""
    fitted_to: str = ""

    @property
    def fitted(self) -> bool:
        """Whether it is fitted to the data."""
        return not isinstance(self.model, Model)


def standard_contenders(points: Points) -> list[Contender]:
    """A constant, a regression, Bekker's law, that of Meirion-Griffith & Spenko and the contact integral.

    With pull or torque measured at known slip, that of Wong and Reece too; the regression only if another
    channel was measured. The closed forms have the thrust that is published with them, the contact integral
    the balance of stresses.
    """
    wheels = points.conditions.contact != PLATE  # plates have no width
    widths = np.unique(np.round(points.conditions.width[wheels], 4)).size
    of_width: tuple[EffectPart, ...] = ()
    modulus = "with one width only K = kc/b + kphi is determined, not kc and kphi"
    if widths > 1:  # the share of kc is a parameter of the effect
        of_width = (part_of(effect("width_dependent_modulus", "bekker")),)
        modulus = f"kc and kphi of K = kc/b + kphi fitted over {widths} widths"
    exponent = same = ""
    if all(one_diameter(points, soil) for soil in soil_names(points)):
        exponent = "; with one diameter only k D^m is determined, not m"
        same = ", and the law is that of bekker" if widths == 1 else ""
    stresses = Contender(
        STANDARD[3],
        "Wong and Reece 1967, stresses along the arc whose peak moves with slip: P = k z^n D^m sets the "
        "pressure, and pressure and shear carry the load together" + exponent,
        Base(thrust_form="wong_reece"),
    )
    regression = Contender(
        REGRESSION,
        "ln of the value linear in ln load, ln of the sizes, slip, its square, pass and speed, as far as "
        "they were varied: no physics, and what a law has to beat",
        None,
    )
    return [
        Contender(
            STANDARD[0],
            "the mean of the other runs, whatever load and slip: a law with a larger error explains nothing",
            None,
        ),
        *([regression] if set(points.channels) - set(points.forces) else []),
        Contender(
            STANDARD[1],
            f"Bekker 1956, closed form (eq. 7), P = K z^n without diameter; {modulus}",
            Base(geometry="closed_form", thrust_form="integrated", parts=of_width, fixed_m=0.0),
        ),
        Contender(
            STANDARD[2],
            "Meirion-Griffith & Spenko 2011, closed form (eq. 10), P = k z^n D^m" + exponent + same,
            Base(geometry="closed_form", thrust_form="integrated"),
        ),
        *([stresses] if points.forces else []),
        Contender(
            STANDARD[4],
            "P = k z^n D^m with the exact contact integral in place of eq. 10" + exponent,
            Base(),
        ),
    ]


def contenders_of(models: Models, known: Registry) -> list[Contender]:
    """Make a contender of each model that a user gave, to be used as it is; each gets a different name.

    Parameters
    ----------
    models
        One or several of what `model_of` takes (model files, soils of the library, models), or a mapping from
        names to them.
    known
        Effects that model files may name.

    Raises
    ------
    ArgumentError, ModelFileError
        If one is not a model, or its file cannot be used.
    """
    if isinstance(models, Mapping):
        named = [(str(name), model) for name, model in models.items()]
    else:
        single = isinstance(models, (str, PathLike, Model, Soil)) or hasattr(models, "model")
        listed = [models] if single else list_of("models", models)
        named = [("", model) for model in listed]
    found: list[Contender] = []
    for name, given in named:
        read_one, taken = model_of(given, known), [*STANDARD, *(c.name for c in found)]
        of_library = isinstance(given, str) and given in soil
        file = str(given) if isinstance(given, (str, PathLike)) and not of_library else ""
        name = name or (str(given) if of_library else Path(file).stem) or "model"
        if name in taken:
            name = file if file and file not in taken else f"{name}_{len(taken) + 1}"
        effects = ", ".join(effect.id for effect in read_one.effects) or "no effects"
        source = f"model file {file}" if file else "soil of the library" if of_library else "model"
        about = f"{source}: {read_one.geometry}, {effects}"
        if read_one.rivals:
            about = (
                f"{source}: {read_one.geometry}, the mean of models that its data could not tell apart: "
                f"{rivals_text(read_one)}"
            )
        digest = str(read_one.provenance.get("sha256", ""))
        found.append(Contender(name, about, mixed(read_one), file, digest))
    return found
