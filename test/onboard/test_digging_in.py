# SPDX-License-Identifier: Apache-2.0
"""The alarm that a wheel digs itself in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from readings import Given as Onboard
from test_onboard import messages_of, settings_of

from smallwheel_ros.estimator.reading import SECOND, Reading
from smallwheel_ros.onboard.settings import DiggingInRules
from smallwheel_ros.onboard.stuck_warning import DiggingInAlarm
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.simulate import DriveSettings, simulate_drive

WHEEL = Wheel("front", 0.25, 0.1)


def reading(time: float, slip: float | None, sinkage: float | None, speed: float | None) -> Reading:
    return Reading(
        WHEEL,
        round(time * SECOND),
        Quantity(60.0, 1.0),
        None if slip is None else Quantity(slip, 0.02),
        None if sinkage is None else Quantity(sinkage, 0.0005),
        speed,
        distance=0.0,
        path=0.0,
    )


def feed(
    alarm: DiggingInAlarm, start: float, rows: Iterable[tuple[float, float, float]]
) -> list[bool]:
    return [alarm.update(reading(start + 0.1 * i, *row)) for i, row in enumerate(rows)]


@pytest.fixture
def alarm() -> DiggingInAlarm:
    """The alarm of a wheel that has driven for a while: 8 mm deep, 0.4 m/s, slip 0.1."""
    made = DiggingInAlarm(DiggingInRules())
    assert not any(feed(made, 0.0, [(0.1, 0.008, 0.4)] * 50))
    return made


def digging(steps: int = 40) -> list[tuple[float, float, float]]:
    """Slip rises to nearly 1, the wheel goes down to 30 mm, the vehicle comes to a halt."""
    share = np.linspace(0.0, 1.0, steps)
    return list(
        zip(
            (0.1 + 0.85 * share).tolist(),
            (0.008 + 0.022 * share).tolist(),
            (0.4 * (1.0 - 0.95 * share)).tolist(),
            strict=True,
        )
    )


class TestAlarm:
    def test_rises_while_there_is_still_something_to_save(self, alarm: DiggingInAlarm) -> None:
        rows = digging()
        answers = feed(alarm, 5.0, rows)
        first = answers.index(True)
        assert all(answers[first:])
        # Slip passes 0.5 at the 19th row; a second later, well before all is over, it is raised.
        assert rows[first][0] == pytest.approx(0.75, abs=0.06)
        assert rows[first][1] < 0.026

    @pytest.mark.parametrize(
        ("name", "rows"),
        [
            ("a slippery patch", [(0.7, 0.009, 0.4)] * 40),
            ("a softer soil", [(0.25, 0.02, 0.2)] * 40),
            ("a slow driver", [(0.1, 0.008, 0.05)] * 40),
            ("slip and sinkage, at full speed", [(0.7, 0.02, 0.4)] * 40),
            ("slip at low speed, not deeper", [(0.7, 0.0085, 0.1)] * 40),
            ("too short", [(0.8, 0.02, 0.1)] * 9),
        ],
    )
    def test_one_or_two_of_the_three_are_not_enough(
        self, alarm: DiggingInAlarm, name: str, rows: list[tuple[float, float, float]]
    ) -> None:
        assert not any(feed(alarm, 5.0, rows)), name

    def test_stays_while_the_wheel_stands_in_its_hole_and_ends_when_it_drives(
        self, alarm: DiggingInAlarm
    ) -> None:
        assert feed(alarm, 5.0, digging())[-1]
        assert alarm.update(reading(10.0, None, 0.03, 0.0))
        assert alarm.update(reading(10.1, 0.45, 0.025, 0.1))
        assert not alarm.update(reading(10.2, 0.15, 0.012, 0.3))

    def test_stuck_from_the_start_is_seen_by_slip_and_sinkage(self) -> None:
        made = DiggingInAlarm(DiggingInRules())
        rows = [(0.95, 0.01 + 0.001 * i, 0.02) for i in range(30)]
        assert feed(made, 0.0, rows)[-1]

    def test_what_is_not_known_changes_nothing(self, alarm: DiggingInAlarm) -> None:
        for row in ((None, 0.03, 0.0), (0.9, None, 0.0), (0.9, 0.03, None)):
            assert not alarm.update(reading(6.0, *row))


@pytest.mark.parametrize("hidden", [(), ("slip_sinkage",)])
@pytest.mark.parametrize("seed", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in (2, 3))])
def test_no_alarm_in_ordinary_drives(hidden: tuple[str, ...], seed: int) -> None:
    """Three soils, slopes and slippery patches, but the rover goes on."""
    drive = simulate_drive(DriveSettings(seed=seed, distance=12.0, hidden=hidden))
    onboard = Onboard(settings_of(drive))
    results = [result for message in messages_of(drive) for result in message.give(onboard)]
    assert len(results) > 500
    assert not any(result.digging_in for result in results)
