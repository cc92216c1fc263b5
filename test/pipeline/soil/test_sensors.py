# SPDX-License-Identifier: Apache-2.0
"""The sum of all loads against the weight, and versions that are forgotten."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smallwheel_ros.pipeline.soil.sensors import Weighed, Weighing
from smallwheel_ros.pipeline.soil.stretches import Stretches
from smallwheel_ros.pipeline.versions import Versions


def stretch(wheel: int, load: float, pitch: float = 0.0) -> Stretches:
    numbers = dict.fromkeys(Stretches.__dataclass_fields__, 0.0) | {"load": load, "pitch": pitch}
    columns = {name: np.array([value]) for name, value in numbers.items()}
    return Stretches(**(columns | {"wheel": np.array([wheel])}))  # type: ignore[arg-type]


def weigh(weighing: Weighing, load: float, rounds: int, pitch: float = 0.0) -> list[Weighed]:
    found = [weighing.add(stretch(i % 4, load, pitch)) for i in range(4 * rounds)]
    return [one for one in found if one is not None]


def test_six_stretches_of_each_wheel_are_one_weighing() -> None:
    weighing = Weighing(4, 20.0)
    assert not weigh(weighing, 50.0, 5)
    (found,) = weigh(weighing, 50.0, 20)
    assert found.loads.tolist() == [50.0] * 4
    assert found.weight == pytest.approx(20.0 * 9.80665)
    assert found.weight_std == pytest.approx(0.02 * found.weight)


def test_a_slope_takes_of_the_weight() -> None:
    (found,) = weigh(Weighing(4, 20.0), 50.0, 6, pitch=0.3)
    assert found.weight == pytest.approx(20.0 * 9.80665 * math.cos(0.3))


def test_loads_and_mass_that_contradict_each_other_are_both_in_doubt() -> None:
    (found,) = weigh(Weighing(4, 20.0), 70.0, 6)
    assert found.weight_std == pytest.approx(found.weight * math.log(280.0 / (20.0 * 9.80665)))


def test_without_a_mass_or_one_of_the_wheels_nothing_is_weighed() -> None:
    assert not weigh(Weighing(4, 0.0), 50.0, 10)
    assert not weigh(Weighing(5, 20.0), 50.0, 10)


def test_versions_keep_their_numbers() -> None:
    versions = Versions("a")
    for name in "bcde":
        versions.append(name)
    versions.forget({1, 2})
    versions.append("f")
    assert (versions.count, versions.newest) == (6, "f")
    assert versions == {1: "b", 2: "c", 4: "e", 5: "f"}
    with pytest.raises(KeyError):
        versions[3]
