"""Estimates as the fields of their messages, without ROS: what node and replay write alike."""

from __future__ import annotations

from typing import Any

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.onboard.mobility import MobilityEstimate
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
# Quantities of the message, and what they are called in `WheelForces`.
_OF_FORCES = {
    "compaction_resistance": "compaction_resistance",
    "other_resistance": "other_resistance",
    "rolling_resistance_coefficient": "rolling_resistance_coefficient",
    "thrust": "thrust",
    "drawbar_pull": "drawbar_pull",
    "mobility_margin": "margin",
    "steepest_slope": "steepest_slope",
    "energy_per_metre": "energy_per_metre",
}


def mobility_fields(estimate: MobilityEstimate) -> dict[str, Any]:
    """Return all fields of MobilityEstimate.msg but its header.

    The header's stamp is `estimate.stamp` (ns), its frame_id `estimate.wheel`.
    """
    predicted = estimate.sinkage_predicted
    forces = None if predicted is None else estimate.forces
    quantities: dict[str, Quantity | None] = {
        "load": estimate.load,
        "slip": estimate.slip,
        "sinkage_measured": estimate.sinkage_measured,
        "sinkage_predicted": None if forces is None else predicted,
    }
    for name, of_forces in _OF_FORCES.items():
        quantities[name] = getattr(forces, of_forces, None)
    fields: dict[str, Any] = {
        "status": int(estimate.status),
        "status_text": estimate.status_text,
        "load_valid": estimate.load is not None,
        "slip_valid": estimate.slip is not None,
        "sinkage_measured_valid": estimate.sinkage_measured is not None,
        "prediction_valid": forces is not None,
        "traction_valid": quantities["drawbar_pull"] is not None,
        "probability_drawbar_pull_positive": 0.0,
        "margin_valid": quantities["mobility_margin"] is not None,
        "energy_valid": quantities["energy_per_metre"] is not None,
        "digging_in": estimate.digging_in,
        "risk_valid": estimate.risk is not None,
        "risk_of_getting_stuck": estimate.risk or 0.0,
    }
    if forces is not None and forces.probability_drawbar_pull_positive is not None:
        probability = forces.probability_drawbar_pull_positive
        fields["probability_drawbar_pull_positive"] = probability
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
