"""Between ROS messages and the library's values; nothing is worked out here."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.msg import MobilityEstimate as MobilityMessage
from smallwheel_ros.msg import SoilEstimate as SoilMessage
from smallwheel_ros.onboard.mobility import MobilityEstimate
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.wheel import Quantity


def nanoseconds_of(stamp: Time) -> int:
    """Turn a header's stamp into ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Turn ns into a header's stamp."""
    return Time(sec=stamp // SECOND, nanosec=stamp % SECOND)


def _set(message: MobilityMessage, name: str, quantity: Quantity | None) -> None:
    """Fill in a quantity; one that is not known stays 0."""
    if quantity is not None:
        setattr(message, name, quantity.value)
        setattr(message, f"{name}_standard_deviation", quantity.standard_deviation)


def mobility_message(estimate: MobilityEstimate) -> MobilityMessage:
    """Turn an estimate into its message."""
    message = MobilityMessage()
    message.header.stamp = time_message(estimate.stamp)
    message.header.frame_id = estimate.wheel
    message.status = int(estimate.status)
    message.status_text = estimate.status_text
    message.load_valid = estimate.load is not None
    _set(message, "load", estimate.load)
    message.slip_valid = estimate.slip is not None
    _set(message, "slip", estimate.slip)
    message.sinkage_measured_valid = estimate.sinkage_measured is not None
    _set(message, "sinkage_measured", estimate.sinkage_measured)
    forces = estimate.forces
    message.prediction_valid = forces is not None and estimate.sinkage_predicted is not None
    if forces is None or not message.prediction_valid:
        return message
    _set(message, "sinkage_predicted", estimate.sinkage_predicted)
    _set(message, "compaction_resistance", forces.compaction_resistance)
    _set(message, "other_resistance", forces.other_resistance)
    _set(message, "rolling_resistance_coefficient", forces.rolling_resistance_coefficient)
    message.traction_valid = forces.drawbar_pull is not None
    _set(message, "thrust", forces.thrust)
    _set(message, "drawbar_pull", forces.drawbar_pull)
    message.probability_drawbar_pull_positive = forces.probability_drawbar_pull_positive or 0.0
    return message


def soil_message(soil: SoilEstimate, stamp: int, frame: str, rejected: int) -> SoilMessage:
    """Turn an estimate of the soil into its message."""
    message = SoilMessage()
    message.header.stamp = time_message(stamp)
    message.header.frame_id = frame
    prior_only = soil.accepted == 0
    message.status = SoilMessage.STATUS_PRIOR_ONLY if prior_only else SoilMessage.STATUS_OK
    message.status_text = "; ".join(soil.status)
    message.k, message.n, message.m = float(soil.k), float(soil.n), float(soil.m)
    message.covariance = soil.covariance.ravel()
    message.reference_diameter = soil.reference_diameter
    message.reference_sinkage = soil.reference_sinkage
    modulus, deviation = soil.effective_modulus()
    message.effective_modulus = modulus
    message.effective_modulus_standard_deviation = deviation
    message.reference_pressure = soil.reference_pressure
    message.reference_pressure_standard_deviation = soil.reference_pressure_std
    message.k_identifiable = soil.identifiable.k
    message.n_identifiable = soil.identifiable.n
    message.m_identifiable = soil.identifiable.m
    message.effective_modulus_identifiable = soil.identifiable.effective_modulus
    message.reference_pressure_identifiable = soil.identifiable.reference_pressure
    message.measurements_accepted = soil.accepted
    message.measurements_rejected = rejected
    return message
