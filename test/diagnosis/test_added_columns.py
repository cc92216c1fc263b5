# SPDX-License-Identifier: Apache-2.0
"""Which effects can be added to a table at all: what is no free column is named, and what to do.

Tests `apply.py`.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import smallwheel_ros as sw


def table() -> pd.DataFrame:
    rng = np.random.default_rng(1)
    load = np.repeat(rng.uniform(20.0, 80.0, 8), 2)
    return pd.DataFrame({
        "run": np.repeat([f"r{i}" for i in range(8)], 2), "load [N]": load, "diameter [m]": 0.2,
        "width [m]": 0.1, "slip": np.repeat(rng.uniform(0.0, 0.4, 8), 2),
        "moisture": np.repeat(rng.uniform(0.1, 0.3, 8), 2), "operator": "somebody",
        "sinkage [m]": 0.01 * (load / 60.0) * (1.0 + 0.02 * rng.standard_normal(16)),
    })  # fmt: skip


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("covariate:slip", "'slip' is a known setting, .*slip_sinkage.*fits a free law of it"),
        ("covariate:load", "'load' is a known setting"),
        ("covariate:sinkage", "'sinkage' is a measured quantity, no setting"),
        ("covariate:operator", "'operator' is text, expected a column of numbers"),
        ("covariate:moisure", "no column 'moisure' of numbers: did you mean 'moisture'"),
        ("slip_sinkag", "did you mean 'slip_sinkage'"),
        ("multipass", "'multipass' cannot be fitted to this data: "),
    ],
)
def test_what_cannot_be_added_is_named_before_anything_is_fitted(effect: str, words: str) -> None:
    with pytest.raises(sw.Error, match=words):
        sw.add(effect, data=table())


def test_without_a_free_column_it_says_so() -> None:
    bare = table().drop(columns=["moisture", "operator"])
    with pytest.raises(sw.Error, match="only the known settings are there"):
        sw.add("covariate:moisture", data=bare)
