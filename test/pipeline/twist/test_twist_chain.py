# SPDX-License-Identifier: Apache-2.0
"""The message in an EKF that takes it as ekf_node of robot_localization documents; real drives with truth.

robot_localization itself is in no registry of Python or Debian that the development environment is made of.
"""

from __future__ import annotations

import numpy as np
import pytest

from rates import twist as bench
from rates._twist_drives import REAL, real, simulated
from rates.twist import TURN, VX, Ekf
from smallwheel_ros.pipeline.twist.twist import messages

GYRO_STD = 0.02
needs_drives = pytest.mark.skipif(
    not REAL.is_dir(), reason=f"the real drives are not in the repository, nor in {REAL}"
)


def test_the_ekf_follows_and_stays_within_its_covariance() -> None:
    inside, errors, raw = [], [], []
    for seed in range(2):
        drive = simulated(seed, slip=0.4, seconds=185.0)
        found, _ = bench.told(drive)
        e, near = bench.gaps(drive, found, None)
        errors += e
        inside += near
        raw += bench.gaps(drive, found, bench.RAW)[1]
    assert len(errors) == 6
    assert sum(inside) >= 4  # of six that are each in it with 0.95: fewer by chance once in 500
    assert sum(raw) < sum(inside)


def test_a_gate_takes_in_our_messages_while_wheels_slip() -> None:
    """twist0_rejection_threshold: what is told too sure is thrown away as soon as it is wrong."""
    drive = simulated(1, slip=0.4, seconds=120.0)
    found, _ = bench.told(drive)
    linear, angular, covariance = messages(found, drive.settings)
    ekf = Ekf(np.zeros(3))
    for i in range(len(found)):
        ekf.predict(0.05)
        ekf.twist(linear[i], angular[i], covariance[i], threshold=3.0)
        ekf.fuse(drive.yaw_rate[i : i + 1], np.array([GYRO_STD**2]), [TURN])
    assert ekf.rejected < 0.01 * len(found)
    assert np.isfinite(ekf.x).all()
    assert abs(ekf.x[VX] - drive.truth[-1, 0]) < 4.0 * np.sqrt(ekf.P[VX, VX])


@needs_drives
@pytest.mark.parametrize(
    ("name", "nees", "rms"),
    [("warthog_grass", (0.03, 2.0), 0.1), ("warthog_sand1", (0.2, 2.0), 0.65)],
)
def test_real_drives_stay_within_their_covariance(
    name: str, nees: tuple[float, float], rms: float
) -> None:
    """On grass it is too careful, against a reach of 0.2: two thirds of that drive stand."""
    drive = real(name)
    found, _ = bench.told(drive)
    use = bench.judged(drive)
    error = (found.vx - drive.truth[:, 0])[use]
    is_nees, _, two, _ = bench.scores(error, found.vx_var[use] + drive.truth_var[use])
    assert nees[0] < is_nees < nees[1]
    assert two >= 0.9
    assert np.sqrt(np.mean(error**2)) < rms
