# SPDX-License-Identifier: Apache-2.0
"""The pipeline's filter on the recorded trial of a real rig, beside direct fits of it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from press_trial import Recorded, direct_fits, recorded_trial

from smallwheel_ros.onboard.parameters import read_parameters, settings_from
from smallwheel_ros.pipeline.pipeline import Pipeline


@pytest.fixture(scope="module")
def recorded(shared_data: Path, repository: Path) -> Recorded:
    return recorded_trial(repository, shared_data / "cmu_wheel_rig" / "raw")


def test_reads(recorded: Recorded) -> None:
    assert 1300 < len(recorded.load) < 1400
    assert len(recorded.sinkage) == 668
    assert recorded.load.max() == pytest.approx(303.5, abs=0.5)
    assert recorded.sinkage.max() == pytest.approx(0.0408, abs=1e-4)


def test_pressed_wheel_agrees_with_direct_fits(recorded: Recorded, repository: Path) -> None:
    settings = settings_from(read_parameters(repository / "config" / "press_rig.yaml"))
    pipeline = Pipeline(settings.onboard)
    loads = zip(recorded.load_time, recorded.load, strict=True)
    depths = zip(recorded.sinkage_time, recorded.sinkage, strict=True)
    events = [(int(t), "wheel/load", (float(w),)) for t, w in loads]
    events += [(int(t), "wheel/sinkage", (float(z), 0.0)) for t, z in depths]
    for stamp, name, values in sorted(events):
        pipeline.streams.add(name, stamp, values)
    for _ in pipeline.turns(last=True):
        pass
    soil = pipeline.soil
    assert soil.accepted > 600
    fits = direct_fits(recorded)
    # A fit of all at once, with correlated scatter but a zero that is taken for exact: the filter
    # allows for a zero that is off, so it is less sure, and not further off than it says.
    direct = fits["correlated scatter and prior"]
    deviation = math.sqrt(soil.covariance[1, 1])
    assert deviation > math.sqrt(direct.covariance[1, 1])
    assert soil.n == pytest.approx(direct.x[1], abs=deviation)
    log_pressure = math.log(soil.reference_pressure)
    deviation = math.sqrt(soil.log_covariance[0, 0])
    assert deviation > math.sqrt(direct.covariance[0, 0])
    assert log_pressure == pytest.approx(direct.x[0], abs=deviation)
    # Fits that take each sample for an independent one differ by many of their own standard
    # deviations, since the law does not hold along the whole curve: the filter's n must be between. Its
    # pressure may be over both, by a zero that it takes for free and they do not.
    shallow, deep = fits["least squares in ln load"], fits["least squares in sinkage"]
    assert shallow.x[1] < soil.n < deep.x[1]
    assert deep.x[0] < log_pressure
