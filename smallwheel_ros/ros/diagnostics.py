# SPDX-License-Identifier: Apache-2.0
"""The entries of /diagnostics; docs/diagnostics.md says what each means and what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from smallwheel_ros.estimator.strength_estimate import StrengthEstimate
from smallwheel_ros.onboard.ground import vehicle_margin
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.ros.cost_publisher import CostPublisher

NO_ALARM = "none"
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_LEVELS = {Status.LOAD_MISSING: WARN, Status.SUNK_TO_AXLE: ERROR}


def status(
    name: str, level: bytes, message: str, values: Mapping[str, str] | None = None
) -> DiagnosticStatus:
    """Return one entry of the diagnostics."""
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        hardware_id="",
        values=[KeyValue(key=key, value=value) for key, value in (values or {}).items()],
    )


def entries(
    name: str, onboard: Onboard, newest: Iterable[Result], cost: CostPublisher
) -> list[DiagnosticStatus]:
    """Return the diagnostics of an active node of that name, but for its inputs."""
    results = list(newest)
    return [
        soil_status(f"{name}: soil", onboard),
        filter_status(f"{name}: filter", onboard),
        sensor_status(f"{name}: sensors", onboard),
        alarm_status(f"{name}: alarms", onboard, results),
        cost_status(f"{name}: cost", cost),
        vehicle_status(f"{name}: vehicle", results),
        *(wheel_status(f"{name}: wheel {result.wheel}", result) for result in results),
    ]


def soil_status(name: str, onboard: Onboard) -> DiagnosticStatus:
    """The soil in numbers, and of each what the measurements have determined, in words."""
    soil = onboard.soil
    pressure, deviation = soil.reference_pressure, soil.reference_pressure_std
    spread = soil.covariance.diagonal() ** 0.5
    values = {
        "reference pressure [Pa]": f"{pressure:.6g} +- {deviation:.2g}",
        "effective modulus [Pa/m^n]": "{:.6g} +- {:.2g}".format(*soil.effective_modulus()),
        "k [Pa/m^(n+m)]": f"{soil.k:.6g} +- {spread[0]:.2g}",
        "n": f"{soil.n:.4f} +- {spread[1]:.2g}",
        "m": f"{soil.m:.4f} +- {spread[2]:.2g}",
        **{f"verdict on {name.replace('_', ' ')}": said for name, said in soil.verdicts.items()},
        **strength_values(onboard.strength, onboard.lacking),
        "soil changes": str(soil.soil_changes),
        "travel [m]": f"{soil.distance:.2f}",
    }
    words = soil.status if soil.accepted else (*soil.status, *onboard.undeterminable)
    text = "; ".join(words) or "k, n and m are determined"
    return status(name, OK, text, values)


def strength_values(estimate: StrengthEstimate, lacking: Mapping[str, str]) -> dict[str, str]:
    """The strength as it was measured, and in words what is not determined of it.

    lacking: what sources that are not in use need, and what they would bring.
    """
    values = {
        "strength": "; ".join(estimate.status) or "determined",
        "strength measured by": ", ".join(sorted(estimate.sources)) or "nothing",
        **{f"strength by {source}": words for source, words in lacking.items()},
    }
    if estimate.steps:
        strength = estimate.strength
        for key, found in (
            ("cohesion [Pa]", strength.cohesion),
            ("friction angle [rad]", strength.friction_angle),
            ("shear displacement [m]", strength.shear_displacement),
        ):
            values[key] = f"{found.value:.4g} +- {found.standard_deviation:.2g}"
        for key, said in estimate.verdicts.items():
            values[f"verdict on {key.replace('_', ' ')}"] = said
    return values


def filter_status(name: str, onboard: Onboard) -> DiagnosticStatus:
    """Whether the filter's innovations are what it expects them to be."""
    soil, health = onboard.soil, onboard.health
    mean = health.mean_square
    values = {
        "accepted": str(soil.accepted),
        "rejected": str(onboard.problems.rejected),
        "outliers": str(soil.outliers),
        "outliers lately": f"{health.outlier_share:.1%} of {health.count}",
        "mean square of normalised innovations": "" if mean is None else f"{mean:.2f}",
    }
    if health.concern:
        return status(name, WARN, health.concern, values)
    text = "innovations are as expected" if health.count else "no measurement yet"
    return status(name, OK, text, values)


def sensor_status(name: str, onboard: Onboard) -> DiagnosticStatus:
    """What seems wrong with sensors, joints or wheels, and what to check."""
    findings = onboard.findings
    values = {f"finding {i + 1}": words for i, words in enumerate(findings)}
    text = "; ".join(findings) or "nothing seems wrong"
    return status(name, WARN if findings else OK, text, values)


def alarm_status(name: str, onboard: Onboard, newest: Iterable[Result]) -> DiagnosticStatus:
    """What somebody should act on now, and what that rests on."""
    digging = ", ".join(result.wheel for result in newest if result.digging_in)
    missing, stuck = onboard.estimator.missing_effect, onboard.stuck
    words = [f"{digging}: digging in (slip and sinkage up, speed down): stop"] if digging else []
    values = {
        "digging in": digging or "no",
        "risk of getting stuck": "unknown" if stuck.risk is None else f"{stuck.risk:.2f}",
        "missing effect": "none shows",
    }
    if stuck.warning:
        words.append(stuck.warning)
    if missing is not None:
        words.append(missing.message)
        values["missing effect"] = ", ".join((missing.effect, *missing.rivals))
        values["follows"] = missing.follows
        values["evidence"] = f"{missing.statistic:.0f}"
    level = ERROR if digging else WARN if words else OK
    return status(name, level, "; ".join(words) or NO_ALARM, values)


def cost_status(name: str, cost: CostPublisher) -> DiagnosticStatus:
    """What the cost map rests on."""
    places = cost.map.classes.places()
    values = {
        "grids published": str(cost.published),
        "grids of terrain classes received": str(cost.received),
        "places crossed by class": ", ".join(f"{k}: {n}" for k, n in places.items()) or "none",
    }
    if cost.map.problem:
        return status(name, WARN, cost.map.problem, values)
    text = "terrain classes and crossed ground" if cost.map.class_grid else "crossed ground"
    return status(name, OK, text if cost.published else "no grid yet: no pose has come", values)


def vehicle_status(name: str, newest: Iterable[Result]) -> DiagnosticStatus:
    """All wheels together, by their newest estimates."""
    results = list(newest)
    margin = vehicle_margin(results)
    if margin is None:
        return status(name, OK, "nothing known of any wheel yet")
    loads = [result.instant.load for result in results]
    energy = [r.forces.energy_per_metre for r in results if r.forces is not None]
    known = [e.value for e in energy if e is not None]
    slope = math.degrees(math.atan(margin.value))
    values = {
        "load [N]": f"{sum(load.value for load in loads if load is not None):.4g}",
        "mobility margin": _written(margin),
        "steepest slope [deg]": f"{slope:.1f}",
        "energy per metre [J/m]": f"{sum(known):.4g}" if len(known) == len(energy) else "unknown",
    }
    if margin.value <= 0:
        return status(
            name, ERROR, "the soil holds the vehicle on no slope, nor on the level", values
        )
    return status(name, OK, f"holds slopes up to {slope:.0f} degrees", values)


def wheel_status(name: str, result: Result) -> DiagnosticStatus:
    """How one wheel does."""
    values = {"status": result.status.name}
    quantities = {
        "load [N]": result.instant.load,
        "slip": result.instant.slip,
        "sinkage measured [m]": result.instant.sinkage,
        "sinkage predicted [m]": result.sinkage_predicted,
    }
    if result.forces is not None:
        quantities["drawbar pull [N]"] = result.forces.drawbar_pull
        quantities["mobility margin"] = result.forces.margin
    values |= {key: _written(value) for key, value in quantities.items() if value is not None}
    level = ERROR if result.digging_in else _LEVELS.get(result.status, OK)
    return status(name, level, result.status_text or "OK", values)


def _written(quantity: Quantity) -> str:
    return f"{quantity.value:.4g} +- {quantity.standard_deviation:.2g}"
