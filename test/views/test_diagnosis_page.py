# SPDX-License-Identifier: Apache-2.0
"""Blocks of a diagnosis' page from documents written by hand: what is shown, stressed, folded away, left out.

Tests `diagnosis.py`.
"""

from __future__ import annotations

from typing import Any

import pytest

from smallwheel_ros.views.blocks import Details, Figure, Table, Text
from smallwheel_ros.views.diagnosis import (
    caveats,
    channel_blocks,
    next_blocks,
    ranking_blocks,
    region_blocks,
    stairs,
    step_blocks,
    unknowable_blocks,
)


def channel(**more: Any) -> dict[str, Any]:
    return {
        "rows": 60, "rmse": 0.004, "bias": -0.001, "repeatability": 0.0005, "noise_floor": 0.0012,
        "noise_floor_source": "repeats",
    } | more  # fmt: skip


def document(**more: Any) -> dict[str, Any]:
    steps = [
        {"added": None, "held_out_rmse": {"sinkage": 0.004, "resistance": 3.0}},
        {"added": "slip_sinkage", "held_out_rmse": {"sinkage": 0.0013, "resistance": 2.0}},
    ]
    return {
        "verdict": "missing_effect", "channels": {"sinkage": channel(), "resistance": channel(
            rmse=3.0, bias=0.5, repeatability=None, noise_floor=1.5)},
        "steps": steps, "warnings": [], "notes": [], "where_it_fails": [], "ranking": [],
        "missing_effects": ["slip_sinkage"], "next_measurements": [],
    } | more  # fmt: skip


def effect(name: str, **more: Any) -> dict[str, Any]:
    return {
        "effect": name, "form": "", "kind": "soil", "status": "not_significant", "probability": 0.3,
        "reduction": 0.5, "reason": "", "parameters": None,
    } | more  # fmt: skip


def lines(blocks: list[Any]) -> list[str]:
    return [line for block in blocks for line in block.lines()]


def test_channels_are_shown_in_their_units_and_warnings_are_boxed() -> None:
    text = "\n".join(lines(channel_blocks(document())))
    for shown in ("4.00 mm", "-1.00 mm", "0.500 mm", "1.20 mm", "3.00 N", "1.50 N", "repeats"):
        assert shown in text
    assert len(channel_blocks(document())) == 1
    table, box = channel_blocks(document(warnings=["look here"]))
    assert isinstance(table, Table)
    assert "look here" in "\n".join(box.lines())
    assert channel_blocks(document(channels={})) == []


def test_regions_of_few_runs_are_not_called_sure() -> None:
    def region(p: float | None) -> dict[str, Any]:
        return {"region": "slip_angle > 0.5", "channel": "sinkage", "rows": 12, "bias": 0.002,
                "rmse": 0.003, "rmse_elsewhere": 0.001, "p_value": p}  # fmt: skip

    (sure,) = region_blocks(document(where_it_fails=[region(0.05)]))
    assert "slip angle > 28.6 deg" in "\n".join(sure.lines())
    assert "too few runs" not in "\n".join(sure.lines())
    (unsure,) = region_blocks(document(where_it_fails=[region(0.06), region(None)]))
    assert "\n".join(unsure.lines()).count("too few runs to be sure") == 1
    assert region_blocks(document()) == []


def test_the_stairs_are_in_millimetres_with_the_floor_as_a_level() -> None:
    sinkage, resistance = stairs(document())
    assert [bar.name for bar in sinkage.bars] == ["base model", "+ slip sinkage"]
    assert [bar.value for bar in sinkage.bars] == pytest.approx([4.0, 1.3])
    assert [bar.colour for bar in sinkage.bars] == ["base", "with"]
    assert sinkage.level == pytest.approx(1.2)
    assert [bar.value for bar in resistance.bars] == pytest.approx([3.0, 2.0])
    bare = document(channels={})
    assert stairs(bare)[0].level is None


def test_errors_are_told_step_by_step_with_what_a_true_model_would_leave() -> None:
    figure, table = step_blocks(document())
    assert isinstance(figure, Figure)
    text = "\n".join(table.lines())
    assert "after each effect that was added" in text
    rows = [line.split() for line in table.lines() if "mm" in line]
    assert [row[-4] for row in rows] == ["4.00", "1.30", "1.20"]
    assert "part of it may be taken for scatter" not in text
    one = document(steps=document()["steps"][:1], verdict="unknown_effect")
    text = "\n".join(step_blocks(one)[1].lines())
    assert "after each effect" not in text
    assert "part of it may be taken for scatter" in text
    assert step_blocks(document(verdict="insufficient_data")) == []


def test_scatter_from_run_to_run_is_told_where_it_is_known() -> None:
    scattered = document(run_scatter={"tau": 0.07, "own:sinkage": 0.03, "own:resistance": 0.05})
    (*_, text) = step_blocks(scattered)
    assert text.lines() == [
        "From run to run the soil's stiffness differs by 7 %; in addition, sinkage by 3 % and "
        "resistance by 5 %."
    ]
    (*_, text) = step_blocks(document(run_scatter={"tau": 0.07}))
    assert text.lines() == ["From run to run the soil's stiffness differs by 7 %."]
    assert len(step_blocks(document(run_scatter={"tau": None}))) == 2


def test_what_is_left_is_stressed_beyond_three_standard_errors() -> None:
    def entry(where: dict[str, Any], *parts: tuple[Any, float, float | None]) -> dict[str, Any]:
        named = [{"at": at, "mean": mean, "std": std} for at, mean, std in parts]
        return {"channel": "sinkage", "parts": named} | where

    found = document(
        verdict="adequate",
        residuals_left=[
            entry({"setting": "slip"}, (0.1, 0.02, 0.01), (0.5, -0.031, 0.01)),
            entry({"setting": "load"}, (20.0, 0.03, 0.01), (60.0, 0.0004, None)),
            entry({"group": "soil"}, ("wet", 0.01, 0.004)),
        ],
    )
    (*_, table) = step_blocks(found)
    assert isinstance(table, Table)
    assert [table.strong(row) for row in table.rows] == [True, False, False]
    text = "\n".join(table.lines())
    assert "0.1: +2.0 ± 1.0 %, 0.5: -3.1 ± 1.0 %" in text
    assert "20 N: +3.0 ± 1.0 %, 60 N: 0.0 %" in text
    assert "soil" in text
    assert "wet: +1.0 ± 0.4 %" in text
    named = document(residuals_left=found["residuals_left"])  # of a verdict that names an effect
    assert len(step_blocks(named)) == 2


def test_effects_of_a_hundredth_are_folded_away_and_the_named_one_is_stressed() -> None:
    ranking = [
        effect("slip_sinkage", status="significant", probability=0.97,
               reason="probability 0.97: beside 21 others; this data cannot tell forms apart; odd"),
        effect("bulldozing", probability=0.01),
        effect("multipass", probability=0.009),
        effect("rig_friction", probability=None),
        effect("hardpan", status="not_testable"),
    ]  # fmt: skip
    table, folded = ranking_blocks(document(ranking=ranking))
    assert isinstance(table, Table)
    assert isinstance(folded, Details)
    assert [row["effect"] for row in table.rows] == ["slip_sinkage", "bulldozing"]
    assert [table.strong(row) for row in table.rows] == [True, False]
    text = "\n".join(table.lines())
    assert "beside 21 others; odd" in text
    assert "cannot tell" not in text
    assert "50 %" in text
    assert folded.summary == "2 others, each with a probability under 0.01"
    assert ranking_blocks(document(ranking=ranking[4:])) == []


def test_numbers_of_effects_are_shown_but_not_those_of_curves_without_a_name() -> None:
    number = {"a": {"value": 1.2, "std": 0.1, "unit": "1", "text": "growth"}}
    ranking = [
        effect("slip_sinkage", status="significant", parameters=number),
        effect("unknown:slip@sinkage", kind="unknown", status="significant", parameters=number),
        effect("bulldozing", parameters=number),  # likely, and not significant: no numbers
    ]
    first, *rest = ranking_blocks(document(ranking=ranking))
    assert len(rest) == 1
    text = "\n".join(rest[0].lines())
    assert "1.2" in text
    assert "slip_sinkage" in text
    assert "bulldozing" not in text
    assert "something that follows" not in text
    assert "something that follows slip (at the sinkage)" in "\n".join(first.lines())


def test_what_cannot_be_told_is_named_with_its_reason_and_each_pair_once() -> None:
    ranking = [
        effect("slip_sinkage", confounded_with=[{"effect": "bulldozing", "similarity": 0.987}]),
        effect("bulldozing", confounded_with=[{"effect": "slip_sinkage", "similarity": 0.987}]),
        effect("hardpan", status="not_testable", reason="the load was not varied"),
    ]
    table, pairs = unknowable_blocks(document(ranking=ranking))
    assert "the load was not varied" in "\n".join(table.lines())
    assert isinstance(pairs, Details)
    assert pairs.summary == "1 pair of effects acts alike on this data"
    (inside,) = pairs.blocks
    (line,) = inside.lines()[1:]
    assert "slip sinkage" in line
    assert "bulldozing" in line
    assert line.endswith(": 0.99")
    assert unknowable_blocks(document(ranking=[effect("multipass")])) == []


def test_what_to_measure_next_has_its_settings_and_its_chance() -> None:
    proposal = {"settings": {"slip": 0.4, "slip_angle": 0.5}, "separates": ["slip_sinkage", "bulldozing"],
                "runs": 6, "expected_power": 0.83, "text": "6 runs; keep the load"}  # fmt: skip
    ranking = [
        effect("slip_sinkage", status="significant", next_step="Repeat the runs."),
        effect("bulldozing", status="confounded", next_step="Plough."),
        effect("multipass", next_step="Roll again."),
    ]
    table, steps = next_blocks(document(next_measurements=[proposal], ranking=ranking))
    text = "\n".join(table.lines())
    for shown in (
        "slip 0.4, slip angle 28.6 deg",
        "slip sinkage from bulldozing",
        "83 %",
        "keep the load",
    ):
        assert shown in text
    assert isinstance(steps, Text)
    assert steps.items == ["slip sinkage: Repeat the runs.", "bulldozing: Plough."]
    assert next_blocks(document()) == []


def test_what_to_keep_in_mind_names_the_law_only_where_its_numbers_are_named() -> None:
    plain = caveats(document(notes=["one thing"]))
    assert plain[-1] == "One thing."
    assert any("held out" in note for note in plain)
    assert not any(note.startswith("The law:") for note in plain)
    assert caveats(document(notes=["dry_sand.k is at its bound"]))[-1].startswith("The law:")
    small = caveats(document(verdict="insufficient_data"))
    assert not any("held out" in note for note in small)


def test_how_one_share_of_error_belongs_to_several_channels_is_explained_where_there_are_several() -> (
    None
):
    one = effect("slip_sinkage", status="significant", held_out_rmse={"sinkage": 0.001})
    two = effect(
        "multipass", status="confounded", held_out_rmse={"sinkage": 0.001, "resistance": 1.0}
    )
    for rows, explained in (([one], False), ([one, two], True)):
        text = " ".join("\n".join(lines(ranking_blocks(document(ranking=rows)))).split())
        assert ("root mean square" in text) == explained
