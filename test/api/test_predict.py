# SPDX-License-Identifier: Apache-2.0
"""`predict` as a function: which soil is meant, ranges and tables, and what does not go together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw

WHEEL: dict[str, Any] = {"load": 60.0, "diameter": 0.2, "width": 0.1}
TWO = sw.Model(["dry_sand", "moist_earth"])


def sinkage(model: object, **given: Any) -> float:
    (row,) = sw.predict(model, **WHEEL | given).rows()  # type: ignore[arg-type]
    return float(row["sinkage"])


def test_the_soil_of_several_is_that_which_is_named() -> None:
    sand, earth = sinkage("dry_sand"), sinkage("moist_earth")
    assert sand != earth
    assert sinkage(TWO, soil="dry_sand") == sand
    assert sinkage(TWO, soil="moist_earth") == earth
    assert sinkage(None, soil="moist_earth") == earth
    with pytest.raises(sw.Error, match=r"the model: has several soils .*: say which"):
        sinkage(TWO)
    with pytest.raises(sw.Error, match=r"no soil 'moist_earh'.*moist_earth"):
        sinkage(TWO, soil="moist_earh")
    with pytest.raises(sw.Error, match="found no soil and no model"):
        sinkage(None)


def test_a_model_file_is_named_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    TWO.save(path)
    assert sinkage(path, soil="dry_sand") == pytest.approx(sinkage("dry_sand"))
    with pytest.raises(sw.Error, match=r"two\.yaml: has several soils"):
        sinkage(path)


def test_the_closed_form_is_equation_10_and_goes_with_a_soil_of_the_library() -> None:
    sand = sw.soil("dry_sand")
    by_hand = (3 * 60.0 / (0.1 * (3 - sand.n) * sand.k * 0.2 ** (sand.m + 0.5))) ** (
        2 / (2 * sand.n + 1)
    )
    assert sinkage(None, soil="dry_sand", closed_form=True) == pytest.approx(by_hand)
    assert abs(sinkage(None, soil="dry_sand") / by_hand - 1.0) > 0.01
    with pytest.raises(sw.Error, match="closed_form goes with a soil of the library"):
        sinkage("dry_sand", closed_form=True)


def test_rows_that_name_their_soil_are_each_on_their_own() -> None:
    rows = pd.DataFrame({
        "load [N]": 60.0, "diameter [m]": 0.2, "width [m]": 0.1,
        "soil": ["moist_earth", "dry_sand", "moist_earth"],
    })  # fmt: skip
    sand, earth = sinkage("dry_sand"), sinkage("moist_earth")
    own = [row["sinkage"] for row in sw.predict(TWO, data=rows).rows()]
    assert own == pytest.approx([earth, sand, earth])
    # A soil that is said, and a model of one soil, hold for every row.
    assert [r["sinkage"] for r in sw.predict(TWO, data=rows, soil="dry_sand").rows()] == [sand] * 3
    assert [r["sinkage"] for r in sw.predict("dry_sand", data=rows).rows()] == [sand] * 3
    with pytest.raises(sw.Error, match="say which"):
        sw.predict(TWO, data=rows.drop(columns="soil"))


def test_a_table_takes_sizes_that_hold_for_all_its_rows_and_nothing_else() -> None:
    rows = pd.DataFrame({"load [N]": [40.0, 80.0], "sinkage [mm]": [7.0, np.nan]})
    found = sw.predict("dry_sand", data=rows, diameter="20 cm", width=0.1)
    first, second = found.rows()
    assert first["sinkage"] == pytest.approx(sinkage("dry_sand", load=40.0))
    assert first["measured_sinkage"] == pytest.approx(7e-3)
    assert second["measured_sinkage"] is None
    with pytest.raises(sw.Error, match="data and load: found both, expected one"):
        sw.predict("dry_sand", data=rows, load=40.0, diameter=0.2, width=0.1)


def test_ranges_make_every_combination() -> None:
    found = sw.predict("dry_sand", load=[40, 80], diameter="0.2,0.3", width=0.1, slip="10%")
    rows = found.rows()
    assert [(r["load"], r["diameter"]) for r in rows] == [
        (40.0, 0.2), (40.0, 0.3), (80.0, 0.2), (80.0, 0.3),
    ]  # fmt: skip
    assert all(row["slip"] == pytest.approx(0.1) for row in rows)
    assert found.varied == ("load", "diameter")
    for row in rows:
        alone = sinkage("dry_sand", load=row["load"], diameter=row["diameter"], slip=0.1)
        assert row["sinkage"] == pytest.approx(alone)


def test_what_is_lacking_is_named() -> None:
    with pytest.raises(sw.Error, match="load, width: found nothing, expected a value"):
        sw.predict("dry_sand", diameter=0.2)
