"""Estimates as the fields of their messages, without ROS: what node and replay write alike."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.onboard.mobility import MobilityEstimate
from smallwheel_ros.physics.wheel import Quantity

STATUS_OK, STATUS_PRIOR_ONLY = 0, 1  # of SoilEstimate.msg
# The message's names of its quantities and of their standard deviations: first what belongs to the
# wheel, then what `_of_forces` gives.
_QUANTITIES = tuple(
    (name, f"{name}_standard_deviation")
    for name in (
        "load",
        "slip",
        "sinkage_measured",
        "sinkage_predicted",
        "compaction_resistance",
        "other_resistance",
        "rolling_resistance_coefficient",
        "thrust",
        "drawbar_pull",
        "mobility_margin",
        "steepest_slope",
        "energy_per_metre",
    )
)
_of_forces = attrgetter(
    "compaction_resistance",
    "other_resistance",
    "rolling_resistance_coefficient",
    "thrust",
    "drawbar_pull",
    "margin",
    "steepest_slope",
    "energy_per_metre",
)


def mobility_fields(estimate: MobilityEstimate) -> dict[str, Any]:
    """Return all fields of MobilityEstimate.msg but its header.

    The header's stamp is `estimate.stamp` (ns), its frame_id `estimate.wheel`.
    """
    forces = estimate.forces if estimate.sinkage_predicted is not None else None
    probability = None if forces is None else forces.probability_drawbar_pull_positive
    fields: dict[str, Any] = {
        "status": int(estimate.status),
        "status_text": estimate.status_text,
        "load_valid": estimate.load is not None,
        "slip_valid": estimate.slip is not None,
        "sinkage_measured_valid": estimate.sinkage_measured is not None,
        "prediction_valid": forces is not None,
        "traction_valid": forces is not None and forces.drawbar_pull is not None,
        "probability_drawbar_pull_positive": probability or 0.0,
        "margin_valid": forces is not None and forces.margin is not None,
        "energy_valid": forces is not None and forces.energy_per_metre is not None,
        "digging_in": estimate.digging_in,
    }
    quantities: tuple[Quantity | None, ...] = (
        estimate.load,
        estimate.slip,
        estimate.sinkage_measured,
        *((None,) * 9 if forces is None else (estimate.sinkage_predicted, *_of_forces(forces))),
    )
    for (name, deviation), quantity in zip(_QUANTITIES, quantities, strict=True):
        if quantity is None:  # not known
            fields[name] = fields[deviation] = 0.0
        else:
            fields[name], fields[deviation] = quantity.value, quantity.standard_deviation
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
