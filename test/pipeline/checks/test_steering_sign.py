# SPDX-License-Identifier: Apache-2.0
"""What `steering.py` and `rigid_motion.py` conclude: odometry that steered wheels make, and a wrong sign."""

from __future__ import annotations

import numpy as np
import pytest
from rows_of_drives import FirstStages
from steered_drives import CAR, FOUR, ROVER, SIX_OF_SIX, bend, crab, steered_drive, weave

from smallwheel_ros.common.stamps import SECOND


@pytest.mark.parametrize("odometry", ["wheels", "rims", "axle"])
@pytest.mark.parametrize("wheels", [ROVER, CAR, SIX_OF_SIX], ids=["rover", "car", "six of six"])
def test_odometry_made_of_steered_wheels_is_recognised_within_ten_metres(odometry, wheels) -> None:
    if odometry == "axle" and wheels is SIX_OF_SIX:
        pytest.skip("no axle of it is not steered")
    drive = steered_drive(weave(), wheels, odometry=odometry)
    pipeline, rows, _ = drive.run(kind=FirstStages)
    assert pipeline.made_of_wheels
    lost = rows.stamp[np.isnan(rows.slip) & (rows.stamp > drive.stamps[0] + 5 * SECOND)]
    assert np.interp(lost.min(), drive.stamps, drive.path) < 10.0


@pytest.mark.parametrize(
    ("way", "wheels", "wrong"),
    [
        (weave(), ROVER, ("front_left",)),
        (weave(), ROVER, ("front_left", "front_right", "rear_left", "rear_right")),
        (bend(1.2), CAR, ("front_left", "front_right")),
        (crab(0.5), FOUR, ("rear_right",)),
        (crab(0.5), FOUR, tuple(FOUR)),
    ],
)
def test_a_wrong_sign_is_named_within_twenty_metres(way, wheels, wrong) -> None:
    drive = steered_drive(way, wheels, seconds=40.0, wrong=wrong)
    assert drive.path[-1] < 20.0
    pipeline, rows, _ = drive.run(2 * SECOND, FirstStages)
    said = [text for text in pipeline.findings if "steering_sign" in text]
    assert [set(text.split(":")[0].split(" and ")) for text in said] == [set(wrong)]
    last = rows.stamp > drive.stamps[-1] - 5 * SECOND
    mine = np.isin(rows.wheel, [list(wheels).index(name) for name in wrong])
    assert np.isnan(rows.slip[last & mine]).all()


@pytest.mark.parametrize("wrong", [(), ("front_left",), ("front_left", "front_right")])
def test_small_angles_and_slips_that_differ_hide_no_sign(wrong) -> None:
    """Angles up to 0.15 rad, slips that differ by 0.14; odometry is no witness, the gyro is."""
    drive = steered_drive(
        weave(), FOUR, seconds=60.0, wrong=wrong, slip=0.2, spread=0.14, odometry="wheels"
    )
    pipeline, _, _ = drive.run(2 * SECOND, FirstStages)
    said = [set(t.split(":")[0].split(" and ")) for t in pipeline.findings if "steering_sign" in t]
    assert said == ([set(wrong)] if wrong else [])


def test_on_wheels_that_are_hardly_steered_nothing_is_said() -> None:
    """Within 0.04 rad a zero that is off by 2 degrees is as good a reason as a wrong sign."""
    drive = steered_drive(weave(radius=5.0), FOUR, wrong=("front_left", "front_right"))
    pipeline, _, _ = drive.run(2 * SECOND, FirstStages)
    assert not [text for text in pipeline.findings if "steering_sign" in text]


@pytest.mark.parametrize("seed", range(4))
def test_no_good_steering_is_accused(seed) -> None:
    way, wheels = [(weave(), ROVER), (weave(), CAR), (bend(1.0), SIX_OF_SIX), (crab(0.4), FOUR)][
        seed
    ]
    drive = steered_drive(way, wheels, seed=seed, slip=0.2, spread=0.15, noise=0.01)
    pipeline, _, _ = drive.run(kind=FirstStages)
    assert not [text for text in pipeline.findings if "steer" in text]
