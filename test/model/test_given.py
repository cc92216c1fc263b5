# SPDX-License-Identifier: Apache-2.0
"""What users may give for a model or for effects; numbers that follow from a soil's.

Tests `derived.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smallwheel_ros.common.errors import ArgumentError
from smallwheel_ros.effects.registry import default_registry
from smallwheel_ros.model.derived import derived_numbers
from smallwheel_ros.model.given import effects_of, ids_of, model_of, registry_of
from smallwheel_ros.model.model import CalibratedModel, Model
from smallwheel_ros.physics.conditions import Conditions
from smallwheel_ros.physics.soil import soil


def test_a_model_is_a_file_a_soil_or_its_name(tmp_path: Path) -> None:
    model = Model("dry_sand") + "slip_sinkage"
    saved = model.save(tmp_path / "model.yaml")
    for given in (model, saved, str(saved), CalibratedModel(model)):
        assert model_of(given).model == model
    assert model_of("dry_sand").soils == model_of(soil("dry_sand")).soils == (soil("dry_sand"),)


@pytest.mark.parametrize("given", [3, None, "dry_snad"])
def test_what_is_no_model_is_named(given: object) -> None:
    with pytest.raises(ArgumentError, match="model: "):
        model_of(given)  # type: ignore[arg-type]


def test_effects_are_given_by_id_class_or_object() -> None:
    conditions = Conditions.of(load=60.0, diameter=0.2, width=0.1, slip=0.2)
    (one,) = effects_of("slip_sinkage", conditions)
    assert [e.id for e in effects_of([type(one), one, "slip_sinkage"], conditions)] == [one.id] * 3
    assert ids_of("slip_sinkage", default_registry()) == ("slip_sinkage",)
    assert ids_of(["unknown"], default_registry()) == ("unknown",)
    with pytest.raises(ArgumentError, match="effects: found int"):
        registry_of(3)  # type: ignore[arg-type]


FORM = """
from dataclasses import dataclass
from smallwheel_ros.effects import Effect, parameter

@dataclass(frozen=True)
class Mine(Effect):
    id = "slip_sinkage"
    form = "mine"
    summary = "Digs."
    formula = "z (1 + a i)"
    needs = ("slip",)
    a: float = parameter(0.5, (0.0, 5.0), "growth")

    def sinkage(self, sinkage, conditions):
        return sinkage * (1.0 + self.a * conditions["slip"])
"""


def test_a_file_with_a_form_of_a_known_effect_means_that_form(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(FORM)
    conditions = Conditions.of(load=60.0, diameter=0.2, width=0.1, slip=0.2)
    (one,) = effects_of(str(file), conditions)
    assert (one.id, one.form) == ("slip_sinkage", "mine")
    named = effects_of([str(file), "slip_sinkage/exponential"], conditions)
    assert [e.form for e in named] == ["exponential"]


def test_deviations_of_k_are_those_of_samples() -> None:
    """Samples of (ln p_ref, n, m); k follows from each by p_ref = k z^n D^m."""
    sand = soil("dry_sand")
    names = [f"{sand.name}.{name}" for name in ("log_reference_pressure", "n", "m")]
    spread = np.array([0.01, 0.004, 0.003])
    covariance = np.diag(spread**2)
    (k, _) = derived_numbers(sand, names, covariance)
    off = np.random.default_rng(0).standard_normal((200_000, 3)) * spread
    ln_k = off[:, 0] - off[:, 1] * np.log(0.01) - off[:, 2] * np.log(0.2)
    assert k.std == pytest.approx(sand.k * float(ln_k.std()), rel=0.02)
    (k, _) = derived_numbers(sand, names[1:], covariance[1:, 1:])
    assert k.std is None
