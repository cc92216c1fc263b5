# SPDX-License-Identifier: Apache-2.0
"""The demo in words: what the node found, against what was true."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from smallwheel_ros.costmap.grid import UNKNOWN
from smallwheel_ros.demo.demo import Clip, DemoResult

_BAND = 1.96  # standard deviations: 95 %
_DETERMINED = ("k", "n", "m")


def summary(result: DemoResult) -> str:
    """Put the result into a few lines for people."""
    full, answer = result.full, result.answer
    found = full.recording
    lines = _wheels(full.mobility)
    lines += ["", *_soil(full, answer), "", *_pull(result), "", *_stuck(full, answer)]
    lines += [_cost(full), "", *_bare(result)]
    lines += [
        "",
        f"{found.published} messages played, {len(full.mobility)} estimates,"
        f" {found.unanswered} sinkages without answer",
        f"from a sinkage to its estimate: median {np.median(found.latencies) * 1e3:.0f} ms, while"
        " it waits for the other wheels' sinkages; 99 % within"
        f" {np.percentile(found.latencies, 99) * 1e3:.0f} ms",
        f"took {result.seconds:.0f} s",
        "",
        *(f"picture  {path}" for path in result.pictures),
        *(f"table    {path}" for path in result.tables),
    ]
    return "\n".join(lines)


def _wheels(table: pd.DataFrame) -> list[str]:
    lines = ["wheel         estimates  not used  sinkage measured - predicted   drawbar pull > 0"]
    for wheel, rows in table.groupby("wheel"):
        used = rows[rows["status"] != 3]
        error = (used["sinkage_measured"] - used["sinkage_predicted"]).dropna() * 1e3
        share = (rows["probability_drawbar_pull_positive"].dropna() > 0.5).mean()
        lines.append(
            f"{wheel:<12} {len(rows):>10} {len(rows) - len(used):>9}"
            f" {np.sqrt(np.mean(error**2)):>20.2f} mm rms {share:>17.0%}"
        )
    return lines


def _soil(clip: Clip, answer: dict[str, Any]) -> list[str]:
    last = clip.soil.iloc[-1]
    place = np.interp(last["time"], answer["rover"]["time"], answer["rover"]["way"])
    true = [s for s in answer["stretches"] if s["start"] <= place][-1]
    lines = ["soil at the end    estimated                  true"]
    for name, unit in (("k", "Pa/m^(n+m)"), ("n", ""), ("m", "")):
        deviation = last[f"{name}_standard_deviation"]
        known = "determined" if last[f"{name}_identifiable"] else "not determined"
        lines.append(
            f"{name:<12} {last[name]:>15.5g} +- {deviation:<9.2g} {true[name]:>9.5g} {unit:<10} {known}"
        )
    return lines


def pulls(table: pd.DataFrame, answer: dict[str, Any]) -> pd.DataFrame:
    """Stated and true drawbar pull (N) of every estimate of a moving wheel that has one."""
    parts = []
    for wheel, rows in table.groupby("wheel"):
        truth = answer["wheels"][wheel]
        moving = (
            np.interp(rows["time"], truth["time"], np.array(truth["moving"], dtype=float)) > 0.5
        )
        rows = rows[moving & rows["drawbar_pull"].notna()]
        parts.append(
            pd.DataFrame(
                {
                    "time": rows["time"],
                    "stated": rows["drawbar_pull"],
                    "deviation": rows["drawbar_pull_standard_deviation"],
                    "true": np.interp(rows["time"], truth["time"], truth["drawbar_pull"]),
                }
            )
        )
    return pd.concat(parts)


def _pull_line(name: str, found: pd.DataFrame) -> str:
    off = found["stated"] - found["true"]
    inside = (off.abs() < _BAND * found["deviation"]).mean()
    return (
        f"{name:<28} {np.sqrt((off**2).mean()):>8.2f} N {found['deviation'].mean():>12.2f} N"
        f" {inside:>14.0%} of {len(found)}"
    )


def _pull(result: DemoResult) -> list[str]:
    end = result.bare.mobility["time"].max()
    full = pulls(result.full.mobility, result.answer)
    bare = pulls(result.bare.mobility, result.answer)
    return [
        "drawbar pull                 error, rms   stated, 1 sd   true one in its 95 % band",
        _pull_line("with sinkage, imu and mass", full),
        _pull_line(f"  of that, first {end:.0f} s", full[full["time"] <= end]),
        _pull_line("with load and slip only", bare),
    ]


def _stuck(clip: Clip, answer: dict[str, Any]) -> list[str]:
    time, way = answer["rover"]["time"], answer["rover"]["way"]
    epoch = answer["epoch_ns"]
    warned = [((stamp - epoch) / 1e9, text) for stamp, text in clip.recording.warnings]
    lines = []
    stuck = answer["stuck"]
    if stuck is not None:
        before = _last_episode([t for t, _ in warned if t < stuck["time"]])
        if before is None:
            lines.append(f"stuck at {stuck['way']:.1f} m, without a warning before")
        else:
            at = float(np.interp(before, time, way))
            text = next(words for t, words in warned if t == before)
            lines.append(
                f"stuck on the slope at {stuck['way']:.1f} m, warned of {stuck['way'] - at:.1f} m and"
                f" {stuck['time'] - before:.0f} s before: {text!r}"
            )
    else:
        lines.append("never stuck")
    return lines


def _last_episode(times: list[float]) -> float | None:
    """Begin of the last warnings without a long pause, s."""
    if not times:
        return None
    # Diagnostics come once a second, of a bag that is played several times as fast as recorded.
    pauses = np.flatnonzero(np.diff(times) > 12.0)
    return times[pauses[-1] + 1] if pauses.size else times[0]


def _cost(clip: Clip) -> str:
    grid = clip.recording.cost
    known = np.empty(0) if grid is None else grid.cells[grid.cells != UNKNOWN]
    if not known.size:
        return "cost map: nothing crossed"
    shares = [
        np.mean((known >= low) & (known < high)) for low, high in ((0, 20), (20, 60), (60, 101))
    ]
    return (
        f"cost map: {known.size} cells with a cost; 0 to 19 in {shares[0]:.0%}, 20 to 59 in"
        f" {shares[1]:.0%}, 60 and more in {shares[2]:.0%}"
    )


def _bare(result: DemoResult) -> list[str]:
    last = result.bare.soil.iloc[-1]
    unknown = [name for name in _DETERMINED if not last[f"{name}_identifiable"]]
    margin = result.bare.mobility["mobility_margin_standard_deviation"].median()
    measured = result.full.mobility
    measured = measured[measured["time"] <= result.bare.mobility["time"].max()]
    with_all = measured["mobility_margin_standard_deviation"].median()
    return [
        "with load and slip only the node does not know: "
        + ", ".join(unknown)
        + (f" ({last['status_text']})" if last["status_text"] else ""),
        f"margin for slopes then +- {margin:.2f} of the load, with everything +- {with_all:.2f}",
    ]
