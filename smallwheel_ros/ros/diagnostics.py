# SPDX-License-Identifier: Apache-2.0
"""The entries of /diagnostics; docs/diagnostics.md says what each means and what to do.

Their names are without that of the node, which is put before them when they are published.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from smallwheel_ros.estimator.traction import StrengthEstimate
from smallwheel_ros.onboard.ground import vehicle_margin
from smallwheel_ros.onboard.onboard import Onboard
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.statements import statements
from smallwheel_ros.physics.wheel import Quantity
from smallwheel_ros.ros.outputs import CostPublisher

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
    onboard: Onboard, newest: Iterable[Result], cost: CostPublisher
) -> list[DiagnosticStatus]:
    """Return the diagnostics of an active node, but for its inputs."""
    results = list(newest)
    said = statements(onboard, results)

    def of(entry: str, plain: str, values: Mapping[str, str]) -> DiagnosticStatus:
        """An entry with all that is said of it; plain: where nothing is."""
        mine = [statement for statement in said if statement.entry == entry]
        level = ERROR if any(s.is_error for s in mine) else WARN if mine else OK
        text = "; ".join(statement.text for statement in mine) or plain
        return status(entry, level, text, values)

    of_sensors = [statement.text for statement in said if statement.entry == "sensors"]
    findings = {f"finding {i}": words for i, words in enumerate(of_sensors, 1)}
    return [
        _soil(onboard),
        of("filter", *_filter(onboard)),
        of("sensors", "nothing seems wrong", findings),
        of("alarms", "none", _alarms(onboard, results)),
        _cost(cost),
        of("vehicle", *_vehicle(onboard, results)),
        *map(_wheel, results),
    ]


def _soil(onboard: Onboard) -> DiagnosticStatus:
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
    }
    # What a slip test would tell of the strength that driving on does not.
    if onboard.slip_tests:
        values["slip test"] = "; ".join(test.text for test in onboard.slip_tests)
    values["soil changes"] = str(soil.soil_changes)
    values["travel [m]"] = f"{soil.distance:.2f}"
    words = soil.status if soil.accepted else (*soil.status, *onboard.undeterminable)
    text = "; ".join(words) or "k, n and m are determined"
    return status("soil", OK, text, values)


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
            values[key] = _written(found)
        for key, said in estimate.verdicts.items():
            values[f"verdict on {key.replace('_', ' ')}"] = said
    return values


def _filter(onboard: Onboard) -> tuple[str, dict[str, str]]:
    """Text and values of whether the filter's innovations are what it expects them to be."""
    soil, health = onboard.soil, onboard.health
    mean = health.mean_square
    values = {
        "accepted": str(soil.accepted),
        "rejected": str(onboard.rejected),
        "outliers": str(soil.outliers),
        "outliers lately": f"{health.outlier_share:.1%} of {health.count}",
        "mean square of normalised innovations": "" if mean is None else f"{mean:.2f}",
    }
    return "innovations are as expected" if health.count else "no measurement yet", values


def _alarms(onboard: Onboard, newest: Iterable[Result]) -> dict[str, str]:
    """What the alarms rest on."""
    missing, risk = onboard.estimator.missing_effect, onboard.stuck.risk
    values = {
        "digging in": ", ".join(result.wheel for result in newest if result.digging_in) or "no",
        "risk of getting stuck": "unknown" if risk is None else f"{risk:.2f}",
        "missing effect": "none shows",
    }
    if missing is not None:
        values["missing effect"] = ", ".join((missing.effect, *missing.rivals))
        values["follows"] = missing.follows
        values["evidence"] = f"{missing.statistic:.0f}"
    return values


def _cost(cost: CostPublisher) -> DiagnosticStatus:
    """What the cost map rests on."""
    places = cost.map.classes.places()
    values = {
        "grids published": str(cost.published),
        "grids of terrain classes received": str(cost.received),
        "places crossed by class": ", ".join(f"{k}: {n}" for k, n in places.items()) or "none",
    }
    if cost.map.problem:
        return status("cost", WARN, cost.map.problem, values)
    text = "terrain classes and crossed ground" if cost.map.class_grid else "crossed ground"
    return status("cost", OK, text if cost.published else "no grid yet: no pose has come", values)


def _vehicle(onboard: Onboard, results: list[Result]) -> tuple[str, dict[str, str]]:
    """Text and values of all wheels together, by their newest estimates."""
    margin = vehicle_margin(results)
    if margin is None:
        return "nothing known of any wheel yet", {}
    loads = [result.reading.load for result in results]
    energy = [r.forces.energy_per_metre for r in results if r.forces is not None]
    known = [e.value for e in energy if e is not None]
    slope = math.degrees(math.atan(margin.value))
    values = {
        "load [N]": f"{sum(load.value for load in loads if load is not None):.4g}",
        "mobility margin": _written(margin),
        "steepest slope [deg]": f"{slope:.1f}",
        "energy per metre [J/m]": f"{sum(known):.4g}" if len(known) == len(energy) else "unknown",
    }
    if not onboard.soil.accepted:
        return "nothing measured yet: what it holds is as configured, not as this soil is", values
    return f"holds slopes up to {slope:.0f} degrees", values


def _wheel(result: Result) -> DiagnosticStatus:
    """How one wheel does."""
    values = {"status": result.status.name}
    quantities = {
        "load [N]": result.reading.load,
        "slip": result.reading.slip,
        "sinkage measured [m]": result.reading.sinkage,
        "sinkage predicted [m]": result.sinkage_predicted,
    }
    if result.forces is not None:
        quantities["drawbar pull [N]"] = result.forces.drawbar_pull
        quantities["mobility margin"] = result.forces.margin
    values |= {key: _written(value) for key, value in quantities.items() if value is not None}
    level = ERROR if result.digging_in else _LEVELS.get(result.status, OK)
    return status(f"wheel {result.wheel}", level, result.status_text or "OK", values)


def _written(quantity: Quantity) -> str:
    return f"{quantity.value:.4g} +- {quantity.standard_deviation:.2g}"
