# SPDX-License-Identifier: Apache-2.0
"""The bench's diagnosis at the end of a replay, `diagnosis.py`: of steady stretches made by another law."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from smallwheel_ros.api.diagnose import diagnose
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.replay.diagnosis import diagnosed
from smallwheel_ros.simulate.truth import static_sinkage


def stretches(count: int, slip_sinkage: float = 0.0) -> pd.DataFrame:
    """Steady stretches of two sizes of wheels, as `SteadyStretches` gives them."""
    rng = np.random.default_rng(5)
    index = np.arange(count)
    diameter = np.where(index % 2, 0.3, 0.2)
    load = np.exp(rng.normal(np.log(80.0), 0.3, count))
    modulus = 30e3 / 0.01**0.9 * np.exp(0.03 * rng.standard_normal(count))
    still = static_sinkage(
        lambda depth: modulus[:, None] * depth**0.9, load, diameter, np.full(count, 0.1)
    )
    slip = rng.uniform(0.02, 0.4, count)
    sinkage = still * (1.0 + slip_sinkage * slip) + 3e-4 * rng.standard_normal(count)
    return pd.DataFrame(
        {
            "load [N]": load, "diameter [m]": diameter, "width [m]": 0.1, "sinkage [m]": sinkage,
            "sinkage_std [m]": 3e-4, "slip": slip, "speed [m/s]": 0.4, "contact": "rolling", "soil": "soil 1",
            "run": [f"1.{i // 2}" for i in index],
            "wheel": pd.Categorical(np.where(index % 2, "rear", "front")),
        }
    )  # fmt: skip


def with_zeros(
    table: pd.DataFrame, zeros: tuple[float, ...] = (2e-3, -1e-3, -2e-3, 1e-3)
) -> pd.DataFrame:
    """The same vehicle with a wheel on each side of both axles, each with a zero (m) of its sensor."""
    index = np.arange(len(table))
    left = index // 2 % 2 == 1
    return table.assign(
        wheel=pd.Categorical(table["wheel"].astype(str) + np.where(left, "_left", "_right")),
        **{"sinkage [m]": table["sinkage [m]"] + np.array(zeros)[2 * left + index % 2]},
    )


def test_of_a_short_drive_nothing_is_said_but_that() -> None:
    found = diagnosed(stretches(60), Path("measurements.csv"))
    assert found.to_dict()["verdict"] is None
    (line,) = found.lines
    assert "60" in line
    assert "120" in line


def test_a_table_that_cannot_be_read_is_one_line() -> None:
    table = stretches(140).assign(contact="floating")
    found = diagnosed(table, Path("measurements.csv"))
    assert found.verdict == ""
    assert "floating" in found.lines[0]


def test_where_nothing_shows_no_model_is_refitted() -> None:
    found = diagnosed(stretches(140), Path("out/measurements.csv"))
    assert found.verdict == "adequate"
    first, second = found.lines
    assert first.startswith("Diagnosis of 140 steady stretches: no missing effect shows (p")
    assert "smallwheel diagnose out/measurements.csv" in second


def test_what_the_filter_has_found_is_said_where_stretches_do_not_show_it() -> None:
    remark = "sinkage grows with slip, s = 0.9 +- 0.2"
    for count in (60, 140):
        found = diagnosed(stretches(count), Path("out/measurements.csv"), [remark])
        assert remark in found.lines[0]
        assert "no missing effect" not in found.lines[0]
        assert found.to_dict()["by_filter"] == [remark]
        assert found.effects == ()


@pytest.mark.slow
def test_where_none_is_likelier_than_each_effect_none_is_named_anywhere() -> None:
    """Wheels of an axle under one name, so that nothing says that the zeros of their sensors differ."""
    table = with_zeros(stretches(140), (3e-3, -3e-3, 0.0, 2e-3))
    table["wheel"] = table["wheel"].str.split("_").str[0]
    table = table[table["sinkage [m]"] > 0.0]
    found = diagnosed(table, Path("out/measurements.csv"))
    written = found.to_dict()
    assert written["verdict"] == "unknown_effect"
    assert written["missing_effects"] == written["candidates"] == []
    first, second = found.lines
    assert "no effect of the library is likelier than none" in first
    assert not [name for name in default_registry() if name.replace("_", " ") in first]
    assert "smallwheel diagnose out/measurements.csv" in second


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "verdict"), [(1.0, "missing_effect"), (0.0, "adequate")])
def test_slip_sinkage_that_the_model_lacks_is_named_in_two_lines_and_by_the_next_step(
    tmp_path: Path, strength: float, verdict: str
) -> None:
    """Without the zeros' being taken out of the table it would be an effect that nobody knows."""
    path, table = tmp_path / "measurements.csv", with_zeros(stretches(140, strength))
    table.to_csv(path, index=False)
    found, following = diagnosed(table, path), diagnose(path)
    assert found.verdict == following.verdict == verdict
    assert list(found.effects) == following.missing_effects
    first, second = found.lines
    assert ("slip_sinkage" in found.effects) is (strength > 0.0)
    assert ("slip sinkage" in first) is (strength > 0.0)
    assert second.startswith("Next:")
