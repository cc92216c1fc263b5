# SPDX-License-Identifier: Apache-2.0
"""The harness of the rates: trials that go on where they were, intervals, limits."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from rates import real_drives
from rates import run as bench
from rates.drive_worlds import WORLDS
from rates.drives import SUBJECTS
from rates.faults import FAULTS
from rates.judges import Judge, Subject, events, middle, ratio, share
from rates.run import ALL


def line(**values: Any) -> dict[str, Any]:
    return {"world": "w", "seed": 0} | values


def test_a_share_has_wilsons_interval() -> None:
    found = share(lambda one: one["hit"])([line(hit=i < 3) for i in range(10)])
    assert found is not None
    assert (found.value, found.count) == (0.3, 10)
    assert (found.low, found.high) == pytest.approx((0.1078, 0.6032), abs=1e-3)  # Wilson 1927
    assert share(lambda one: one["hit"], lambda _: 0)([line(hit=1)]) is None


def test_a_ratio_has_an_interval_over_drives_and_not_over_rows() -> None:
    lines = [line(a=90.0 if i % 2 else 10.0, b=100.0) for i in range(20)]
    found = ratio(lambda one: one["a"], lambda one: one["b"])(lines)
    assert found is not None
    assert found.value == pytest.approx(0.5)
    assert 0.15 < found.high - found.low < 0.5  # 2000 rows would have 0.04
    root = ratio(lambda one: one["a"], lambda one: one["b"], root=True)(lines)
    assert root is not None
    assert root.value == pytest.approx(0.5**0.5)


def test_events_are_counted_by_the_way() -> None:
    found = events(lambda one: one["n"], lambda one: one["m"], 500.0)([line(n=0, m=1000.0)])
    assert found is not None
    assert (found.value, found.low, found.count) == (0.0, 0.0, 1000)
    assert found.high == pytest.approx(
        1.84, abs=0.01
    )  # 3.69 events, of which none is a chance of 2.5 %


def test_a_median_leaves_out_what_is_not_known() -> None:
    found = middle(lambda one: one["x"])([line(x=1.0), line(x=None), line(x=3.0), line(x=2.0)])
    assert found is not None
    assert (found.value, found.count) == (2.0, 3)


def test_only_a_rate_that_is_wholly_beyond_its_limit_fails() -> None:
    judge = Judge("bad", share(lambda one: one["hit"]), None, 0.1)
    few = judge.count([line(hit=i < 2) for i in range(10)])
    many = judge.count([line(hit=i < 20) for i in range(100)])
    assert few is not None
    assert many is not None
    assert not judge.fails(few)
    assert judge.fails(many)
    least = Judge("good", share(lambda one: one["hit"]), 0.5)
    assert least.fails(many)
    assert (judge.limit, least.limit) == ("at most 0.1", "at least 0.5")


def subject(calls: list[tuple[str, int]]) -> Subject:
    def trial(world: str, seed: int) -> dict[str, Any]:
        calls.append((world, seed))
        if world == "breaks":
            raise ValueError("no such soil")
        return {"hit": seed > 0}

    judges = [Judge("hits", share(lambda one: one["hit"]), 0.9, None, "^a$")]
    return Subject("tried", ["a", "b", "breaks"], trial, judges, 2, 1.0)


def test_trials_go_on_where_they_were_and_failures_are_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, int]] = []
    tried = subject(calls)
    monkeypatch.setattr(bench, "subject_of", lambda _: tried)
    store = tmp_path / "rates" / "tried.jsonl"
    bench.run(tried, [("a", 0), ("breaks", 0)], store, 1)
    with store.open("a", encoding="utf-8") as file:
        file.write('{"world": "b", "se')  # cut short
    calls.clear()
    lines = bench.run(tried, [("a", 0), ("b", 0), ("a", 1), ("breaks", 0)], store, 1)
    assert calls == [("b", 0), ("a", 1), ("breaks", 0)]
    assert sum("failed" in one for one in lines) == 1
    kept = [json.loads(text) for text in store.read_text().splitlines() if text.endswith("}")]
    assert {(one["world"], one["seed"]) for one in kept} == {
        ("a", 0),
        ("a", 1),
        ("b", 0),
        ("breaks", 0),
    }

    table = bench.rates(tried, lines)
    rows = {(row.world, row.what): row for row in table.itertuples()}
    assert float(rows[ALL, "hits"].value) == pytest.approx(1 / 3, abs=1e-4)
    assert rows["b", "hits"].limit == ""
    assert rows["breaks", "trials that failed"].fails


def test_every_fault_and_every_limit_of_a_world_is_of_one_that_there_is() -> None:
    for worlds in WORLDS.values():
        for world in worlds.values():
            assert set(world.faults) <= set(FAULTS), world.name
            assert not world.faults or world.said, world.name
    for one in SUBJECTS:
        assert one.worlds
        names = [judge.what for judge in one.judges]
        assert len(names) == len(set(names))


def test_rows_can_be_read_by_others(tmp_path: Path) -> None:
    calls: list[tuple[str, int]] = []
    table = bench.rates(subject(calls), [line(world="a", hit=True), line(world="b", hit=False)])
    path = tmp_path / "tried.csv"
    table.to_csv(path, index=False)
    again = pd.read_csv(path)
    assert list(again.columns) == list(bench.COLUMNS)
    judged = again[again["what"] == "hits"]
    assert judged["value"].tolist() == [0.5, 1.0, 0.0]


def test_the_page_has_pooled_rates_and_the_worlds_that_fail(tmp_path: Path) -> None:
    calls: list[tuple[str, int]] = []
    lines = [line(world="a", hit=False) for _ in range(9)] + [line(world="b", hit=True)]
    bench.rates(subject(calls), lines).to_csv(tmp_path / "tried.csv", index=False)
    page = tmp_path / "rates.md"
    page.write_text(
        "# Rates\n\n<!-- rates: tried -->\nold\n<!-- end -->\n\nEnd.\n", encoding="utf-8"
    )
    bench.write_page(page, tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "- hits (≥0.9): 0.1 (0.0179–0.404) ✗" in text
    assert "Seeds: tried 1 to 9 of 2 worlds. Beyond a limit: hits: a.\n<!-- end -->" in text
    assert "old" not in text
    assert text.endswith("End.\n")


def test_subjects_stand_side_by_side(tmp_path: Path) -> None:
    calls: list[tuple[str, int]] = []
    hits = [line(world="a", hit=True) for _ in range(4)]
    one = bench.rates(subject(calls), hits)
    one.to_csv(tmp_path / "one.csv", index=False)
    more = one[one["what"] == "hits"].assign(what="others")
    pd.concat([one, more]).to_csv(tmp_path / "two.csv", index=False)
    made = bench.page_table(
        {name: pd.read_csv(tmp_path / f"{name}.csv") for name in ("one", "two")}
    )
    assert made.splitlines() == [
        "| | one | two |",
        "| --- | --- | --- |",
        "| hits (≥0.9) | 1 (0.51–1) | 1 (0.51–1) |",
        "",
        "- two, others (≥0.9): 1 (0.51–1)",
        "",
        "Seeds: one 4 of 1 worlds, two 4 of 1 worlds.",
    ]


def test_drives_that_are_not_replayed_again_keep_their_rows(tmp_path: Path) -> None:
    def row(name: str, known: str) -> Any:
        cells = [
            name,
            "60 s, 20 m",
            known,
            "-",  # in its band
            "-",  # stated over median error
            "0.4 ± 0.7",
            "2, 1; 3",
            "0",
            f"odometry: of {name}",
        ]
        columns = [*real_drives.HEADER, real_drives.SAID]
        return SimpleNamespace(cells=dict(zip(columns, cells, strict=True)))

    path = tmp_path / "real_drives.csv"
    real_drives.merged([row("mine/mud", "90%"), row("mine/sand", "80%")], path).to_csv(
        path, index=False
    )
    table = real_drives.merged([row("mine/sand", "85%")], path)
    assert table["drive"].tolist() == ["mine/mud", "mine/sand"]
    assert table["slip known"].tolist() == ["90%", "85%"]
    text = real_drives.markdown(table)
    assert "40 m: 4 warnings, 2 of them of the second level" in text
    assert "gives 6;" in text
    assert "| mine/mud | 60 s, 20 m | 90% |" in text
    assert "- mine/sand: odometry: of mine/sand\n" in text
