# SPDX-License-Identifier: Apache-2.0
"""What of an effect is added: the form asked for, from its numbers on; of an id alone the best form.

Tests `apply.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import smallwheel_ros as sw
from smallwheel_ros.cli import main
from smallwheel_ros.diagnosis.apply import _forms_of
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.fitting import Problem
from smallwheel_ros.fitting.problem import Base


def table() -> pd.DataFrame:
    """Sinkage that grows as 1 + 2 i with slip, which the exponential form fits less well than others."""
    rng = np.random.default_rng(3)
    load, slip = (np.repeat(rng.uniform(*limits, 24), 2) for limits in ((20.0, 80.0), (0.0, 0.5)))
    alone = sw.predict("dry_sand", data=pd.DataFrame(
        {"load [N]": load, "diameter [m]": 0.2, "width [m]": 0.1})).to_frame()["sinkage"]  # fmt: skip
    return pd.DataFrame({
        "run": np.repeat([f"r{i}" for i in range(24)], 2), "load [N]": load, "diameter [m]": 0.2,
        "width [m]": 0.1, "slip": slip, "roughness": np.repeat(rng.uniform(0.1, 0.3, 24), 2),
        "sinkage [m]": alone * (1.0 + 2.0 * slip) * (1.0 + 0.02 * rng.standard_normal(48)),
    })  # fmt: skip


def test_the_form_asked_for_is_added_whichever_way_it_is_named() -> None:
    data = sw.read(table())
    best = sw.add("slip_sinkage", data=data).form
    other = next(form for form in ("exponential", "quadratic") if form != best)
    for wanted in (
        f"slip_sinkage/{other}",
        default_registry().form("slip_sinkage", other),
        sw.effects.effect("slip_sinkage", other),
    ):
        added = sw.add(wanted, data=data)
        assert (added.effect, added.form) == ("slip_sinkage", other)
        assert [(e.id, e.form) for e in added.model.effects] == [("slip_sinkage", other)]


def test_an_effect_brings_the_numbers_to_start_from_and_its_constants() -> None:
    data = sw.read(table())
    problem = Problem.of(data, Base())
    given = sw.effects.effect("slip_sinkage", "exponential", a=2.5)
    (one,) = _forms_of("slip_sinkage", problem, default_registry(), given)
    assert one.part.start.tolist() == [2.5]
    law = sw.effects.effect("covariate:roughness", "exponential", reference=0.17, scale=0.4)
    (added,) = sw.add(law, data=data).model.effects
    assert (added.reference, added.scale) == (0.17, 0.4)


def test_a_class_that_is_in_no_registry_is_added_too() -> None:
    @dataclass(frozen=True)
    class Doubled(default_registry().form("slip_sinkage", "exponential")):
        id = "own_slip_law"
        form = "mine"

    added = sw.add(Doubled, data=table())
    assert (added.effect, added.form) == ("own_slip_law", "mine")


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("slip_sinkage/exponentiel", "no form 'exponentiel': did you mean 'exponential'"),
        ("covariate:roughnes/exponential", "no column 'roughnes' of numbers"),
        ("slip_sinkag/exponential", "did you mean 'slip_sinkage'"),
    ],
)
def test_a_form_that_does_not_exist_is_an_error_in_words(effect: str, words: str) -> None:
    with pytest.raises(sw.Error, match=words):
        sw.add(effect, data=table())


def test_the_command_takes_a_form_too(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    table().to_csv(path, index=False)
    said = CliRunner().invoke(
        main,
        [*map(str, ["add", "slip_sinkage/exponential", "--data", path, "-o", tmp_path / "m.yaml"])],
    )
    assert said.exit_code == 0, said.output
    assert "slip sinkage (exponential)" in said.output
