# SPDX-License-Identifier: Apache-2.0
"""Why a number of the soil is not determined: the limit that is met, and doubts about all of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smallwheel_ros.onboard.prior import SoilPrior
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.pipeline.soil import model as law
from smallwheel_ros.pipeline.soil.identifiability import SoilEstimate, Variety
from smallwheel_ros.pipeline.soil.limits import StateBelief
from smallwheel_ros.pipeline.tables import Array

SIZE = law.WHEELS + 2 * law.EACH
LIMITS = {
    law.ZERO: "sinkage_zero_std",
    law.PASS: "rut",
    law.LOAD_SCALE: "load cells",
    law.SIDE: "left and the right",
    law.SLIP: "slip",
    law.PITCH: "pitch",
    law.DELAY: "delay",
    law.SCALE: "gauge block",
}


def belief(limit: int | None, share: float) -> StateBelief:
    """Numbers of the law that owe this share of their variance to one fault, the rest to the data."""
    covariance = 1e-6 * np.eye(SIZE)
    covariance[:3, :3] = 0.04 * np.eye(3)
    if limit is not None:
        deviation, by = 0.01, np.sqrt(share * 0.04)
        covariance[limit, limit] = deviation**2
        covariance[limit, :3] = covariance[:3, limit] = by * deviation * np.array([1.0, 0.0, 0.0])
    return StateBelief(np.eye(3, SIZE), np.zeros(SIZE), covariance)


@given(st.sampled_from(sorted(LIMITS)), st.floats(0.4, 0.95))
def test_the_fault_that_a_number_owes_its_variance_to_is_named(limit: int, share: float) -> None:
    first, second, third = belief(limit, share).limits(np.eye(3))
    assert LIMITS[limit] in first
    assert (second, third) == ("", "")


@given(st.sampled_from(sorted(LIMITS)), st.floats(0.0, 0.3))
def test_where_no_fault_limits_it_is_the_data(limit: int, share: float) -> None:
    assert belief(limit, share).limits(np.eye(3)) == ["", "", ""]


def test_slip_sinkage_is_reported_from_two_and_a_half_deviations_on() -> None:
    def said(value: float) -> str:
        shown = belief(law.SLIP, 0.1)
        shown.mean[law.SLIP], shown.covariance[law.SLIP, law.SLIP] = value, 0.3**2
        return shown.slip_sinkage

    assert said(0.9) == "sinkage grows with slip, s = 0.9 +- 0.3"
    assert (said(0.7), said(-2.0)) == ("", "")


def estimate(**more: object) -> SoilEstimate:
    """A soil of which all is known but what is said otherwise."""
    prior = SoilPrior.from_soil(soil("dry_sand"))
    made = SoilEstimate(
        1e6, 0.8, 0.4, math.log(20e3), np.diag([0.01, 0.0009, 0.01]), prior.law[1], 0.01, 0.2,
        variety=Variety((0.2, 0.3), (300.0, 900.0)), accepted=19107, outliers=0, soil_changes=0,
        distance=60.0,
    )  # fmt: skip
    return replace(made, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("n", [0.06, 0.1, 2.88])
def test_an_exponent_at_the_end_of_its_range_determines_nothing(n: float) -> None:
    found = estimate(n=n)
    assert not any(found.identifiable)
    (why,) = found.status
    assert "end of its range" in why


@pytest.mark.parametrize(("n", "doubted"), [(0.4, False), (0.1, True)])
def test_an_exponent_that_is_not_known_is_a_doubt_on_the_end_alone(n: float, doubted: bool) -> None:
    wide: Array = np.diag([0.01, 0.06, 0.01])
    found = estimate(n=n, log_covariance=wide)
    assert found.identifiable.reference_pressure is not doubted
    assert ("end of its range" in " ".join(found.status)) is doubted


def test_a_doubt_takes_all_flags_and_is_the_reason() -> None:
    assert all(estimate().identifiable)
    found = estimate(doubt="another soil may have begun")
    assert not any(found.identifiable)
    assert found.status == ("nothing is determined: another soil may have begun",)
    assert all("another soil" in words for words in found.verdicts.values())


def test_the_reason_after_many_readings_is_the_limit() -> None:
    wide: Array = np.diag([0.01, 0.05, 0.15])
    state = belief(law.ZERO, 0.6)
    state.slopes[1, 0], state.slopes[1, 1] = 1.0, 0.0
    found = estimate(log_covariance=wide, state=state)
    about_n = next(words for words in found.status if words.startswith("n not"))
    assert "sinkage_zero_std" in about_n
    assert "19107" not in about_n
    one_load = replace(found, variety=Variety((0.2, 0.3), (300.0, 310.0)))
    assert any("load hardly varied" in words for words in one_load.status)
