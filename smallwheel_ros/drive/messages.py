# SPDX-License-Identifier: Apache-2.0
"""Estimates as fields of messages, and in words; node, replay and cost map use the same."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.pipeline.mobility.status import Condition, SoilStatus
from smallwheel_ros.pipeline.mobility.vehicle import VehicleEstimates
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.margin import GroundMargin, scatter_ahead
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel

if TYPE_CHECKING:
    from smallwheel_ros.pipeline.pipeline import Pipeline

# Flags of MobilityEstimate.msg, and the quantities that each is about, which are 0 where it is false.
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
}
# A wheel that digs in has the words of the vehicle's level.
_GETS_STUCK = (
    f"{WarningLevel.GETS_STUCK.short}: {WarningLevel.GETS_STUCK.meaning.removeprefix('stop: ')}"
)
# Columns of `Estimates` that have another name in the message.
_COLUMNS = {
    "sinkage_predicted": "sinkage",
    "mobility_margin": "margin",
    "energy_per_metre": "energy",
}
_WITHOUT_DEVIATION = ("probability_drawbar_pull_positive",)


def mobility_columns(estimates: Estimates, pipeline: Pipeline) -> dict[str, Any]:
    """Make a column for each field of MobilityEstimate.msg except its header; row i of them is message i.

    Parameters
    ----------
    estimates
        Estimates of one turn of the pipeline (`Pipeline`), a row each.
    pipeline
        Pipeline that computed them, for the names of the wheels and the status of its soil.

    Returns
    -------
    dict
        By name of the field, an array or a list of length rows, SI units. An unknown number is 0, and its
        flag, if it has one, false; an unknown or infinite standard deviation is 0.
    """
    names = [wheel.name for wheel in pipeline.settings.wheels]
    found: dict[str, Any] = {
        "status": estimates.status,
        "status_text": status_texts(estimates, pipeline),
        "wheel": [names[number] for number in estimates.wheel.tolist()],
        "slip_angle": np.nan_to_num(estimates.slip_angle),
        "steering_angle": np.nan_to_num(estimates.steering),
    }
    for flag, quantities in VALID.items():
        columns = {name: getattr(estimates, _COLUMNS.get(name, name)) for name in quantities}
        known = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
        found[flag] = known
        for name, values in columns.items():
            found[name] = np.where(known, values, 0.0)
            if name not in _WITHOUT_DEVIATION:
                deviation = getattr(estimates, f"{_COLUMNS.get(name, name)}_std")
                found[f"{name}_standard_deviation"] = np.where(
                    known, np.nan_to_num(deviation, posinf=0.0), 0.0
                )
    return found


def status_texts(estimates: Estimates, pipeline: Pipeline) -> list[str]:
    """Describe all conditions that apply to each row, the most serious first.

    Parameters
    ----------
    estimates
        Estimates of one turn of the pipeline (`Pipeline`), a row each.
    pipeline
        Pipeline that computed them.

    Returns
    -------
    list of str
        One for each row: clauses joined by semicolons, empty if no condition applies.
    """
    texts: dict[tuple[int, int], str] = {}
    found = []
    for i, key in enumerate(
        zip(estimates.wheel.tolist(), estimates.conditions.tolist(), strict=True)
    ):
        conditions = Condition(key[1])
        if conditions & Condition.DOES_NOT_FIT:  # with its numbers
            found.append(_in_words(conditions, key[0], pipeline, estimates, i))
            continue
        if key not in texts:
            texts[key] = _in_words(conditions, key[0], pipeline, estimates, i)
        found.append(texts[key])
    return found


def _in_words(
    conditions: Condition, wheel: int, pipeline: Pipeline, estimates: Estimates, row: int
) -> str:
    settings = pipeline.settings
    words = []
    if Condition.DIGS in conditions:
        words.append(_GETS_STUCK)
    if Condition.SUNK_TO_AXLE in conditions:
        words.append("the soil does not carry this load: sunk to axle")
    if Condition.LOAD_MISSING in conditions:
        words.append("no load near this reading: nothing is predicted")
    if Condition.NOTHING_PREDICTED in conditions:
        words.append("nothing is predicted: the model has no sinkage for this wheel")
    if Condition.DOES_NOT_FIT in conditions:
        shown, expected = 1e3 * estimates.sinkage_measured[row], 1e3 * estimates.sinkage[row]
        spread = 1e3 * np.hypot(
            estimates.sinkage_std[row], np.nan_to_num(estimates.sinkage_measured_std[row])
        )
        words.append(
            f"measured sinkage does not fit: {shown:.1f} mm, expected {expected:.1f} +- {spread:.1f} mm"
        )
    if Condition.NOT_USED in conditions:
        words.append("measured sinkage not used: its sensor is doubted (see the sensors)")
    if Condition.SLIP_UNKNOWN in conditions:
        why = "no odometry or wheel speed near this reading"
        if pipeline.made_of_wheels:
            why = "odometry shows none: it always agrees with the wheels"
        elif settings.velocity == "none":
            why = "odometry comes from the wheels, and there is no velocity_topic"
        elif Condition.ANGLE_UNKNOWN in conditions:
            why = "no steering angle of this wheel near this reading, or it is doubted"
        elif Condition.STANDS in conditions:
            why = "the wheel stands"
        elif doubt := pipeline.doubt_of_slip(settings.wheels[wheel].name):
            why = doubt
        read = ", ".join(e.id for e in settings.effects if {"slip", "speed"} & set(e.needs))
        also = f", and no sinkage: {read} of the model reads it" if read else ""
        words.append(f"slip unknown ({why}): no thrust, no drawbar pull{also}")
    if Condition.LAW_UNKNOWN in conditions:
        words.append(
            "no sinkage is measured, and the soil is not named: sinkage and resistance unknown"
        )
    elif Condition.PRIOR_ONLY in conditions:
        words.append(f"soil not measured yet: {settings.prior.soil.name} as configured")
    if Condition.STRENGTH_OF_PRIOR in conditions:
        words.append(
            f"thrust, pull and energy by the strength of {strength_of_prior(settings)}, not measured"
        )
    if Condition.MARGIN_OF_PRIOR in conditions:
        words.append("margin rests on a prior: this drive has shown little of its own yet")
    if Condition.LOAD_STATIC in conditions:
        load = settings.static_loads[settings.wheels[wheel].name].value
        words.append(f"load not measured: {load:.3g} N as configured")
    return "; ".join(words)


def strength_of_prior(settings: OnboardSettings) -> str:
    """Name the soil whose strength is assumed while none has been measured."""
    return settings.prior.soil.name if settings.soil_told else "any sand"


def soil_fields(soil: SoilEstimate, rejected: int) -> dict[str, Any]:
    """Make the fields of SoilEstimate.msg except its header.

    Parameters
    ----------
    soil
        Estimate of the soil.
    rejected
        Number of measurements that were not used, for any reason.

    Returns
    -------
    dict
        Values by name of the field, SI units; the covariance has shape (9,), as in the message.
    """
    modulus, deviation = soil.effective_modulus()
    known = soil.identifiable
    return {
        "status": int(SoilStatus.PRIOR_ONLY if soil.accepted == 0 else SoilStatus.OK),
        "status_text": "; ".join((*soil.status, *soil.remarks)),
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


# Flags of VehicleMobility.msg, and the quantities that each is about, which are 0 where it is false.
VEHICLE_VALID = {
    "speed_valid": ("speed", "course"),
    "slip_valid": ("slip", "slip_left", "slip_right"),
    "margin_valid": ("margin", "steepest_slope"),
    "slope_valid": ("slope_ahead", "slope_across"),
    "risk_valid": ("demand", "risk_of_getting_stuck"),
    "energy_valid": ("energy_per_metre",),
}
_VEHICLE_SPREAD = ("speed", "slip", "slip_left", "slip_right", "margin", "steepest_slope")


def vehicle_columns(rows: VehicleEstimates) -> dict[str, Any]:
    """Make a column for each field of VehicleMobility.msg except its header; row i of them is message i.

    Returns the columns by name of the field, each of length rows, in SI units. An unknown number is 0, and
    its flag, if it has one, false.
    """
    slope = np.arctan(rows.margin), rows.margin_std / (1.0 + rows.margin**2)
    values = {
        **vars(rows),
        "steepest_slope": slope[0],
        "risk_of_getting_stuck": rows.risk,
        "energy_per_metre": rows.energy,
    }
    spreads = {name: getattr(rows, f"{name}_std", slope[1]) for name in _VEHICLE_SPREAD}
    texts = [
        WarningLevel(level).said(slip)
        for level, slip in zip(rows.level.tolist(), rows.slip_warned.tolist(), strict=True)
    ]
    found: dict[str, Any] = {"level": rows.level, "text": texts}
    for flag, names in VEHICLE_VALID.items():
        known = np.isfinite(np.stack([values[name] for name in names])).all(axis=0)
        found[flag] = known
        for name in names:
            found[name] = np.where(known, values[name], 0.0)
            if name in spreads:
                spread = np.nan_to_num(spreads[name], posinf=0.0)
                found[f"{name}_standard_deviation"] = np.where(known, spread, 0.0)
    known = found["margin_valid"]
    found["margin_source"] = np.where(known, rows.margin_source, 0)
    found["margin_information"] = np.where(known, np.nan_to_num(rows.information), 0.0)
    return found | {"soil": rows.soil, "at_border": rows.at_border}


def margin_before_driving(settings: OnboardSettings) -> Quantity | None:
    """Largest pull over load (1) to expect of any ground before driving; None without a rolling wheel.

    It is the median margin of any ground plus the gain beyond the reference slip. Its standard deviation is
    that of the margin's lower half, together with the scatter between places of one field.
    """
    if not any(wheel.contact == ROLLING for wheel in settings.wheels):
        return None
    median, deviation, beyond = GroundMargin(settings.reference_slip).ahead()
    return Quantity(median + beyond, math.hypot(deviation, float(scatter_ahead(median))))
