# SPDX-License-Identifier: Apache-2.0
"""A replay in words, for the terminal."""

from __future__ import annotations

from typing import Any

from smallwheel_ros.tables import text_table

_MOST_LINES = 12
_MOST_ALARMS = 2


def _share(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.0f} %" if whole else "-"


def summary_text(summary: dict[str, Any]) -> str:
    """Say what a replay found, from its replay.json."""
    lines = [
        f"{summary['bag']}: {summary['duration']:.1f} s, {summary['travel']:.1f} m,"
        f" {summary['messages']['read']} messages, {summary['estimates']} estimates"
    ]
    lines += [f"missing: {text}" for text in summary["missing"]]
    lines += [f"note: {text}" for text in summary["notes"]]
    alarms = [event for event in summary["events"] if event["kind"] == "missing_effect"]
    lines += [f"after {event['travel']:.0f} m: {event['text']}" for event in alarms[:_MOST_ALARMS]]
    lines += ["", wheels_text(summary), "", *soil_lines(summary)]
    if summary["sensors"]:
        lines += ["", "Sensors", *(f"  {text}" for text in summary["sensors"])]
    events = summary["events"]
    if events:
        lines += ["", "What happened"]
        lines += [
            f"  {e['time']:8.1f} s {e['travel']:7.1f} m  {e['text']}" for e in events[:_MOST_LINES]
        ]
        if len(events) > _MOST_LINES:
            lines.append(f"  and {len(events) - _MOST_LINES} more, see the report")
    drops = summary["not_used"]
    if drops:
        lines += ["", "Not used"]
        for drop in drops[:_MOST_LINES]:
            first = f"; first: {drop['example']}" if drop["example"] else ""
            lines.append(f"  {drop['count']:6d} {drop['topic']} {drop['reason']}{first}")
        if len(drops) > _MOST_LINES:
            lines.append(f"  and {len(drops) - _MOST_LINES} more, see the report")
    if summary["measurements"]["rows"]:
        lines += ["", f"{summary['measurements']['rows']} steady stretches as measurements"]
    if summary["not_copied"]:
        lines.append(f"not in the new bag, of unknown type: {', '.join(summary['not_copied'])}")
    return "\n".join(lines)


def wheels_text(summary: dict[str, Any]) -> str:
    """The match rates of each wheel."""
    rows = []
    for name, wheel in summary["wheels"].items():
        count, rms = wheel["estimates"], wheel["sinkage_rms"]
        rows.append(
            [
                name,
                str(count),
                _share(wheel["with_load"], count),
                _share(wheel["with_slip"], count) if wheel["rolls"] else "-",
                _share(wheel["used_for_soil"], count),
                "-" if rms is None else f"{1e3 * rms:.2f}",
            ]
        )
    header = ["wheel", "estimates", "with load", "with slip", "used", "sinkage error [mm rms]"]
    return text_table(header, rows)


def soil_lines(summary: dict[str, Any]) -> list[str]:
    """The soil at the end, and what is not determined."""
    soil = summary["soil"]
    lines = ["Soil at the end, under the law p = k z^n D^m"]
    for name in ("reference_pressure", "effective_modulus", "k", "n", "m"):
        found = soil[name]
        unit = "" if found["unit"] == "1" else f" {found['unit']}"
        doubt = "" if found["determined"] else "   not determined by this drive"
        words = name.replace("_", " ")
        lines.append(f"  {words:<19}{found['value']:<12.5g} +- {found['std']:.2g}{unit}{doubt}")
    lines += [f"  {text}" for text in soil["status"]]
    return lines
