# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from readings import Given as Onboard

from smallwheel_ros.estimator.reading import SECOND
from smallwheel_ros.onboard.parameters import settings_from
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.settings import OnboardError, OnboardSettings
from smallwheel_ros.onboard.streams import nanoseconds
from smallwheel_ros.simulate import Drive, DriveSettings, simulate_drive

T = 1_700_000_000 * SECOND


def answer(result: Result) -> tuple[object, ...]:
    """What was measured and predicted, wherever the path began."""
    reading = result.reading
    measured = reading.wheel, reading.stamp, reading.load, reading.slip, reading.sinkage
    said = result.status, result.status_text, result.digging_in, result.risk
    return *measured, *said, result.sinkage_predicted, result.forces


@dataclass(frozen=True)
class Message:
    """One call of `Onboard`, with the time at which the message arrives."""

    arrival: int
    method: str
    stamp: int
    wheel: str | None
    values: tuple[float, ...]

    def give(self, onboard: Onboard, now: bool = False) -> list[Result]:
        wheel = () if self.wheel is None else (self.wheel,)
        clock = self.arrival if now else None
        return getattr(onboard, self.method)(*wheel, self.stamp, *self.values, now=clock)


def messages_of(drive: Drive) -> list[Message]:
    found: list[Message] = []

    def add(method: str, readings: Any, wheel: str | None, *columns: np.ndarray) -> None:
        for stamp, arrival, *values in zip(
            readings.stamp.tolist(), readings.log_time.tolist(), *columns, strict=True
        ):
            found.append(Message(arrival, method, stamp, wheel, tuple(map(float, values))))

    for name, loads in drive.load.items():
        add("on_load", loads, name, loads.normal)
    for name, sinkages in drive.sinkage.items():
        add("on_sinkage", sinkages, name, sinkages.sinkage, sinkages.variance)
    o = drive.odometry
    add("on_odometry", o, None, o.x, o.y, o.forward_speed, o.yaw_rate)
    for j, wheel in enumerate(drive.rover.wheels):
        add("on_wheel_speed", drive.joints, wheel.name, drive.joints.velocity[:, j])
    return sorted(found, key=lambda m: (m.arrival, m.method, m.wheel or ""))


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate_drive(DriveSettings(seed=7, distance=8.0, wheels="two_sizes", terrain="single"))


@pytest.fixture(scope="module")
def messages(drive: Drive) -> list[Message]:
    return messages_of(drive)


def settings_of(drive: Drive, **changes: object) -> OnboardSettings:
    values: dict[str, object] = {"wheels": [wheel.name for wheel in drive.rover.wheels]}
    for wheel in drive.rover.wheels:
        values[f"{wheel.name}.diameter"] = wheel.diameter
        values[f"{wheel.name}.width"] = wheel.width
        values[f"{wheel.name}.lateral_position"] = wheel.y
        values[f"{wheel.name}.longitudinal_position"] = wheel.x
    return settings_from({**values, **changes}).onboard


def run(onboard: Onboard, messages: list[Message], now: bool = False) -> list[Result]:
    found = [result for message in messages for result in message.give(onboard, now)]
    return found + onboard.flush()


def numbers(value: object) -> Iterator[float]:
    """All numbers in a dataclass, and in those in it."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return
    if isinstance(value, (int, float)):
        yield float(value)
    elif isinstance(value, np.ndarray):
        yield from value.ravel().tolist()
    elif is_dataclass(value):
        for field in fields(value):
            yield from numbers(getattr(value, field.name))


@pytest.fixture(scope="module")
def results(drive: Drive, messages: list[Message]) -> list[Result]:
    return run(Onboard(settings_of(drive)), messages)


class TestDrive:
    def test_each_sinkage_is_answered_once_in_order(
        self, drive: Drive, results: list[Result]
    ) -> None:
        for name, readings in drive.sinkage.items():
            stamps = [r.reading.stamp for r in results if r.wheel == name]
            assert stamps == sorted(readings.stamp.tolist())

    def test_all_stamps_rise_over_all_wheels(self, results: list[Result]) -> None:
        stamps = [r.reading.stamp for r in results]
        assert stamps == sorted(stamps)

    def test_every_number_is_finite(self, results: list[Result]) -> None:
        for result in results:
            values = list(numbers(result))
            assert len(values) > 20
            assert np.all(np.isfinite(values))

    def test_finds_what_is_true(self, drive: Drive, results: list[Result]) -> None:
        soil, true = results[-1].soil, drive.stretches[0].soil
        log_pressure = math.log(true.k * 0.01**true.n * 0.2**true.m)
        deviation = math.sqrt(soil.log_covariance[0, 0])
        assert abs(soil.log_reference_pressure - log_pressure) < 3 * deviation
        assert deviation < 0.15
        assert abs(soil.n - true.n) < 3 * math.sqrt(soil.covariance[1, 1])
        assert abs(soil.m - true.m) < 3 * math.sqrt(soil.covariance[2, 2])
        late = results[len(results) // 2 :]
        error = [
            r.reading.sinkage.value - r.sinkage_predicted.value
            for r in late
            if r.status is not Status.REJECTED
        ]
        assert np.sqrt(np.mean(np.square(error))) < 0.0012

    def test_slip_is_the_true_one(self, drive: Drive, results: list[Result]) -> None:
        trip = drive.truth.travel
        checked = 0
        for result in results:
            reading = result.reading
            time = (reading.stamp - drive.sinkage["front_left"].stamp[0]) / SECOND
            time += (drive.sinkage["front_left"].stamp[0] - 1_749_720_600 * SECOND) / SECOND
            if np.interp(time, trip.time, trip.speed) < 0.2:
                continue
            assert reading.slip is not None
            true = np.interp(time, trip.time, drive.truth.slip)
            # 8 mm/s of noise at 0.2 m/s and more, and slip that changes between messages
            assert abs(reading.slip.value - true) < 0.2
            checked += 1
        assert checked > 100

    def test_travel_is_the_true_one(self, results: list[Result]) -> None:
        assert results[-1].soil.distance == pytest.approx(8.0, rel=0.02)

    def test_standing_wheel_has_no_slip_and_says_so(self, results: list[Result]) -> None:
        first = results[0]
        assert first.reading.slip is None
        assert first.status is Status.SLIP_UNKNOWN
        assert "the wheel stands" in first.status_text
        assert first.forces is not None
        assert first.forces.drawbar_pull is None

    def test_order_of_arrival_does_not_matter(
        self, drive: Drive, messages: list[Message], results: list[Result]
    ) -> None:
        rng = np.random.default_rng(3)
        delays = {
            key: rng.uniform(0.0, 0.1)
            for key in sorted({(m.method, m.wheel or "") for m in messages})
        }
        moved = sorted(
            messages, key=lambda m: m.arrival + nanoseconds(delays[m.method, m.wheel or ""])
        )
        assert [m.stamp for m in moved] != [m.stamp for m in messages]
        again = run(Onboard(settings_of(drive)), moved)
        assert len(again) == len(results)
        for one, other in zip(results, again, strict=True):
            assert answer(one) == answer(other)
            assert list(numbers(one.soil)) == list(numbers(other.soil))

    def test_a_busy_node_far_behind_with_loads_loses_nothing(
        self, drive: Drive, messages: list[Message], results: list[Result]
    ) -> None:
        # Loads come in bursts, 0.8 s late, as from a queue that is served too seldom.
        def arrival(m: Message) -> int:
            return m.arrival + nanoseconds(0.8 if m.method == "on_load" else 0.0)

        again = run(Onboard(settings_of(drive)), sorted(messages, key=arrival))
        assert len(again) == len(results)
        for one, other in zip(results, again, strict=True):
            assert answer(one) == answer(other)

    def test_without_waiting_every_sinkage_is_answered_at_once(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        onboard = Onboard(settings_of(drive, **{"timing.reorder_time": 0.0}))
        for message in messages:
            answers = message.give(onboard)
            expected = [message.stamp] if message.method == "on_sinkage" else []
            assert [r.reading.stamp for r in answers] == expected

    def test_a_looping_bag_starts_over(self, drive: Drive, messages: list[Message]) -> None:
        onboard = Onboard(settings_of(drive))
        first = [r for m in messages for r in m.give(onboard)]
        second = [r for m in messages for r in m.give(onboard)]
        assert sum(n for (_, reason), n in onboard.counts.items() if reason == "time_jump") == 1
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            assert answer(one) == answer(other)
            assert list(numbers(one.soil)) == list(numbers(other.soil))
        texts = [p.text for p in onboard.take_problems() if p.reason == "time_jump"]
        assert "time went back by" in texts[0]
        # What waited for its turn when time went back is counted, not just gone.
        dropped = sum(n for (_, why), n in onboard.counts.items() if why == "dropped_by_reset")
        total = sum(len(s.stamp) for s in drive.sinkage.values())
        assert len(first) + dropped == total

    def test_a_clock_that_stands_by_makes_it_late_instead(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        onboard = Onboard(settings_of(drive))
        half = len(messages) // 2
        for message in messages[:half]:
            message.give(onboard, now=True)
        before = onboard.soil.accepted
        now = messages[half].arrival
        old = now - nanoseconds(3.0)
        onboard.on_load("front_left", old, 60.0, now=now)
        assert onboard.counts["front_left/load", "late"] == 1
        assert onboard.soil.accepted == before > 0

    def test_drops_out_of_load_are_named_and_survived(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        start = messages[0].arrival + nanoseconds(4.0)
        end = start + nanoseconds(3.0)

        def kept(m: Message) -> bool:
            return not (m.method == "on_load" and m.wheel == "front_left" and start < m.stamp < end)

        onboard = Onboard(settings_of(drive))
        results = run(onboard, [m for m in messages if kept(m)])
        assert len(results) == sum(len(s.stamp) for s in drive.sinkage.values())
        missing = [r for r in results if r.status is Status.LOAD_MISSING]
        assert {r.wheel for r in missing} == {"front_left"}
        assert 20 < len(missing) == onboard.counts["front_left/sinkage", "load_missing"]
        for result in missing:
            assert result.forces is result.sinkage_predicted is None
            assert result.reading.load is None

    def test_a_wheel_without_sinkage_sensor_is_predicted(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        onboard = Onboard(settings_of(drive, **{"rear_left.sinkage_topic": ""}))
        assert "rear_left/sinkage" not in onboard.streams
        kept = [m for m in messages if (m.method, m.wheel) != ("on_sinkage", "rear_left")]
        results = [r for r in run(onboard, kept) if r.wheel == "rear_left"]
        duration = (messages[-1].stamp - messages[0].stamp) / SECOND
        assert len(results) == pytest.approx(10 * duration, rel=0.2)
        assert all(r.reading.sinkage is None for r in results)
        assert all(r.sinkage_predicted is not None for r in results[5:])
        true = drive.truth
        half = results[len(results) // 2 :]
        time = np.array([r.reading.stamp - 1_749_720_600 * SECOND for r in half]) / SECOND
        expected = np.interp(time, true.travel.time, true.sinkage[:, 2])
        predicted = np.array([r.sinkage_predicted.value for r in half])
        # 6 % scatter of k along the track, on 6 mm
        assert np.sqrt(np.mean((predicted - expected) ** 2)) < 0.1 * np.mean(expected)


class TestBadInput:
    @pytest.fixture
    def onboard(self, drive: Drive) -> Onboard:
        return Onboard(settings_of(drive))

    def text(self, onboard: Onboard, stream: str, reason: str) -> str:
        assert onboard.counts[stream, reason] == 1
        (problem,) = onboard.take_problems()
        assert (problem.stream, problem.reason) == (stream, reason)
        return problem.text

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_not_finite(self, onboard: Onboard, value: float) -> None:
        assert onboard.on_load("front_left", T, value) == []
        assert "load is" in self.text(onboard, "front_left/load", "not_finite")
        assert onboard.on_sinkage("front_left", T, value, 0.0) == []
        assert "sinkage is" in self.text(onboard, "front_left/sinkage", "not_finite")
        assert onboard.on_wheel_speed("front_left", T, value) == []
        assert "wheel speed is" in self.text(onboard, "front_left/wheel_speed", "not_finite")
        assert onboard.on_odometry(T, 0.0, 0.0, value) == []
        assert "speed is" in self.text(onboard, "odom", "not_finite")
        assert onboard.on_odometry(T, value, 0.0, 0.0) == []
        assert onboard.counts["odom", "not_finite"] == 2

    def test_not_plausible(self, onboard: Onboard) -> None:
        onboard.on_load("front_left", T, 1e300)
        assert "1e+300 N" in self.text(onboard, "front_left/load", "not_plausible")

    @pytest.mark.parametrize("value", [0.0, 1e-300, -60.0])
    def test_load_not_positive(self, onboard: Onboard, value: float) -> None:
        onboard.on_load("front_left", T, value)
        text = self.text(onboard, "front_left/load", "load_not_positive")
        assert f"{value:g} N" in text
        assert "load_sign" in text

    def test_a_reading_below_zero_is_one_and_a_wheel_in_the_air_is_not(self, drive: Drive) -> None:
        every = {"timing.reorder_time": 0.0, "mobility.rate": 0.0}
        onboard = Onboard(settings_of(drive, **every))
        for i, sinkage in enumerate((-0.001, -0.2)):
            onboard.on_load("front_left", T + i, 60.0)
            (result,) = onboard.on_sinkage("front_left", T + i, sinkage, 0.0)
            assert result.reading.sinkage.value == sinkage
        assert "-0.2 m" in self.text(onboard, "front_left/sinkage", "sinkage_negative")
        assert onboard.problems.rejected == 1

    @pytest.mark.parametrize("speed", [100.0, 9e8, -100.0])
    def test_an_absurd_speed_is_refused_and_adds_no_path(
        self, onboard: Onboard, speed: float
    ) -> None:
        """As R9: 9e8 m/s were 29,000 km of path."""
        for i in range(100):
            now = speed if i == 50 else 0.3
            onboard.on_odometry(T + i * SECOND // 50, 0.006 * i, 0.0, now)
        text = self.text(onboard, "odom", "not_plausible")
        assert "expected at most 10 (parameter maximum_speed)" in text
        onboard.on_load("front_left", T + 99 * SECOND // 50, 60.0)
        found = onboard.on_sinkage("front_left", T + 99 * SECOND // 50, 0.01)
        (result,) = found + onboard.flush()
        assert result.soil.distance == pytest.approx(0.3 * 99 / 50, rel=0.01)

    def test_stamps(self, onboard: Onboard) -> None:
        onboard.on_load("front_left", 0, 60.0)
        assert "header.stamp is zero" in self.text(onboard, "front_left/load", "stamp_zero")
        onboard.on_load("front_left", T + SECOND, 60.0, now=T)
        assert "1.000 s ahead" in self.text(onboard, "front_left/load", "stamp_in_future")
        onboard.on_load("front_left", T - 9 * SECOND, 60.0, now=T)
        text = self.text(onboard, "front_left/load", "stamp_too_old")
        assert "9.000 s behind the clock" in text
        assert "use_sim_time" in text
        onboard.on_load("front_left", T, 60.0, now=T)
        onboard.on_load("front_left", T, 61.0, now=T)
        assert "came twice" in self.text(onboard, "front_left/load", "duplicate")

    def test_sinkage_twice_or_behind_an_answered_one(self, drive: Drive) -> None:
        onboard = Onboard(settings_of(drive, **{"timing.reorder_time": 0.0}))
        onboard.on_load("front_left", T, 60.0)
        assert len(onboard.on_sinkage("front_left", T, 0.01, 0.0)) == 1
        assert onboard.on_sinkage("front_left", T, 0.01, 0.0) == []
        assert onboard.counts["front_left/sinkage", "duplicate"] == 1
        assert onboard.on_sinkage("front_left", T - nanoseconds(0.1), 0.01, 0.0) == []
        assert onboard.counts["front_left/sinkage", "late"] == 1

    def test_unknown_wheel(self, onboard: Onboard) -> None:
        with pytest.raises(OnboardError, match="no wheel 'middle': the vehicle has front_left"):
            onboard.on_load("middle", T, 60.0)

    @pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
    def test_unknown_variance_is_the_parameter(self, drive: Drive, variance: float) -> None:
        settings = settings_of(drive, **{"timing.reorder_time": 0.0, "noise.sinkage": 0.0023})
        onboard = Onboard(settings)
        onboard.on_load("front_left", T, 60.0)
        (result,) = onboard.on_sinkage("front_left", T, 0.01, variance)
        assert result.reading.sinkage.standard_deviation == 0.0023

    def test_too_heavy_a_load_is_sunk_to_the_axle(self, drive: Drive) -> None:
        onboard = Onboard(settings_of(drive, **{"timing.reorder_time": 0.0}))
        onboard.on_load("front_left", T, 1e8)
        (result,) = onboard.on_sinkage("front_left", T, 0.05, 0.0)
        assert result.status is Status.SUNK_TO_AXLE
        assert result.forces is result.sinkage_predicted is None
        assert np.all(np.isfinite(list(numbers(result))))

    def test_it_goes_on_after_all_that(self, drive: Drive, messages: list[Message]) -> None:
        onboard = Onboard(settings_of(drive))
        clean = run(Onboard(settings_of(drive)), messages)
        results: list[Result] = []
        for i, message in enumerate(messages):
            if i % 7 == 0:
                for value in (math.nan, -1.0, math.inf):
                    results += replace(message, values=(value,) * len(message.values)).give(onboard)
                results += replace(message, stamp=0).give(onboard)
            results += message.give(onboard)
        results += onboard.flush()
        # An odometry of -1 m/s is a number like any other; all else was refused without a trace.
        assert len(results) >= len(clean)
        assert np.all(np.isfinite([n for r in results for n in numbers(r)]))

    def test_many_problems_do_not_fill_the_memory(self, onboard: Onboard) -> None:
        for i in range(3000):
            onboard.on_load("front_left", T + i, -1.0)
        assert onboard.counts["front_left/load", "load_not_positive"] == 3000
        assert len(onboard.take_problems()) == 1000
        assert onboard.take_problems() == []


class TestClocks:
    """Without a clock one corrupt stamp must not wipe what was learnt (R9)."""

    def half(self, drive: Drive, messages: list[Message]) -> tuple[Onboard, list[Message]]:
        onboard, half = Onboard(settings_of(drive)), len(messages) // 2
        run(onboard, messages[:half])
        assert onboard.soil.accepted > 100
        return onboard, messages[half:]

    @pytest.mark.parametrize("ahead", [3600.0, -3600.0])
    def test_one_corrupt_stamp_is_counted_and_changes_nothing(
        self, drive: Drive, messages: list[Message], ahead: float
    ) -> None:
        onboard, rest = self.half(drive, messages)
        accepted = onboard.soil.accepted
        stamp = rest[0].stamp + nanoseconds(ahead)
        assert onboard.on_load("front_left", stamp, 60.0) == []
        reason = "stamp_in_future" if ahead > 0 else "late"
        assert onboard.counts["front_left/load", reason] == 1
        assert onboard.time_jumps == 0
        run(onboard, rest)
        assert onboard.time_jumps == 0
        assert onboard.soil.accepted > accepted + 100

    def test_a_second_one_that_agrees_is_believed(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        onboard, rest = self.half(drive, messages)
        for i in range(2):
            back = rest[i].stamp - 3600 * SECOND
            onboard.on_load("front_left", back, 60.0)
        assert onboard.time_jumps == 1
        assert onboard.soil.accepted == 0


def test_path_of_a_wheel_counts_on_the_spot() -> None:
    """Turning on the spot the vehicle travels nothing, its wheels do (R5)."""
    values = {"wheels": ["left"], "left.diameter": 0.25, "left.width": 0.1}
    onboard = Onboard(settings_from({**values, "left.lateral_position": 0.3}).onboard)
    rng = np.random.default_rng(1)
    results = []
    for i in range(600):
        stamp = T + i * SECOND // 50
        onboard.on_odometry(stamp, 0.0, 0.0, 0.0, 0.8)
        onboard.on_wheel_speed("left", stamp, -0.24 / 0.125)
        onboard.on_load("left", stamp, 60.0)
        results += onboard.on_sinkage("left", stamp, 0.01 + 5e-4 * float(rng.standard_normal()))
    last = (results + onboard.flush())[-1]
    assert last.soil.distance == 0.0
    # 0.24 m/s for 12 s: 13 stretches of 0.2 m, of which at most eight wait.
    assert last.soil.accepted > 4 * 40
    assert onboard.problems.rejected < 6
    assert last.reading.slip.value == pytest.approx(0.0, abs=1e-6)


def test_odometry_that_was_away_for_long_does_not_stop_the_path() -> None:
    values = {"wheels": ["left"], "left.diameter": 0.25, "left.width": 0.1}
    onboard = Onboard(settings_from(values).onboard)
    distances = []
    for i in range(400):
        away = 10 * SECOND if i >= 200 else 0
        stamp, x = T + i * SECOND // 20 + away, 0.02 * i + (4.0 if away else 0.0)
        onboard.on_odometry(stamp, x, 0.0, 0.4)
        onboard.on_wheel_speed("left", stamp, 0.4 / 0.125)
        onboard.on_load("left", stamp, 60.0)
        distances += [r.soil.distance for r in onboard.on_sinkage("left", stamp, 0.01, 1e-6)]
    distances += [result.soil.distance for result in onboard.flush()]
    assert distances[-1] == pytest.approx(12.0, rel=0.02)


class TestRate:
    def test_estimates_at_a_rate_say_what_those_of_every_reading_do(
        self, drive: Drive, messages: list[Message]
    ) -> None:
        everything = run(Onboard(settings_of(drive, **{"mobility.rate": 0.0})), messages)
        all_of_them = {(result.wheel, result.reading.stamp): result for result in everything}
        some = run(Onboard(settings_of(drive, **{"mobility.rate": 2.0})), messages)
        for result in some:
            same = all_of_them[result.wheel, result.reading.stamp]
            assert result.status_text == same.status_text
            assert list(numbers(result)) == pytest.approx(list(numbers(same)), rel=1e-9, abs=1e-12)
        for wheel in drive.sinkage:
            stamps = np.array([r.reading.stamp for r in some if r.wheel == wheel]) / SECOND
            assert np.diff(stamps).min() >= 0.25  # half a period of slack
            assert len(stamps) == pytest.approx(2.0 * np.ptp(stamps), abs=3)

    def test_a_sensor_of_the_rate_itself_loses_none_by_its_jitter(self) -> None:
        values = {"wheels": ["w"], "w.diameter": 0.116, "w.width": 0.05, "w.contact": "pressed"}
        onboard = Onboard(settings_from(values | {"mobility.rate": 10.0}).onboard)
        rng, results = np.random.default_rng(5), []
        for i in range(1, 200):
            stamp = T + nanoseconds(0.1 * i + rng.uniform(-0.02, 0.02))
            onboard.on_load("w", stamp, 5.0 * i)
            results += onboard.on_sinkage("w", stamp, 1e-4 * i, 1e-8)
        assert len(results) == 199


class TestPressed:
    def test_needs_neither_odometry_nor_wheel_speed(self) -> None:
        values = {"wheels": ["w"], "w.diameter": 0.116, "w.width": 0.05, "w.contact": "pressed"}
        onboard = Onboard(settings_from(values | {"mobility.rate": 0.0}).onboard)
        assert onboard.streams == ("w/load", "w/sinkage")
        results = []
        for i in range(1, 100):
            stamp = T + i * nanoseconds(0.05)
            depth = 0.0003 * i
            onboard.on_load("w", stamp, 200.0 * depth / 0.01)
            results += onboard.on_sinkage("w", stamp, depth, 1e-8)
        assert len(results) == 99
        last = results[-1]
        assert last.soil.accepted > 10
        # new soil is met by going deeper: that is the travel
        assert last.soil.distance == pytest.approx(0.0003 * 99)
        assert last.reading.slip is None
        assert last.status is not Status.SLIP_UNKNOWN
        assert last.forces.compaction_resistance.value == 0.0
