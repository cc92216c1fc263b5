"""How often the diagnosis is right, over seeds of the truth simulator: a sample, and (slow) the rates."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ALONE = (
    "slip_sinkage",
    "bulldozing",
    "penetration_rate",
    "load_dependent_modulus",
    "width_dependent_modulus",
    "multipass",
)


@pytest.fixture(scope="module")
def rates(repository: Path) -> ModuleType:
    path = repository / "benchmarks" / "diagnosis_rates.py"
    spec = importlib.util.spec_from_file_location("diagnosis_rates", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def trials(
    rates: ModuleType, name: str, seeds: range, folder: Path
) -> tuple[set[str], list[Mapping[str, Any]]]:
    case = next(c for c in rates.CASES if c.name == name)
    return case.expected, [rates.trial(case, seed, folder) for seed in seeds]


def wrong_alone(expected: set[str], found: list[Mapping[str, Any]]) -> int:
    return sum(bool(t["named"]) and not set(t["named"]) & expected for t in found)


@pytest.mark.parametrize("name", ["penetration_rate", "width_dependent_modulus"])
def test_a_sample_of_hidden_effects_is_named(rates: ModuleType, name: str, tmp_path: Path) -> None:
    expected, found = trials(rates, name, range(7000, 7004), tmp_path)
    assert sum(set(t["named"]) == expected for t in found) >= 3
    assert wrong_alone(expected, found) == 0


def test_a_sample_without_hidden_effect_is_adequate(rates: ModuleType, tmp_path: Path) -> None:
    _, found = trials(rates, "nothing hidden", range(7000, 7006), tmp_path)
    assert sum(t["verdict"] == "adequate" for t in found) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ALONE, "sinkage_offset"])
def test_a_hidden_effect_is_named_alone(rates: ModuleType, name: str, tmp_path: Path) -> None:
    expected, found = trials(rates, name, range(7100, 7140), tmp_path)
    least = 0.80 if name == "sinkage_offset" else 0.90
    assert sum(set(t["named"]) == expected for t in found) >= least * 40
    assert wrong_alone(expected, found) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("case", ["nothing hidden", "nothing hidden, 10 runs, 10 %"])
def test_nothing_hidden_is_adequate(rates: ModuleType, case: str, tmp_path: Path) -> None:
    _, found = trials(rates, case, range(7100, 7140), tmp_path)
    assert sum(t["verdict"] == "adequate" for t in found) >= 0.95 * 40
    assert sum(bool(t["named"]) for t in found) <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", ["slip_sinkage, slip tied to load", "load_dependent_modulus, slip tied to load"]
)
def test_a_tie_is_never_decided_and_then_broken(
    rates: ModuleType, case: str, tmp_path: Path
) -> None:
    expected, found = trials(rates, case, range(7100, 7120), tmp_path)
    assert not any(t["named"] for t in found)
    assert sum(set(t["then"]["named"]) == expected for t in found) >= 0.95 * 20


@pytest.mark.slow
def test_what_nobody_recorded_gets_no_name(rates: ModuleType, tmp_path: Path) -> None:
    _, found = trials(rates, "unrecorded", range(7100, 7140), tmp_path)
    assert sum(bool(t["named"]) for t in found) <= 2
