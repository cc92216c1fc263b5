# SPDX-License-Identifier: Apache-2.0
"""The entries of /diagnostics; docs/node.md explains each and what to do.

Their names here lack the node's name, which is added when they are published.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from smallwheel_ros.drive.messages import status_texts
from smallwheel_ros.drive.statements import statements
from smallwheel_ros.pipeline.mobility.status import Status
from smallwheel_ros.pipeline.mobility.vehicle import vehicle_margin
from smallwheel_ros.pipeline.pipeline import Pipeline
from smallwheel_ros.pipeline.strength.words import StrengthEstimate
from smallwheel_ros.pipeline.tables import Estimates
from smallwheel_ros.pipeline.warning.warning_level import WarningLevel
from smallwheel_ros.ros.cost_publisher import CostPublisher

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_LEVELS = {
    Status.LOAD_MISSING: WARN,
    Status.NOTHING_PREDICTED: WARN,
    Status.SUNK_TO_AXLE: ERROR,
}


def status(
    name: str, level: bytes, message: str, values: Mapping[str, str] | None = None
) -> DiagnosticStatus:
    """Make one entry of the diagnostics.

    Parameters
    ----------
    name
        Name of the entry, without the node's name.
    level
        OK, WARN or ERROR.
    message
        The state in words.
    values
        Details in words, by key; None: none.
    """
    return DiagnosticStatus(
        name=name,
        level=level,
        message=message,
        hardware_id="",
        values=[KeyValue(key=key, value=value) for key, value in (values or {}).items()],
    )


def entries(pipeline: Pipeline, newest: Estimates, cost: CostPublisher) -> list[DiagnosticStatus]:
    """Make the diagnostics of an active node, except the entry of its inputs.

    Parameters
    ----------
    pipeline
        The node's pipeline.
    newest
        The newest estimate of each wheel.
    cost
        Publisher of the cost map.

    Returns
    -------
    list of DiagnosticStatus
        The entries soil, filter, sensors, alarms, cost and vehicle, and one for each wheel in `newest`.
    """
    said = statements(pipeline, newest)

    def of(entry: str, plain: str, values: Mapping[str, str]) -> DiagnosticStatus:
        """Make an entry of all statements that belong to it; `plain` is its text where there are none."""
        mine = [statement for statement in said if statement.entry == entry]
        level = ERROR if any(s.is_error for s in mine) else WARN if mine else OK
        text = "; ".join(statement.text for statement in mine) or plain
        return status(entry, level, text, values)

    of_sensors = [statement.text for statement in said if statement.entry == "sensors"]
    findings = {f"finding {i}": words for i, words in enumerate(of_sensors, 1)}
    return [
        _soil(pipeline),
        of("filter", *_filter(pipeline)),
        of("sensors", "nothing seems wrong", findings),
        of("alarms", "none", _alarms(pipeline, newest)),
        _cost(cost),
        of("vehicle", *_vehicle(pipeline, newest)),
        *_wheels(pipeline, newest),
    ]


def _soil(pipeline: Pipeline) -> DiagnosticStatus:
    """Entry of the soil: numbers, and in words what the measurements have determined."""
    soil = pipeline.soil
    pressure, deviation = soil.reference_pressure, soil.reference_pressure_std
    spread = soil.covariance.diagonal() ** 0.5
    values = {
        "reference pressure [Pa]": f"{pressure:.6g} +- {deviation:.2g}",
        "effective modulus [Pa/m^n]": "{:.6g} +- {:.2g}".format(*soil.effective_modulus()),
        "k [Pa/m^(n+m)]": f"{soil.k:.6g} +- {spread[0]:.2g}",
        "n": f"{soil.n:.4f} +- {spread[1]:.2g}",
        "m": f"{soil.m:.4f} +- {spread[2]:.2g}",
        **{f"verdict on {name.replace('_', ' ')}": said for name, said in soil.verdicts.items()},
        **strength_values(pipeline.strength, pipeline.lacking),
    }
    values["soil changes"] = str(soil.soil_changes)
    values["travel [m]"] = f"{soil.distance:.2f}"
    words = soil.status if soil.accepted else (*soil.status, *pipeline.undeterminable)
    text = "; ".join((*words, *soil.remarks)) or "k, n and m are determined"
    return status("soil", OK, text, values)


def strength_values(estimate: StrengthEstimate, lacking: Mapping[str, str]) -> dict[str, str]:
    """Describe the measured strength, and what of it is not determined.

    Parameters
    ----------
    estimate
        The strength, SI units and radians.
    lacking
        What each source of strength that is not in use needs, and what it would add, in words, by source.

    Returns
    -------
    dict
        Values of the soil's entry in the diagnostics by key: numbers with their standard deviations (Pa,
        rad, m; only once something was measured), and words.
    """
    values = {
        "strength": "; ".join(estimate.status) or "determined",
        "strength measured by": ", ".join(sorted(estimate.sources)) or "nothing",
        **{f"strength by {source}": words for source, words in lacking.items()},
    }
    if estimate.steps:
        for key, found in (
            ("cohesion [Pa]", estimate.cohesion),
            ("friction angle [rad]", estimate.friction_angle),
            ("shear displacement [m]", estimate.shear_displacement),
        ):
            values[key] = _written(found.value, found.standard_deviation)
        for key, said in estimate.verdicts.items():
            values[f"verdict on {key.replace('_', ' ')}"] = said
    return values


def _filter(pipeline: Pipeline) -> tuple[str, dict[str, str]]:
    """Text and values of the entry of the soil's filter: whether its innovations are as it expects."""
    health = pipeline.health
    mean = health.mean_square
    values = {
        "accepted": str(pipeline.accepted),
        "rejected": str(pipeline.rejected),
        "outliers": str(pipeline.outliers),
        "outliers lately": f"{health.outlier_share:.1%} of {health.count}",
        "mean square of normalised innovations": "" if mean is None else f"{mean:.2f}",
    }
    return "innovations are as expected" if health.count else "no measurement yet", values


def _alarms(pipeline: Pipeline, newest: Estimates) -> dict[str, str]:
    """Values of the entry of alarms: what these are based on."""
    missing, risk = pipeline.missing_effect, pipeline.risk
    wheels = pipeline.settings.wheels
    digging = [wheels[number].name for number in newest.wheel[newest.digging_in].tolist()]
    values = {
        WarningLevel.GETS_STUCK.short: ", ".join(digging) or "no",
        "risk of getting stuck": "unknown" if risk is None else f"{risk:.2f}",
        "missing effect": "none shows",
    }
    if missing is not None:
        values["missing effect"] = ", ".join((missing.effect, *missing.rivals))
        values["follows"] = missing.follows
        values["evidence"] = f"{missing.statistic:.0f}"
    return values


def _cost(cost: CostPublisher) -> DiagnosticStatus:
    """Entry of the cost map: what it is based on."""
    places = cost.map.ahead.classes.places()
    values = {
        "grids published": str(cost.published),
        "grids of terrain classes received": str(cost.ahead.grids),
        "maps of elevations received": str(cost.ahead.elevations),
        "places crossed by class": ", ".join(f"{k}: {n}" for k, n in places.items()) or "none",
    }
    if cost.map.problem:
        return status("cost", WARN, cost.map.problem, values)
    ahead = cost.map.ahead
    given = {"terrain classes": ahead.class_grid, "slopes ahead": ahead.elevation}
    text = " and ".join([*(what for what, one in given.items() if one), "crossed ground"])
    return status("cost", OK, text if cost.published else "no grid yet: no pose has come", values)


def _vehicle(pipeline: Pipeline, newest: Estimates) -> tuple[str, dict[str, str]]:
    """Text and values of the entry of the vehicle, by the newest estimates of its wheels."""
    margin = vehicle_margin(newest)
    if margin is None:
        return "nothing known of any wheel yet", {}
    energy = float(newest.energy.sum())  # NaN where one is
    slope = math.degrees(math.atan(margin.value))
    values = {
        "load [N]": f"{np.nansum(newest.load):.4g}",
        "mobility margin": _written(margin.value, margin.standard_deviation),
        "steepest slope [deg]": f"{slope:.1f}",
        "energy per metre [J/m]": f"{energy:.4g}" if math.isfinite(energy) else "unknown",
    }
    if not pipeline.accepted:
        return "nothing measured yet: what it holds is as configured, not as this soil is", values
    return f"holds slopes up to {slope:.0f} degrees", values


def _wheels(pipeline: Pipeline, newest: Estimates) -> Iterator[DiagnosticStatus]:
    """One entry for each wheel, by its newest estimate."""
    columns = {
        "load [N]": (newest.load, newest.load_std),
        "slip": (newest.slip, newest.slip_std),
        "sinkage measured [m]": (newest.sinkage_measured, newest.sinkage_measured_std),
        "sinkage predicted [m]": (newest.sinkage, newest.sinkage_std),
        "drawbar pull [N]": (newest.drawbar_pull, newest.drawbar_pull_std),
        "mobility margin": (newest.margin, newest.margin_std),
    }
    for i, text in enumerate(status_texts(newest, pipeline)):
        state = Status(int(newest.status[i]))
        values = {"status": state.name}
        for key, (column, deviation) in columns.items():
            if not math.isnan(column[i]):
                values[key] = _written(column[i], deviation[i])
        level = ERROR if newest.digging_in[i] else _LEVELS.get(state, OK)
        name = pipeline.settings.wheels[int(newest.wheel[i])].name
        yield status(f"wheel {name}", level, text or "OK", values)


def _written(value: float, deviation: float) -> str:
    return f"{value:.4g} +- {deviation:.2g}"
