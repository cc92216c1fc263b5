# SPDX-License-Identifier: Apache-2.0
"""What came of the reading of one wheel, and what of it is in the messages: node and replay write alike."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.onboard.mobility import WheelForces
from smallwheel_ros.physics.wheel import Quantity

STATUS_OK, STATUS_PRIOR_ONLY = 0, 1  # of SoilEstimate.msg
# Flags of MobilityEstimate.msg, and the quantities that they are about: 0 where they are not known.
VALID = {
    "load_valid": ("load",),
    "slip_valid": ("slip",),
    "sinkage_measured_valid": ("sinkage_measured",),
    "prediction_valid": (
        "sinkage_predicted",
        "compaction_resistance",
        "other_resistance",
        "rolling_resistance_coefficient",
    ),
    "traction_valid": ("thrust", "drawbar_pull", "probability_drawbar_pull_positive"),
    "margin_valid": ("mobility_margin", "steepest_slope"),
    "energy_valid": ("energy_per_metre",),
    "risk_valid": ("risk_of_getting_stuck",),
}
_UNKNOWN = Quantity(0.0, 0.0)
# Quantities of the message that are called so in `WheelForces`, too.
_OF_FORCES = (
    "compaction_resistance",
    "other_resistance",
    "rolling_resistance_coefficient",
    "thrust",
    "drawbar_pull",
    "steepest_slope",
    "energy_per_metre",
)


class Status(IntEnum):
    """The most serious of the conditions that apply; numbered as in MobilityEstimate.msg."""

    OK = 0
    PRIOR_ONLY = 1
    SLIP_UNKNOWN = 2
    REJECTED = 3
    LOAD_MISSING = 4
    SUNK_TO_AXLE = 5


@dataclass(frozen=True)
class Result:
    """One wheel at one instant: what was measured, and what the model makes of it; SI units.

    Attributes
    ----------
    status_text
        All conditions that apply, in words.
    sinkage_predicted, forces
        Of the soil as estimated before this sinkage was used, and after; None where load is missing
        or the wheel is sunk to its axle. The former, and resistances, are also unknown where nobody
        measures sinkage nor has named the soil.
    digging_in
        Slip and sinkage grow while the wheel travels slower and slower.
    risk
        Probability that the vehicle gets stuck within the next metre (see `stuck_warning`); None
        where no margin is known.
    slope
        Tangent of the steepest slope of the ground there, whichever way the vehicle looks; 0 where none is
        measured.
    soil
        After the reading: the one that a wheel came to last; the forces are those on the wheel's own.
    rejected
        Measured sinkages that were not used for the soil since the start or the last reset.
    elsewhere
        Wheels that are on another soil than this one, just before or after a border.
    """

    reading: Reading
    status: Status
    status_text: str
    sinkage_predicted: Quantity | None
    forces: WheelForces | None
    digging_in: bool
    risk: float | None
    soil: SoilEstimate
    rejected: int
    elsewhere: tuple[str, ...]
    slope: float = 0.0

    @property
    def wheel(self) -> str:
        """Name of the wheel."""
        return self.reading.wheel.name

    @property
    def travel(self) -> float:
        """Way of the vehicle (m) up to what the soil rests on; where that is nothing, up to here."""
        return self.soil.distance if self.soil.accepted else self.reading.distance


def mobility_fields(result: Result) -> dict[str, Any]:
    """Return all fields of MobilityEstimate.msg but its header.

    The header's stamp is the instant's (ns), its frame_id the wheel's name.
    """
    reading, forces, risk = result.reading, result.forces, result.risk
    quantities: dict[str, Quantity | None] = {
        "load": reading.load,
        "slip": reading.slip,
        "sinkage_measured": reading.sinkage,
        "sinkage_predicted": result.sinkage_predicted,
        "mobility_margin": None if forces is None else forces.margin,
        **{name: getattr(forces, name, None) for name in _OF_FORCES},
    }
    if result.sinkage_predicted is None:
        quantities |= dict.fromkeys(VALID["prediction_valid"])
    positive = None if forces is None else forces.probability_drawbar_pull_positive
    fields: dict[str, Any] = {
        "status": int(result.status),
        "status_text": result.status_text,
        "probability_drawbar_pull_positive": 0.0 if positive is None else positive,
        "digging_in": result.digging_in,
        "risk_of_getting_stuck": risk or 0.0,
    }
    for flag, (first, *_) in VALID.items():
        fields[flag] = (risk if flag == "risk_valid" else quantities[first]) is not None
    for name, quantity in quantities.items():
        known = quantity or _UNKNOWN
        fields[name] = known.value
        fields[f"{name}_standard_deviation"] = known.standard_deviation
    return fields


def soil_fields(soil: SoilEstimate, rejected: int) -> dict[str, Any]:
    """Return all fields of SoilEstimate.msg but its header; the covariance has shape (9,).

    rejected: measurements that were not used, for any reason.
    """
    modulus, deviation = soil.effective_modulus()
    known = soil.identifiable
    return {
        "status": STATUS_PRIOR_ONLY if soil.accepted == 0 else STATUS_OK,
        "status_text": "; ".join(soil.status),
        "k": float(soil.k),
        "n": float(soil.n),
        "m": float(soil.m),
        "covariance": soil.covariance.ravel(),
        "reference_diameter": soil.reference_diameter,
        "reference_sinkage": soil.reference_sinkage,
        "effective_modulus": modulus,
        "effective_modulus_standard_deviation": deviation,
        "reference_pressure": soil.reference_pressure,
        "reference_pressure_standard_deviation": soil.reference_pressure_std,
        "k_identifiable": known.k,
        "n_identifiable": known.n,
        "m_identifiable": known.m,
        "effective_modulus_identifiable": known.effective_modulus,
        "reference_pressure_identifiable": known.reference_pressure,
        "measurements_accepted": soil.accepted,
        "measurements_rejected": rejected,
    }
