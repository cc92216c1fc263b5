# SPDX-License-Identifier: Apache-2.0
"""The strength of a soil from its shear tests, and its place in a model.

A model's law of thrust is that of Janosi and Hanamoto, so its numbers are those of that law even where the
curves show a peak; a note then says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from smallwheel_ros.common.errors import SmallwheelError, nearest
from smallwheel_ros.fitting.constants import DETERMINED
from smallwheel_ros.fitting.named import FittedParameter, Status
from smallwheel_ros.fitting.parameters import STRENGTH_PARAMETERS
from smallwheel_ros.lab.plates import percent
from smallwheel_ros.lab.shear import FittedShearLaw, RunFit, ShearFit, normal_stresses
from smallwheel_ros.measurements.display import listed, number
from smallwheel_ros.measurements.measurements import ShearTests
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.physics.shear import peaked_share
from smallwheel_ros.physics.soil import Soil

Array = NDArray[np.float64]

_NAMES = ("cohesion", "friction_angle", "log_shear_displacement")
_SEEN = 3.0  # shear moduli, at which a curve has 95 % of its strength
_COMPATIBLE = 2.0  # standard deviations
_FEW_STRESSES = "shear at three normal stresses that span a factor of 3 or more"


class StrengthError(SmallwheelError):
    """Shear tests that do not fit to a model."""


@dataclass(frozen=True)
class LabStrength:
    """The strength of one soil as a model holds it.

    Attributes
    ----------
    soil
        Name of the soil; empty if the tests name none.
    cohesion
        c, Pa, at least 0.
    friction_angle
        phi, rad.
    modulus
        Shear deformation modulus K, m.
    covariance
        Covariance of (c, phi, ln K), shape (3, 3).
    parameters
        c, phi and ln K as fitted, for people: c and phi may be below 0 here.
    notes
        Sentences on what the tests cannot determine, and on what was set to 0.
    """

    soil: str
    cohesion: float
    friction_angle: float
    modulus: float
    covariance: Array
    parameters: tuple[FittedParameter, ...]
    notes: tuple[str, ...]

    @property
    def derived(self) -> tuple[FittedParameter, ...]:
        """K (m) for people, as a tuple of one; its deviation is to first order K times that of ln K."""
        of_log = self.parameters[2]
        std = self.modulus * float(np.sqrt(self.covariance[2, 2]))
        return (
            replace(of_log, name="shear_displacement", value=self.modulus, std=std, unit="m",
                    bounds=(0.0, np.inf)),
        )  # fmt: skip

    def of(self, soil: Soil, source: str) -> Soil:
        """Return a copy of a soil with this strength; its k, n and m stay.

        Parameters
        ----------
        soil
            The soil.
        source
            File of the shear tests, which is added to the soil's `source`; empty: nothing is added.
        """
        told = f"{soil.source}; " if soil.source else ""
        return replace(
            soil,
            cohesion=self.cohesion,
            friction_angle=self.friction_angle,
            shear_displacement=self.modulus,
            source=f"{told}strength: shear tests, {source}" if source else soil.source,
        )


def strength_of(fit: ShearFit) -> LabStrength:
    """The strength for a model, from the fit of Janosi and Hanamoto's law: c and phi are at least 0.

    Raises StrengthError if the strength falls with the normal stress, or the curves show no limit of it.
    """
    law = fit.plain
    c, friction, log_modulus = law.values.tolist()
    stds = np.sqrt(np.diag(law.covariance))
    if friction < -_COMPATIBLE * stds[1] or (friction < 0.0 and c < 0.0):
        raise StrengthError(
            f"shear tests{_of(fit.soil)}: the strength falls with the normal stress (tan phi = "
            f"{friction:.3g} +- {stds[1]:.2g}), expected it to rise: are the two stresses in the right "
            "columns, and each run at its own normal stress?"
        )
    _refuse_unknown(fit)
    notes = [*fit.notes, *_about_stresses(fit)]
    bounded_c, bounded_friction = c, friction
    # On a bound the other follows by its covariance: the best strength that has c, or tan phi, 0.
    if c < 0.0:
        notes.append(_about_negative(law))
        bounded_c = 0.0
        bounded_friction = friction - law.covariance[1, 0] / law.covariance[0, 0] * c
    elif friction < 0.0:
        notes.append(
            f"tan phi came out as {friction:.2g} +- {stds[1]:.2g}: compatible with zero. The model has 0 and "
            "the cohesion that goes with it"
        )
        bounded_friction = 0.0
        bounded_c = c - law.covariance[0, 1] / law.covariance[1, 1] * friction
    notes += _about_displacement(fit)
    if fit.shows_peak:
        residual = float(np.clip(fit.peaked.values[3], 0.1, 1.0))
        # for K_r off 0.66 the law's largest stress is a little over tau_max
        left = residual / float(peaked_share(np.linspace(0.0, 5.0, 501), 1.0, residual).max())
        notes.append(
            f"stress rises to a peak and falls to {100.0 * left:.0f} % of it: the model's law of thrust "
            "(Janosi-Hanamoto) has no peak, and its c, phi, K are fitted to whole curves"
        )
    phi = float(np.arctan(bounded_friction))
    scale = np.diag([1.0, np.cos(phi) ** 2, 1.0])
    covariance = scale @ law.covariance @ scale
    return LabStrength(
        fit.soil, bounded_c, phi, float(np.exp(log_modulus)), covariance,
        _parameters(fit, (c, float(np.arctan(friction)), log_modulus), covariance), tuple(notes),
    )  # fmt: skip


def _refuse_unknown(fit: ShearFit) -> None:
    """Raise StrengthError if the curves show no limit of the stress: the strength is not determined then."""
    law = fit.plain
    sigma = float(np.mean([run.curve.normal_stress for run in law.runs]))
    at = np.zeros(law.values.size)
    at[:2] = 1.0, sigma
    strength, std = float(at @ law.values), float(np.sqrt(at @ law.covariance @ at))
    if std > DETERMINED * strength:
        far = max(run.curve.travel for run in law.runs)
        raise StrengthError(
            f"shear tests{_of(fit.soil)}: within {1e3 * far:.3g} mm the stress shows no limit: the strength "
            f"at {1e-3 * sigma:.4g} kPa would be {1e-3 * strength:.3g} +- {1e-3 * std:.2g} kPa. This data "
            "cannot tell it: shear further"
        )


def _of(soil: str) -> str:
    return f" of {soil}" if soil else ""


def _parameters(
    fit: ShearFit, values: Sequence[float], covariance: Array
) -> tuple[FittedParameter, ...]:
    few = len(normal_stresses(fit.plain.runs)) < 2
    short = all(not _seen(run) for run in fit.plain.runs)
    found = []
    for name, value, variance in zip(_NAMES, values, np.diag(covariance), strict=True):
        unit, prior = STRENGTH_PARAMETERS[name]
        unknown = short if name == "log_shear_displacement" else few
        status: Status = "not determined" if unknown else "determined"
        remedy = "" if not unknown else _FEW_STRESSES if few else "shear further, to 3 K"
        found.append(
            FittedParameter(fit.soil or "soil", name, value, float(np.sqrt(variance)), unit,
                            (prior.low, prior.high), status, remedy)
        )  # fmt: skip
    return tuple(found)


def _about_stresses(fit: ShearFit) -> list[str]:
    stresses = normal_stresses(fit.plain.runs)
    if len(stresses) > 1:
        return []
    sigma = stresses[0]
    c, phi = (STRENGTH_PARAMETERS[name][1] for name in ("cohesion", "friction_angle"))
    strength = fit.plain.values[0] + sigma * fit.plain.values[1]
    return [
        f"one normal stress, {1e-3 * sigma:.4g} kPa: only the strength there, {1e-3 * strength:.4g} kPa, "
        "is measured. Cohesion and friction angle cannot be told apart: they rest on what soils "
        f"usually have, c = {1e-3 * c.centre:.2g} +- {1e-3 * c.deviation:.2g} kPa and phi = "
        f"{np.degrees(phi.centre):.0f} +- {np.degrees(phi.deviation):.0f} deg; {_FEW_STRESSES}"
    ]


def _about_negative(law: FittedShearLaw) -> str:
    c, std = float(law.values[0]), float(np.sqrt(law.covariance[0, 0]))
    came = f"cohesion came out as {1e-3 * c:.2g} +- {1e-3 * std:.2g} kPa"
    if c > -_COMPATIBLE * std:
        return f"{came}: compatible with zero. The model has 0 and the friction angle that goes with it"
    return (
        f"{came}, below zero by {-c / std:.1f} standard deviations: no soil has that. Is the weight of the "
        "shear head in the normal stress, and is the torque's zero right? The model has 0"
    )


def _seen(run: RunFit) -> bool:
    return bool(run.curve.travel >= _SEEN * np.exp(run.numbers[1]))


def _about_displacement(fit: ShearFit) -> list[str]:
    runs = fit.plain.runs
    short = [run for run in runs if not _seen(run)]
    if not short:
        return []
    modulus = float(np.exp(fit.plain.values[2]))
    far = max(run.curve.travel for run in short)
    which = "no run" if len(short) == len(runs) else f"{len(short)} of {len(runs)} runs do not"
    verb = "reaches" if len(short) == len(runs) else "reach"
    return [
        f"{which} {verb} 3 K ({3e3 * modulus:.3g} mm; the longest of them ends at {1e3 * far:.3g} mm): "
        "strength and K are extrapolated together there, and a peak beyond would not be seen; shear further"
    ]


def with_strength(
    model: CalibratedModel, strengths: Sequence[LabStrength], tests: ShearTests
) -> CalibratedModel:
    """Return a model with the measured strengths of its soils, and their covariance.

    One soil in the model and one in the tests are taken as the same soil, whatever they are called. Effects
    stay; what the model knows of measured forces and of rival models is dropped.

    Parameters
    ----------
    model
        The model.
    strengths
        One strength for each soil of the tests.
    tests
        The shear tests from which the strengths were computed.

    Raises
    ------
    StrengthError
        If the tests name a soil that the model does not have.
    """
    names = [soil.name for soil in model.model.soils]
    soils = {soil.name: soil for soil in model.model.soils}
    kept_names, covariance = list(model.names), model.covariance
    for strength in strengths:
        name = names[0] if len(names) == len(strengths) == 1 else strength.soil
        if name not in soils:
            raise StrengthError(
                f"{tests.source}: shear tests of soil '{name}', which the model does not have: "
                f"{nearest(name, names)}"
            )
        soils[name] = strength.of(soils[name], tests.source)
        own = [f"{name}.{parameter}" for parameter in _NAMES]
        keep = [i for i, known in enumerate(kept_names) if known not in own]
        kept_names = [kept_names[i] for i in keep] + own
        covariance = block_diag(covariance[np.ix_(keep, keep)], strength.covariance)
    provenance = dict(model.provenance)
    provenance["shear"] = {"data": tests.source, "sha256": tests.sha256, "rows": len(tests),
                           "runs": len(set(tests.run.tolist()))}  # fmt: skip
    made = Model(
        [soils[n] for n in names],
        model.model.geometry,
        model.model.effects,
        model.model.thrust_form,
    )
    return model.changed(
        model=made, names=tuple(kept_names), covariance=covariance, provenance=provenance,
        measured=replace(model.measured, forces={}), rivals=(),
    )  # fmt: skip


def shear_text(fit: ShearFit, strength: LabStrength) -> str:
    """Report for people on the shear tests of one soil: both laws' numbers and errors, and the better law.

    Parameters
    ----------
    fit, strength
        The fitted shear tests of a soil, and the strength that `strength_of` made from them.
    """
    runs = fit.plain.runs
    stresses = listed([f"{1e-3 * s:.4g}" for s in normal_stresses(runs)])
    name = f" of {fit.soil}" if fit.soil else ""
    lines = [
        f"Shear tests{name}: {len(runs)} {'run' if len(runs) == 1 else 'runs'} at {stresses} kPa"
    ]
    for law in (fit.plain, fit.peaked):
        lines.append(f"  {law.law.name}: {law.law.formula}")
        lines.append(f"    {', '.join(_shear_numbers(law))}; {_shape_error(law)}")
    chosen = fit.chosen.law.name
    seen = "a peak" if fit.shows_peak else "no peak"
    lines.append(f"  The curves show {seen}: {chosen} describes them.")
    return "\n".join([*lines, *(f"  note: {note}" for note in strength.notes)])


def _shear_numbers(law: FittedShearLaw) -> list[str]:
    c, friction, log_modulus, *residual = law.values.tolist()
    std = np.sqrt(np.diag(law.covariance))
    phi, phi_std = np.degrees(np.arctan(friction)), np.degrees(std[1] / (1.0 + friction**2))
    modulus = 1e3 * float(np.exp(log_modulus))
    found = [
        f"c = {number(1e-3 * c)} +- {number(1e-3 * std[0], 2)} kPa",
        f"phi = {number(phi)} +- {number(phi_std, 2)} deg",
        f"{'K_w' if residual else 'K'} = {number(modulus)} +- {number(modulus * std[2], 2)} mm",
    ]
    return found + [f"K_r = {number(r)} +- {number(std[3], 2)}" for r in residual]


def _shape_error(law: FittedShearLaw) -> str:
    if law.held_out is None:
        return f"curve off by {percent(law.runs[0].misfit)} of the strength (in sample: one run)"
    return f"shape of a run left out off by {percent(law.held_out)} of the strength"


def shear_document(fit: ShearFit, strength: LabStrength) -> dict[str, Any]:
    """Report on the shear tests of one soil as plain values for JSON, SI units.

    Keys: soil, follows (id of the better law), model (the strength with its covariance), parameters, laws (by
    id: both fits, with each run), notes.

    Parameters
    ----------
    fit, strength
        The fitted shear tests of a soil, and the strength that `strength_of` made from them.
    """
    return {
        "soil": fit.soil,
        "follows": fit.chosen.law.id,
        "model": {
            "cohesion": strength.cohesion,
            "friction_angle": strength.friction_angle,
            "shear_displacement": strength.modulus,
            "names": ["cohesion", "friction_angle", "log_shear_displacement"],
            "covariance": strength.covariance.tolist(),
        },
        "parameters": {
            p.name: p.to_dict() for p in (*strength.parameters, *strength.derived)
        },
        "laws": {
            law.law.id: {
                "formula": law.law.formula,
                "source": law.law.source,
                "names": list(law.names),
                "values": law.values.tolist(),
                "covariance": law.covariance.tolist(),
                "held_out": law.held_out,
                "run_scatter": law.scatter.tolist(),
                "runs": [
                    {"run": r.curve.run, "normal_stress": r.curve.normal_stress,
                     "strength": float(r.numbers[0]), "modulus": float(np.exp(r.numbers[1])),
                     "misfit": r.misfit, "displacement": r.curve.travel}
                    for r in law.runs
                ],
            }
            for law in (fit.plain, fit.peaked)
        },
        "notes": list(strength.notes),
    }  # fmt: skip
