# SPDX-License-Identifier: Apache-2.0
"""Numbers of a fit by name, and those that follow from its parameters, with their deviations.

Tests `measured.py`, `named.py` and `remedies.py`.
"""

from __future__ import annotations

import copy
import json
import pickle
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

import smallwheel_ros as sw
from smallwheel_ros import cli
from smallwheel_ros.fitting import FitResult
from smallwheel_ros.model.derived import derived_numbers
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import read_model, write_model
from smallwheel_ros.physics.soil import Soil
from smallwheel_ros.simulate import RigSettings, simulate_rig, write_table

PARAMETERS = ("log_reference_pressure", "n", "m", "log_shear_displacement")


def sampled(soil: Soil, held: set[str], covariance: np.ndarray) -> dict[str, float]:
    """Deviations of k and K over draws of the parameters, by the law itself."""
    mean = [np.log(soil.k * 0.01**soil.n * 0.2**soil.m), soil.n, soil.m,
            np.log(soil.shear_displacement)]  # fmt: skip
    free = np.array([name not in held for name in PARAMETERS])
    root = np.linalg.cholesky(covariance)
    noise = np.random.default_rng(1).standard_normal((20000, 4))
    log_pressure, n, m, log_modulus = (np.array(mean) + np.where(free, noise @ root.T, 0.0)).T
    return {
        "k": float((np.exp(log_pressure) / 0.01**n / 0.2**m).std()),
        "shear_displacement": float(np.exp(log_modulus).std()),
    }


@given(
    k=st.floats(1e3, 1e8),
    n=st.floats(0.2, 1.6),
    m=st.floats(-0.8, 0.8),
    modulus=st.floats(1e-3, 0.1),
    scale=st.lists(st.floats(1e-4, 0.02), min_size=4, max_size=4),
    seed=st.integers(0, 1000),
    held=st.sets(st.sampled_from(["n", "m"])),
)
@settings(max_examples=examples(30))
def test_deviations_are_those_of_a_sample(
    k: float, n: float, m: float, modulus: float, scale: list[float], seed: int, held: set[str]
) -> None:
    soil = Soil("sand", k, n, m, shear_displacement=modulus)
    mixed = np.random.default_rng(seed).normal(size=(4, 4)) + 2.0 * np.eye(4)
    root = np.array(scale)[:, None] * mixed / np.linalg.norm(mixed, axis=1)[:, None]
    covariance = root @ root.T + 1e-10 * np.eye(4)
    names = [f"sand.{name}" for name in PARAMETERS if name not in held]
    kept = [i for i, name in enumerate(PARAMETERS) if name not in held]
    expected = sampled(soil, held, covariance)
    for one in derived_numbers(soil, names, covariance[np.ix_(kept, kept)]):
        assert one.value == getattr(soil, one.name)
        assert one.std == pytest.approx(expected[one.name], rel=0.05)
    model = CalibratedModel(Model(soil), tuple(names), covariance[np.ix_(kept, kept)])
    shown = {row["parameter"]: row["std"] for row in model.rows()}
    assert {name: shown[name] for name in expected} == pytest.approx(expected, rel=0.05)
    assert shown["cohesion"] is None


def test_of_what_no_one_knows_there_is_no_deviation() -> None:
    soil = Soil("sand", 1e6, 0.9, 0.1)
    for names in ((), ("sand.n",), ("clay.log_reference_pressure",)):
        assert {one.std for one in derived_numbers(soil, names, np.eye(len(names)))} == {None}


def fitted(folder: Path, change: object = None, **how: object) -> FitResult:
    frame = simulate_rig(RigSettings(**({"seed": 2010} | how))).table  # type: ignore[arg-type]
    if callable(change):
        frame = change(frame)
    write_table(frame, folder / "rig.csv")
    found = sw.fit(folder / "rig.csv")
    assert isinstance(found, FitResult)
    return found


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    return fitted(tmp_path_factory.mktemp("pulled"), channels=("sinkage", "drawbar_pull"))


def test_each_number_has_its_deviation_in_text_json_frame_and_python(
    pulled: FitResult, tmp_path: Path
) -> None:
    document, frame = pulled.to_dict(), pulled.to_frame().set_index("parameter")
    write_model(tmp_path / "m.yaml", pulled.model)
    of_file = {row["parameter"]: row for row in read_model(tmp_path / "m.yaml").rows()}
    for name in ("k", "shear_displacement"):
        one = pulled[name]
        assert one is pulled[f"rig_soil.{name}"]
        assert one == getattr(pulled, name)
        assert one.value == pytest.approx(getattr(pulled.model.soils[0], name))
        assert one.std is not None
        assert 0.0 < one.std < one.value
        assert document["derived"][one.full_name]["std"] == one.std
        assert frame.loc[name, "std"] == one.std
        assert of_file[name]["std"] == pytest.approx(one.std)
        row = re.search(rf"rig_soil +{name.replace('_', ' ')} +(\S+) +(\S+)", str(pulled))
        assert row is not None
        assert float(row[2]) / float(row[1]) == pytest.approx(one.std / one.value, rel=0.05)
        shown = str(one).split(" ")
        assert float(shown[0]) == pytest.approx(one.value, rel=1e-3)
        assert float(shown[2]) == pytest.approx(one.std, rel=0.05)
    assert document["soils"]["rig_soil"]["k"] == pulled["k"].value
    assert pulled["n"].std == document["parameters"]["rig_soil.n"]["std"]
    assert repr(pulled["n"]).startswith("<rig_soil.n: 0.")
    assert {"k", "n", "shear_displacement"} <= set(dir(pulled))


def test_fit_is_shown_without_a_file(pulled: FitResult, tmp_path: Path) -> None:
    table = pulled.measurements.source
    done = CliRunner().invoke(cli.main, ["fit", table])
    assert done.exit_code == 0
    assert done.stdout == f"{pulled}\n"
    written = CliRunner().invoke(cli.main, ["fit", table, "-o", str(tmp_path / "m.yaml")])
    assert written.stdout == f"{pulled}\nwritten: {tmp_path / 'm.yaml'}\n"
    asked = CliRunner().invoke(cli.main, ["fit", table, "--json", "-"])
    assert json.loads(asked.stdout)["derived"] == pulled.to_dict()["derived"]


@pytest.mark.parametrize("name", ["kk", "sand.n", "N", "", "rig_soil", "cohesion.k"])
def test_an_unknown_name_is_answered_with_those_that_there_are(
    pulled: FitResult, name: str
) -> None:
    with pytest.raises(KeyError) as by_key:
        pulled[name]
    with pytest.raises(AttributeError) as by_attribute:
        getattr(pulled, name)
    for error in (by_key, by_attribute):
        said = str(error.value)
        assert f"no parameter '{name}'" in said
        for known in ("rig_soil.k", "rig_soil.n", "rig_soil.cohesion"):
            assert known in said
    assert isinstance(by_key.value, sw.Error)


def test_of_several_soils_the_name_must_say_which(tmp_path: Path) -> None:
    def two(frame: pd.DataFrame) -> pd.DataFrame:
        half = frame["run"].isin(frame["run"].unique()[::2])
        return frame.assign(soil=np.where(half, "clay", "loam"))

    found = fitted(tmp_path, two)
    assert found["clay.k"].value != found["loam.k"].value
    assert {found[f"{soil}.k"].std is not None for soil in ("clay", "loam")} == {True}
    for name in ("n", "k"):
        with pytest.raises(KeyError, match=rf"say which: clay\.{name}, loam\.{name}"):
            found[name]
        with pytest.raises(AttributeError, match=rf"clay\.{name}, loam\.{name}"):
            getattr(found, name)


def test_with_one_diameter_k_is_known_at_the_m_that_is_held(tmp_path: Path) -> None:
    def one(frame: pd.DataFrame) -> pd.DataFrame:
        return frame[frame["diameter [mm]"] == frame["diameter [mm]"].iloc[0]]

    found = fitted(tmp_path, one)
    assert (found.m.status, found.m.std) == ("held", None)
    assert found.k.status == "held"
    assert found.k.std is not None
    assert str(found.k).endswith("(with m held)")
    assert found.k.remedy == found.m.remedy != ""


def test_what_follows_from_a_number_at_its_bound_has_no_deviation(tmp_path: Path) -> None:
    def steep(frame: pd.DataFrame) -> pd.DataFrame:
        """Sinkage that hardly depends on the load: n beyond its bound."""
        return frame.assign(**{"sinkage [mm]": 20.0 * (frame["load [N]"] / 60.0) ** 0.02})

    found = fitted(tmp_path, steep, channels=("sinkage",))
    assert (found.n.status, found.n.std) == ("at its bound", None)
    assert found.k.std is None
    assert found.k.status == "at its bound"


def test_a_fit_is_copied_pickled_and_not_gone_through(pulled: FitResult) -> None:
    for other in (copy.deepcopy(pulled), pickle.loads(pickle.dumps(pulled))):
        assert other["k"].value == pulled["k"].value
    assert not hasattr(pulled, "_repr_mimebundle_")
    assert not hasattr(pulled, "columns")
    with pytest.raises(TypeError, match="not iterable"):
        list(pulled)  # type: ignore[call-overload]
