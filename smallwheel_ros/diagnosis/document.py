"""The diagnosis as plain values, by contract: what is written as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from smallwheel_ros.diagnosis.next_measurement import Proposal
from smallwheel_ros.diagnosis.ranking import Row
from smallwheel_ros.diagnosis.regions import Region

SCHEMA = 1
_DIGITS = 6


def plain(value: Any) -> Any:
    """Plain values with six digits; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, bool) or value is None or isinstance(value, (str, int)):
        return value
    number = float(value)
    return float(f"{number:.{_DIGITS}g}") if math.isfinite(number) else None


def ranking_entry(row: Row) -> dict[str, Any]:
    """One row of the ranking."""
    entry: dict[str, Any] = {"effect": row.effect, "status": row.status, "reason": row.reason}
    if row.left is not None:
        entry["testability"] = {
            "left_after_base": row.left,
            "smallest_visible": row.visible,
            "unit": row.visible_unit,
        }
    if row.status == "not_testable":
        return entry
    return entry | {
        "p_value": row.p,
        "held_out_rmse": row.held_out or {},
        "reduction": row.reduction,
        "form": row.form,
        "forms_not_told_apart": list(row.forms_alike),
        "parameters": {
            p.name: {
                "value": p.value,
                "std": p.std,
                "unit": p.unit,
                "published_range": None if p.published is None else list(p.published),
                "plausible": p.plausible,
            }
            for p in row.parameters
        },
        "confounded_with": [
            {"effect": name, "similarity": similarity} for name, similarity in row.confounded_with
        ],
    }


def region_entry(region: Region) -> dict[str, Any]:
    """One region in which the model fails."""
    return {
        "region": region.region,
        "rows": region.rows,
        "channel": region.channel,
        "bias": region.bias,
        "rmse": region.rmse,
        "rmse_elsewhere": region.rmse_elsewhere,
        "p_value": region.p,
    }


def proposal_entry(proposal: Proposal) -> dict[str, Any]:
    """One measurement to make next."""
    return {
        "settings": proposal.settings,
        "separates": list(proposal.separates),
        "runs": proposal.runs,
        "expected_power": proposal.power,
        "text": proposal.text,
    }


def insufficient(
    reason: str,
    channels: Mapping[str, Mapping[str, Any]],
    held_out: Mapping[str, float],
    rows: Sequence[Row],
    notes: Sequence[str],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """The document where nothing can be said."""
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": "insufficient_data",
        "reason": reason,
        "missing_effects": [],
        "candidates": [],
        "channels": channels,
        "lack_of_fit": {"p_value": None},
        "where_it_fails": [],
        "ranking": [ranking_entry(row) for row in rows],
        "steps": [{"added": None, "held_out_rmse": dict(held_out)}],
        "next_measurements": [],
        "notes": list(notes),
        "warnings": list(warnings),
    }
    found: dict[str, Any] = plain(document)
    return found
