# SPDX-License-Identifier: Apache-2.0
"""Which effects there are: the folder's, a user's file's, an installed package's."""

from __future__ import annotations

import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from smallwheel_ros.effects import registry
from smallwheel_ros.effects.base import EffectError
from smallwheel_ros.effects.registry import (
    covariate,
    default_registry,
    effect,
    effect_class,
    families,
    load_effects,
)
from smallwheel_ros.model.model import Model, predict
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil

WARM = """
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from smallwheel_ros.effects import Effect, parameter

@dataclass(frozen=True)
class Warm(Effect):
    id = "{id}"
    needs = ("temperature",)
    a: float = parameter(0.01, (-0.1, 0.1), "loss of ln k per kelvin", unit="1/K")

    def modulus_factor(self, conditions):
        return np.exp(-self.a * (conditions["temperature"] - 293.0))
"""


FILES = [
    file
    for file in sorted(Path(registry.__file__).parent.glob("*.py"))
    if '    id = "' in file.read_text() and file.stem != "registry"
]


def write(folder: Path, text: str, name: str = "mine.py") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_effects_are_found_without_a_list() -> None:
    assert list(families()) == sorted(families())
    stated = [re.findall(r'^    id = "(\w+)"', file.read_text(), re.MULTILINE) for file in FILES]
    assert {id for ids in stated for id in ids} == set(families())
    # `effects.grouser` is the effect: a file of its name would stand in its place
    assert not {file.stem for file in FILES} & set(families())


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.stem))
def test_a_copy_of_a_file_of_effects_is_a_users_file(tmp_path: Path, file: Path) -> None:
    text = re.sub(r'^    id = "', '    id = "my_', file.read_text(), flags=re.MULTILINE)
    for id, family in load_effects(write(tmp_path, text)).items():
        assert [form.form for form in family] == [
            form.form for form in families()[id.removeprefix("my_")]
        ]


def test_a_users_file(tmp_path: Path) -> None:
    user = load_effects(write(tmp_path, WARM.format(id="warm")))
    made = effect_class("warm", user=user)(a=0.02)
    assert made.form == "warm"
    assert made.stage == "modulus_factor"
    assert made.channels == ("sinkage", "resistance", "drawbar_pull", "torque")
    model = Model(soil("dry_sand")) + made
    at = Conditions.of(60, 0.2, 0.1, temperature=[293.0, 313.0])
    cold, warm = predict(model, at).sinkage
    assert warm / cold > 1.1
    assert "warm" in families(user)
    assert "warm" not in families()  # loading one adds nothing for others


def test_a_users_form_joins_its_family(tmp_path: Path) -> None:
    found = default_registry().with_file(write(tmp_path, WARM.format(id="moisture")))
    assert [form.form for form in found.family("moisture")] == [
        "exponential", "power", "optimum", "warm",
    ]  # fmt: skip


def test_columns_of_any_name() -> None:
    made = effect("covariate:air temperature", a=0.5)
    assert made.needs == ("air temperature",)
    assert type(made) is covariate("air temperature")[0]
    at = Conditions.of(60, 0.2, 0.1, temperature=[270.0, 300.0, 330.0])
    fitted = covariate("temperature")[0].suited_to(at)
    assert dict(vars(fitted)) == {"a": 0.2, "reference": 300.0, "scale": 30.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (WARM.format(id="warm").replace("@dataclass(frozen=True)", ""), r"lacks the line '@datac"),
        (WARM.format(id=""), "defines no effect"),
        (WARM.format(id="covariate:x"), "ids like 'covariate:x' are made for columns"),
        (WARM.format(id="warm").replace("modulus_factor", "modulus"), "overrides no stage"),
        (WARM.format(id="warm") + "\n    b: float = 1.0\n", "'b' is neither a parameter"),
        ("import nothing_of_that_name\n", "line 1: ModuleNotFoundError"),
        ("x = 1\n\ny = 1 / 0\n", "line 3: ZeroDivisionError: division by zero"),
        ("def f(:\n", "line 1: SyntaxError"),
        ("x = 1\n", "defines no effect, expected a class that derives from Effect"),
    ],
)
def test_a_file_that_is_no_effect(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(EffectError, match=message) as caught:
        load_effects(path)
    assert str(caught.value).startswith(str(path))


def test_the_line_is_that_of_the_file_that_was_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file named relative to the folder has a line; a broken module that it imports has another file's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("fails.py").write_text("x = 1\n\ny = 1 / 0\n")
    with pytest.raises(EffectError, match=r"^fails.py, line 3: ZeroDivisionError"):
        load_effects("fails.py")
    Path("broken.py").write_text("x = 1\n\n\ndef f(:\n")
    Path("imports.py").write_text("x = 1\nimport broken\n")
    with pytest.raises(EffectError, match=r"^imports.py, line 2: SyntaxError.*broken.py, line 4"):
        load_effects("imports.py")


def test_files_that_cannot_be_loaded(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match="no such file"):
        load_effects(tmp_path / "none.py")
    with pytest.raises(EffectError, match=r"expected a Python file, \*\.py"):
        load_effects(write(tmp_path, "x = 1", "effects.txt"))


def test_a_form_that_exists_already(tmp_path: Path) -> None:
    text = WARM.format(id="moisture").replace("class Warm", "class Power")
    with pytest.raises(EffectError, match="effect 'moisture' has a form 'power' already"):
        default_registry().with_file(write(tmp_path, text))


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(EffectError, match="no effect 'slip_sinkege': did you mean 'slip_sinkage'"):
        effect("slip_sinkege")
    with pytest.raises(EffectError, match="has no form 'quadratc': did you mean 'quadratic'"):
        effect("slip_sinkage", "quadratc")
    with pytest.raises(EffectError, match=r"has no parameter 'b': expected a$"):
        effect("slip_sinkage", b=1.0)
    with pytest.raises(EffectError, match="'slope', form 'gravity', has no parameter 'a'"):
        effect("slope", a=1.0)
    with pytest.raises(EffectError, match="'covariate:' names no column"):
        default_registry().family("covariate:")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """Pretend that a package with that entry point is installed; the rest is the real thing."""

    def install(value: str) -> None:
        point = EntryPoint("warm", value, registry.PACKAGE)
        monkeypatch.setattr(registry, "entry_points", lambda group: [point])
        default_registry.cache_clear()

    monkeypatch.syspath_prepend(str(tmp_path))
    write(tmp_path, WARM.format(id="warm"), "warm_package.py")
    yield install
    monkeypatch.undo()
    default_registry.cache_clear()


@pytest.mark.parametrize("value", ["warm_package", "warm_package:Warm"])
def test_an_installed_packages_effect(installed, value: str) -> None:  # type: ignore[no-untyped-def]
    installed(value)
    assert families()["warm"][0].__name__ == "Warm"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_package", "entry point 'warm' .* ModuleNotFoundError"),
        ("warm_package:np", "defines no effect"),
        ("warm_package:parameter", "expected a class derived from Effect, or a module"),
    ],
)
def test_an_installed_package_that_fails(installed, value: str, message: str) -> None:  # type: ignore[no-untyped-def]
    installed(value)
    with pytest.raises(EffectError, match=message):
        families()
