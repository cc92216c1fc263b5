# SPDX-License-Identifier: Apache-2.0
"""Model files: exact round trips, and refusals that say what is wrong where.

Tests `measured.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from random_examples import examples

from smallwheel_ros.common.files import OutputError
from smallwheel_ros.effects.registry import covariate, effect, families, load
from smallwheel_ros.model.measured import ForceLaw, Measured, RunScatter, Tied
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.model.model_file import ModelFileError, read_model, write_model
from smallwheel_ros.physics.soil import SOILS, Soil, soil

NAMES = (
    "dry_sand.log_reference_pressure",
    "dry_sand.n",
    "dry_sand.m",
    "slip_sinkage.a",
)
COVARIANCE = np.array(
    [
        [1.1e-3, 2e-4, 0.0, 1e-5],
        [2e-4, 4.1e-4, 0.0, -2e-5],
        [0.0, 0.0, 1 / 3, 0.0],
        [1e-5, -2e-5, 0.0, 2e-3],
    ]
)


@pytest.fixture
def calibrated() -> CalibratedModel:
    model = Model([soil("dry_sand"), soil("moist_earth")], thrust_form="exponential")
    model += effect("slip_sinkage", a=1.2345678901234567)
    model += effect("covariate:temperature", "power", p=-0.1, reference=291.3)
    provenance = {
        "data": "rig.csv",
        "sha256": "0" * 64,
        "date": "2026-11-21",
        "held_out_rmse": {"sinkage": 0.0012},
        "runs": 24,
    }
    return CalibratedModel(model, NAMES, COVARIANCE, provenance)


def same(a: CalibratedModel, b: CalibratedModel) -> bool:
    return (
        a.model == b.model
        and a.names == b.names
        and np.array_equal(a.covariance, b.covariance)
        and dict(a.provenance) == dict(b.provenance)
    )


def test_round_trip_is_exact(tmp_path: Path, calibrated: CalibratedModel) -> None:
    path = tmp_path / "model.yaml"
    write_model(path, calibrated)
    read = read_model(path)
    assert same(read, calibrated)
    assert read.standard_deviation("slip_sinkage.a") == np.sqrt(2e-3)
    assert read.standard_deviation("moist_earth.n") is None
    first = path.read_bytes()
    write_model(path, read)
    assert path.read_bytes() == first


MEASURED = Measured(
    ranges={"load": (20.0, 130.5), "slip": (0.0, 0.5)},
    wheels=((0.2, 0.1, 0.0), (0.28, 0.12, 0.006)),
    stiffness=0.051,
    runs={"sinkage": RunScatter(0.03, 1e-4, 2e-4, 0.02, law=0.025)},
    forces={"drawbar_pull": ForceLaw(0.01, 0.03, 0.04)},
    tied=(Tied("load", "slip", 0.1, 0.004, 0.01),),
    unexplained=True,
)


def test_a_calibrated_model_is_equal_in_all_that_it_predicts_with(
    calibrated: CalibratedModel,
) -> None:
    assert calibrated == calibrated.changed(provenance={"date": "another"})
    assert hash(calibrated) == hash(calibrated.changed(provenance={}))
    other = calibrated.changed(covariance=2.0 * calibrated.covariance)
    measured = calibrated.changed(measured=Measured(stiffness=0.7))
    rivals = calibrated.changed(rivals=[(1.0, calibrated)])
    for unlike in (CalibratedModel(calibrated.model), other, measured, rivals, calibrated.model):
        assert calibrated != unlike


def test_what_was_measured_and_rivals_come_back(
    tmp_path: Path, calibrated: CalibratedModel
) -> None:
    path = tmp_path / "model.yaml"
    other = CalibratedModel(Model(soil("dry_sand")) + effect("bulldozing", scale=2.0))
    made = calibrated.changed(measured=MEASURED, rivals=((0.6, calibrated), (0.4, other)))
    write_model(path, made)
    read = read_model(path)
    assert read.measured == MEASURED
    assert [share for share, _ in read.rivals] == [0.6, 0.4]
    assert all(same(a, b) for (_, a), (_, b) in zip(read.rivals, made.rivals, strict=True))
    assert set(yaml.safe_load(path.read_text())) >= {"measured", "rivals"}
    assert "measured" not in yaml.safe_load(path.read_text())["provenance"]


def test_a_file_that_does_not_say_what_its_law_is_off_by_is_read(
    tmp_path: Path, calibrated: CalibratedModel
) -> None:
    path = tmp_path / "model.yaml"
    write_model(path, calibrated.changed(measured=MEASURED))
    plain = yaml.safe_load(path.read_text())
    del plain["measured"]["runs"]["sinkage"]["law"]
    path.write_text(yaml.safe_dump(plain))
    runs = read_model(path).measured.runs
    assert runs["sinkage"] == RunScatter(0.03, 1e-4, 2e-4, 0.02)
    del plain["measured"]
    path.write_text(yaml.safe_dump(plain))
    assert read_model(path).measured == Measured()


def test_a_file_without_them_is_read(tmp_path: Path, calibrated: CalibratedModel) -> None:
    path = tmp_path / "model.yaml"
    write_model(path, calibrated)
    assert "measured" not in yaml.safe_load(path.read_text())
    assert read_model(path).measured == Measured()
    assert read_model(path).rivals == ()


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            ("measured", "ranges", "load"),
            [1.0],
            "measured.ranges.load: found [1.0], expected 2 numbers",
        ),
        (
            ("measured", "ranges", "load"),
            "wide",
            "measured.ranges.load: found 'wide', expected a list",
        ),
        (
            ("measured", "runs", "sinkage", "zero"),
            float("nan"),
            "zero: found nan, expected a finite number",
        ),
        (
            ("measured", "forces", "torque"),
            3,
            "measured.forces.torque: found 3, expected a mapping",
        ),
        (
            ("measured", "tied"),
            [{"setting": 1}],
            "measured.tied[0].setting: found 1, expected a text",
        ),
        (("measured", "unexplained"), "perhaps", "found 'perhaps', expected one of False, True"),
        (("measured", "colour"), 1, "measured.colour: unknown key"),
        (
            ("rivals", 0, "probability"),
            0.0,
            "rivals[0].probability: found 0.0, expected a probability",
        ),
        (
            ("rivals", 0, "probability"),
            0.4,
            "rivals: the probabilities of the rivals sum to 0.4, expected 1",
        ),
        (("rivals", 0, "soils"), None, "rivals[0].soils: found nothing, expected a list"),
        (("rivals",), 4, "rivals: found 4, expected a list"),
    ],
)
def test_damage_there_is_refused_in_words(
    tmp_path: Path,
    calibrated: CalibratedModel,
    key: tuple[str | int, ...],
    value: object,
    said: str,
) -> None:
    path = tmp_path / "model.yaml"
    write_model(path, calibrated.changed(measured=MEASURED, rivals=((1.0, calibrated),)))
    document = yaml.safe_load(path.read_text())
    place = document
    for name in key[:-1]:
        place = place[name]
    place[key[-1]] = value
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(ModelFileError) as refused:
        read_model(path)
    assert said in str(refused.value)


@given(
    k=st.floats(1e-3, 1e12),
    n=st.floats(1e-3, 2.999),
    m=st.floats(-3, 3),
    cohesion=st.floats(0, 1e6),
    name=st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1),
    variances=st.lists(st.floats(0, 1e6), min_size=3, max_size=3),
)
@settings(max_examples=examples(50))
def test_any_soil_comes_back(
    tmp_path_factory: pytest.TempPathFactory,
    k: float,
    n: float,
    m: float,
    cohesion: float,
    name: str,
    variances: list[float],
) -> None:
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    names = tuple(f"{name}.{p}" for p in ("log_reference_pressure", "n", "m"))
    made = CalibratedModel(Model(Soil(name, k, n, m, cohesion)), names, np.diag(variances))
    write_model(path, made)
    assert same(read_model(path), made)


def test_every_effect_comes_back(tmp_path: Path) -> None:
    forms = [form for family in families().values() for form in family if not form.geometry]
    for form in [*forms, *covariate("x: [odd]")]:
        values = {
            p.name: p.bounds[0] + (p.bounds[1] - p.bounds[0]) / 3
            for p in (*form.parameters(), *form.constants())
        }
        made = CalibratedModel(Model(soil("dry_sand")) + form(**values))
        write_model(tmp_path / "model.yaml", made)
        assert read_model(tmp_path / "model.yaml").model == made.model


def test_a_file_that_people_write(tmp_path: Path) -> None:
    path = tmp_path / "by_hand.yaml"
    path.write_text(
        "smallwheel_model: 1\n"
        "soils:\n  - {name: sand, k: 1.6e6, n: 0.8}\n"  # YAML 1.1 takes 1.6e6 for text
        "effects:\n  - id: bulldozing\n    parameters: {scale: 2}\n"
    )
    model = read_model(path).model
    assert model == Model(Soil("sand", 1.6e6, 0.8)) + effect("bulldozing", scale=2.0)


def test_a_file_is_replaced_whole_or_not_at_all(
    tmp_path: Path, calibrated: CalibratedModel
) -> None:
    path = tmp_path / "model.yaml"
    write_model(path, calibrated)
    before = path.read_bytes()
    broken = CalibratedModel(calibrated.model, provenance={"what": object()})
    with pytest.raises(yaml.YAMLError):
        write_model(path, broken)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["model.yaml"]
    with pytest.raises(OutputError, match=r"the folder .* does not exist"):
        write_model(tmp_path / "none" / "model.yaml", calibrated)


GOOD = """\
smallwheel_model: 1
geometry: contact_integral
soils:
- name: sand
  k: 1600000.0
  n: 0.8
effects:
- id: slip_sinkage
  form: exponential
  parameters:
    a: {value: 1.0, standard_deviation: 0.1, unit: '1'}
covariance:
  names: [sand.n, slip_sinkage.a]
  matrix: [[0.01, 0.001], [0.001, 0.02]]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("smallwheel_model: 1", "smallwheel_model: 2", "smallwheel_model: found 2, expected vers"),
        ("smallwheel_model: 1", "other: 1", "not a model file: it has no key smallwheel_model"),
        ("geometry: contact", "geometri: contact", "geometri: unknown key; did you mean 'geometr"),
        ("contact_integral", "contact", "geometry: found 'contact', expected one of contact_int"),
        ("k: 1600000.0", "k: many", r"soils\[0\].k: found 'many', expected a finite number"),
        ("k: 1600000.0", "k: .inf", r"soils\[0\].k: found inf, expected a finite number"),
        ("k: 1600000.0", "k: true", r"soils\[0\].k: found True, expected a finite number"),
        ("k: 1600000.0", "k: -5", r"soils\[0\]: soil 'sand': k is -5.0, expected a pressure over"),
        ("  n: 0.8\n", "", r"soils\[0\].n: found nothing, expected a number"),
        ("- name: sand", "- name: sand\n  phi: 30", r"soils\[0\].phi: unknown key"),
        (
            "- name: sand",
            "- name: sand\n  cohesoin: 300",
            "cohesoin: unknown key; did you mean 'cohes",
        ),
        (
            "- name: sand",
            "- name: sand\n  rim_fricton: 1",
            "unknown key; did you mean 'rim_friction'",
        ),
        ("n: 0.8", "n: 3.0", "soil 'sand': n is 3.0, expected a number between 0 and 3"),
        ("id: slip_sinkage", "id: slip_sinkege", "no effect 'slip_sinkege': did you mean 'slip_s"),
        ("id: slip_sinkage", "id: mine", "your own is given with --effects FILE"),
        ("form: exponential", "form: linaer", "has no form 'linaer': expected one of added"),
        ("form: exponential", "form: lyasko", "has no form .lyasko.: expected one of "),
        ("value: 1.0", "value: 99", r"effects\[0\]: effect 'slip_sinkage': a is 99.0, expected 0"),
        ("unit: '1'", "unit: m", r"effects\[0\].parameters.a.unit: found 'm', expected '1'"),
        ("    a: {", "    b: {", r"effects\[0\].parameters.b: unknown key"),
        ("names: [sand.n,", "names: [sand.x,", "covariance.names: found 'sand.x', expected one of"),
        ("names: [sand.n,", "names: [slip_sinkage.a,", "found 'slip_sinkage.a' twice"),
        ("[0.01, 0.001]", "[0.01]", r"covariance.matrix\[0\]: found '1 numbers', expected 2 rows"),
        ("[0.01, 0.001]", "[0.01, 0.9]", "covariance.matrix: found 'no covariance'"),
        ("[[0.01, 0.001], [0.001,", "[[0.01, 0.5], [0.5,", "covariance.matrix: found 'no covaria"),
        ("[[0.01, 0.001], [0.001, 0.02]]", "[[-1e-12, 0], [0, 0.02]]", "found 'no covariance'"),
        ("[[0.01, 0.001], [0.001, 0.02]]", "[[0, 1e-10], [1e-10, 0.02]]", "found 'no covariance'"),
        ("[[0.01, 0.001], [0.001, 0.02]]", "[[0.01, 0.001], [0, 0.02]]", "found 'no covariance'"),
        ("[[0.01, 0.001], [0.001, 0.02]]", "[[1e-320, 1e300], [1e300, 1]]", "found 'no covar"),
        ("soils:\n", "soils:\n- {name: sand, k: 1.0e6, n: 1}\n", "soil 'sand' is there twice"),
        ("k: 1600000.0", "k: 0o17", "number '0o17', expected decimal digits"),
        ("k: 1600000.0", "k: '1_6'", r"soils\[0\].k: found '1_6', expected a finite number"),
        ("soils:\n- name: sand", "soils:\n  name: sand", "soils: found .*, expected a list"),
        ("soils:\n- name", "soils: [\n- name", "not YAML text"),
        ("  n: 0.8", "  n: 0.8\n  n: 0.9", "not YAML text: .*key 'n' is there twice"),
        ("- name: sand", "- name: !!python/object:os.system sand", "not YAML text"),
    ],
)
def test_refusals_name_file_and_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(GOOD)
    read_model(path)
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ModelFileError, match=message) as caught:
        read_model(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="cannot be read: No such file"):
        read_model(tmp_path / "none.yaml")
    with pytest.raises(ModelFileError, match="cannot be read: Is a directory"):
        read_model(tmp_path)
    for content in (b"\xff\xfe\x00", b"", b"- 1\n", b"PAR1\x00\x00"):
        path = tmp_path / "other.yaml"
        path.write_bytes(content)
        with pytest.raises(ModelFileError, match=r"not YAML text|not a model file"):
            read_model(path)


def test_an_effect_twice_has_no_names_of_its_own(tmp_path: Path) -> None:
    text = GOOD.replace("covariance:", "- id: slip_sinkage\n  parameters: {a: 2.0}\ncovariance:")
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(ModelFileError, match="effect 'slip_sinkage' is there twice"):
        read_model(tmp_path / "model.yaml")


def test_a_users_effect_must_be_given(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from dataclasses import dataclass\n"
        "from smallwheel_ros.effects import Effect, parameter\n"
        "@dataclass(frozen=True)\n"
        "class Own(Effect):\n"
        "    id = 'own'\n"
        "    a: float = parameter(1.0, (0.0, 2.0), 'size')\n"
        "    def sinkage(self, sinkage, conditions):\n"
        "        return sinkage * (1 + self.a)\n"
    )
    user = load(own)
    made = CalibratedModel(Model(SOILS["dry_sand"]) + user["own"](a=0.5))
    write_model(tmp_path / "model.yaml", made)
    assert read_model(tmp_path / "model.yaml", user).model == made.model
    with pytest.raises(ModelFileError, match="own is given with --effects FILE"):
        read_model(tmp_path / "model.yaml")
