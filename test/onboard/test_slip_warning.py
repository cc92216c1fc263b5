# SPDX-License-Identifier: Apache-2.0
"""The warning before a vehicle gets stuck, by slip alone: ahead of it, and not where nothing comes of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.stuck_warning import SlipWarning
from smallwheel_ros.physics.wheel import Quantity, Wheel

WHEELS = tuple(Wheel(name, 0.25, 0.1) for name in ("a", "b", "c", "d"))
REFERENCE = 0.4


def warned(
    slip: Callable[[float], float | None],
    seconds: float,
    *,
    noise: float = 0.02,
    rim: Callable[[float], float] = lambda _: 0.4,
    spot: bool = False,
    risk: float | None = 0.1,
    seed: int = 1,
) -> list[tuple[float, str]]:
    """Drive at 10 Hz with this slip; return times (s) and words of each reading that is warned of."""
    rng = np.random.default_rng(seed)
    watch, found = SlipWarning(len(WHEELS), REFERENCE), []
    for i in range(int(10.0 * seconds)):
        time, error = 0.1 * i, noise * float(rng.standard_normal())
        for j, wheel in enumerate(WHEELS):
            true = slip(time)
            shown = None if true is None else Quantity(min(true + error, 1.0), noise)
            one = Reading(
                wheel, 10**9 + int(time * SECOND), None, shown, None, 0.3, 0.0, 0.0,
                rim_speed=rim(time), forward=not (spot and j % 2), stands=shown is None,
            )  # fmt: skip
            words = watch.add(one, risk)
        if words:
            found.append((time, words))
    return found


def test_slip_that_grows_is_warned_of_before_it_is_high() -> None:
    found = warned(lambda t: 0.1 + 0.08 * max(t - 10.0, 0.0), 20.0)
    first, words = found[0]
    assert 11.0 < first < 12.8  # of 13.75, when it is at the reference slip
    assert "more and more: the vehicle may get stuck in" in words


def test_a_slip_that_stays_high_is_warned_of() -> None:
    found = warned(lambda _: 0.37, 8.0)
    assert found[-1][0] > 7.5
    assert found[-1][1].endswith("the vehicle may get stuck")


@pytest.mark.parametrize("noise", [0.02, 0.06, 0.1])
def test_noise_alone_is_no_warning(noise: float) -> None:
    metres = 0.0
    found = 0
    for seed in range(5):
        found += len(warned(lambda _: 0.08, 60.0, noise=noise, seed=seed))
        metres += 24.0
    assert found == 0, f"in {metres} m"


def test_a_patch_that_ends_is_no_warning() -> None:
    assert warned(lambda t: 0.18 if 5.0 < t < 8.0 else 0.08, 15.0) == []


def test_who_sets_off_slips_because_of_that() -> None:
    ramp = warned(lambda t: 0.5 if t < 1.0 else 0.05, 4.0, rim=lambda t: 0.1 + min(0.4 * t, 0.3))
    assert ramp == []


def test_turning_on_the_spot_and_standing_are_no_warning() -> None:
    assert warned(lambda _: 0.5, 5.0, spot=True) == []
    assert warned(lambda _: None, 5.0) == []


def test_risk_counts_only_where_slip_is_up() -> None:
    assert warned(lambda _: 0.1, 5.0, risk=0.99) == []
    said = warned(lambda _: 0.25, 5.0, risk=0.99)
    assert "asks for more than they pull" in said[-1][1]
    assert warned(lambda _: 0.25, 5.0, risk=None) == []
