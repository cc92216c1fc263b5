"""A replay as plain values: replay.json, and what `--json` prints."""

from __future__ import annotations

from typing import Any

from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.replay.inputs import Input
from smallwheel_ros.replay.result import Replayed
from smallwheel_ros.tables import plain

SCHEMA = 1


def topic_of(inputs: tuple[Input, ...], stream: str) -> str:
    """Return the topic by which a stream came."""
    return next((item.topic for item in inputs if item.stream == stream), stream)


def document(result: Replayed, files: dict[str, str]) -> dict[str, Any]:
    """Return the summary of a replay; SI units, times in s since the bag's beginning.

    files: what was written, by what it is, as names in the replay's folder.
    """
    summary, soil = result.summary, result.onboard.soil
    received = result.onboard.received
    rolling = {w.name for w in result.settings.onboard.wheels if w.contact == ROLLING}
    spread = soil.covariance.diagonal() ** 0.5
    modulus, modulus_std = soil.effective_modulus()
    known = soil.identifiable

    def value(number: float, deviation: float, unit: str, determined: bool) -> dict[str, Any]:
        return {"value": number, "std": deviation, "unit": unit, "determined": determined}

    content = {
        "schema": SCHEMA,
        "state": result.state,
        "ended": result.ended,
        "bag": str(result.spec.bag),
        "config": str(result.spec.config),
        "remaps": dict(result.spec.remaps),
        "fingerprint": result.spec.fingerprint(),
        "start": result.start / SECOND,
        "duration": (result.end - result.start) / SECOND,
        "travel": summary.travel,
        "messages": {"read": result.messages_read, "in_bag": result.message_count},
        "estimates": sum(counts.results for counts in summary.wheels.values()),
        "statuses": dict(summary.statuses),
        "wheels": {
            name: {
                "rolls": name in rolling,
                "estimates": counts.results,
                "with_sinkage": counts.with_sinkage,
                "with_load": counts.with_load,
                "with_slip": counts.with_slip,
                "used_for_soil": counts.used,
                "sinkage_rms": counts.rms,
            }
            for name, counts in summary.wheels.items()
        },
        "soil": {
            "k": value(soil.k, spread[0], "Pa/m^(n+m)", known.k),
            "n": value(soil.n, spread[1], "1", known.n),
            "m": value(soil.m, spread[2], "1", known.m),
            "effective_modulus": value(modulus, modulus_std, "Pa/m^n", known.effective_modulus),
            "reference_pressure": value(
                soil.reference_pressure,
                soil.reference_pressure_std,
                "Pa",
                known.reference_pressure,
            ),
            "reference_sinkage": soil.reference_sinkage,
            "reference_diameter": soil.reference_diameter,
            "status": list(soil.status),
            "changes": summary.soil_changes,
            "missing_effect": None
            if soil.missing_effect is None
            else {
                "effect": soil.missing_effect.effect,
                "rivals": list(soil.missing_effect.rivals),
                "follows": soil.missing_effect.follows,
                "text": soil.missing_effect.message,
            },
        },
        "sensors": list(result.onboard.assessor.findings),
        "events": [
            {"time": e.time, "travel": e.travel, "kind": e.kind, "text": e.text}
            for e in summary.events
        ],
        "unlisted_events": summary.unlisted_events,
        "inputs": [
            {
                "stream": item.stream,
                "topic": item.topic,
                "type": item.type,
                "messages": received[item.stream],
            }
            for item in result.inputs
        ],
        "missing": [str(entry) for entry in result.missing],
        "not_used": [
            {
                "topic": topic_of(result.inputs, stream),
                "stream": stream,
                "reason": reason,
                "count": drop.count,
                "first_time": drop.first_time,
                "example": drop.example,
            }
            for (stream, reason), drop in summary.drops().items()
        ],
        "measurements": {
            "rows": len(result.segments),
            "stretches_not_steady": result.segments.unsteady,
            "results_without_load_slip_or_sinkage": result.segments.unusable,
            "results_at_changes_of_soil": result.segments.at_changes,
        },
        "not_copied": [f"{topic.name} ({topic.type})" for topic in result.left_out],
        "notes": result.notes,
        "topics_of_estimates": [f"{result.prefix}/mobility", f"{result.prefix}/soil"],
        "files": files,
    }
    found = plain(content)
    assert isinstance(found, dict)
    return found
