# SPDX-License-Identifier: Apache-2.0
"""From results to the cost of the ground, and how the filter's health is judged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from readings import Given as Onboard
from test_onboard import messages_of, settings_of

from smallwheel_ros.costmap.cost_map import CostMap, CostSettings
from smallwheel_ros.estimator.reading import Reading
from smallwheel_ros.estimator.soil_estimator import (
    Outcome,
    SoilEstimator,
    SoilPrior,
    UpdateResult,
)
from smallwheel_ros.onboard.ground import (
    GroundMapper,
    Spinning,
    margin_before_driving,
    vehicle_margin,
)
from smallwheel_ros.onboard.mobility import WheelForces
from smallwheel_ros.onboard.problems import FilterHealth
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.physics.soil import soil
from smallwheel_ros.physics.wheel import Quantity, Wheel
from smallwheel_ros.simulate import DriveSettings, simulate_drive

NOTHING = Quantity(0.0, 0.0)


def estimate(wheel: str, load: float | None, margin: Quantity | None) -> Result:
    carried = None if load is None else Quantity(load, 1.0)
    return Result(
        reading=Reading(Wheel(wheel, 0.2, 0.1), 1, carried, None, None, None, 0.0, 0.0),
        status=Status.OK,
        status_text="",
        sinkage_predicted=NOTHING,
        forces=WheelForces(NOTHING, NOTHING, NOTHING, NOTHING, None, None, None, margin),
        digging_in=False,
        risk=None,
        soil=SoilEstimator(SoilPrior.from_soil(soil("dry_sand"))).estimate(),
        rejected=0,
        elsewhere=(),
    )


@pytest.fixture(scope="module")
def results() -> list[Result]:
    """Of a drive without place, since the messages of this test have no orientation."""
    drive = simulate_drive(DriveSettings(seed=2, distance=4.0, terrain="single"))
    onboard = Onboard(settings_of(drive))
    return [r for message in messages_of(drive) for r in message.give(onboard)]


class TestVehicle:
    def test_margins_are_weighted_by_load_and_errors_go_together(self) -> None:
        found = vehicle_margin(
            [estimate("a", 30.0, Quantity(0.3, 0.02)), estimate("b", 90.0, Quantity(-0.1, 0.06))]
        )
        assert found.value == pytest.approx(0.0)
        assert found.standard_deviation == pytest.approx(0.05)

    def test_wheels_without_load_or_margin_do_not_count(self) -> None:
        known = estimate("a", 30.0, Quantity(0.3, 0.02))
        unknown = [estimate("b", None, Quantity(0.1, 0.1)), estimate("c", 30.0, None)]
        assert vehicle_margin([known, *unknown]) == Quantity(0.3, 0.02)
        assert vehicle_margin(unknown) is None
        assert vehicle_margin([]) is None


class TestGroundMapper:
    def made(self, results: list[Result], **changes: object) -> np.ndarray | None:
        """Cells of a map on which each result is laid down at x = 0.05 i."""
        cost_map = CostMap(
            CostSettings(size=60.0, spread=0.0, unknown="none"), [Wheel("a", 0.2, 0.1)]
        )
        mapper = GroundMapper(cost_map)
        for i, result in enumerate(results):
            at = {"vehicle": (0.05 * i, 0.0), "heading": 0.0, "distance": 0.05 * i}
            reading = result.reading._replace(**{**at, **changes})
            mapper.add(replace(result, reading=reading), "odom")
        grid = cost_map.grid()
        return None if grid is None else grid.cells

    def test_a_drive_leaves_its_track(self, results: list[Result]) -> None:
        cells = self.made(results[100:300])
        assert (cells >= 0).sum() > 50
        assert cells.max() <= 99

    def test_without_a_place_or_a_frame_there_is_no_map(self, results: list[Result]) -> None:
        assert results[0].reading.place is None
        assert self.made(results, heading=None) is None
        mapper = GroundMapper(CostMap(CostSettings(), [Wheel("a", 0.2, 0.1)]))
        reading = results[0].reading._replace(vehicle=(0.0, 0.0), heading=0.0)
        mapper.add(replace(results[0], reading=reading), "")
        assert mapper.map.grid() is None

    def test_a_soil_that_was_never_measured_costs_what_its_margin_says(
        self, results: list[Result]
    ) -> None:
        """U2: without a sinkage sensor there was no map, in silence."""
        before = [replace(r, soil=replace(r.soil, accepted=0)) for r in results[100:150]]
        margin = vehicle_margin(before[:1])
        cells = self.made(before)
        assert (cells >= 0).sum() > 20
        costs = CostSettings().rules.cost(margin.value, margin.standard_deviation)
        assert abs(np.median(cells[cells >= 0]) - costs) <= 5
        # A prediction alone is no wheel that is stuck.
        sunk = [replace(r, status=Status.SUNK_TO_AXLE, forces=None) for r in before]
        assert self.made(sunk).max() == -1

    def test_what_did_not_fit_is_unknown_and_what_is_stuck_is_lethal(
        self, results: list[Result]
    ) -> None:
        def like(**changes: object) -> np.ndarray:
            some = results[200:220]
            return self.made([replace(r, **changes) for r in some])

        assert like(status=Status.REJECTED).max() == -1
        assert like(status=Status.SUNK_TO_AXLE, forces=None).max() == 100
        assert like(digging_in=True).max() == 100

    @pytest.mark.parametrize(("choice", "steeper"), [("measured", True), ("level", False)])
    def test_the_slope_that_was_measured_there_counts(self, choice: str, steeper: bool) -> None:
        """F13: ground on which the risk is .87 had a cost of 0 to 9."""
        margin = Quantity(0.2, 0.05)

        def cost(slope: float) -> int:
            settings = CostSettings(size=60.0, slope=choice, unknown="none")
            cost_map = CostMap(settings, [Wheel("a", 0.2, 0.1)])
            mapper = GroundMapper(cost_map)
            for i in range(5):
                one = estimate("a", 30.0, margin)
                at = {"vehicle": (0.2 * i, 0.0), "heading": 0.0, "distance": 0.2 * i, "stamp": i}
                reading = one.reading._replace(**at)
                soil_there = replace(one.soil, accepted=9)
                mapper.add(replace(one, reading=reading, slope=slope, soil=soil_there), "odom")
            grid = cost_map.grid()
            return int(grid.cells.max()) if grid is not None else -1

        assert cost(0.0) == 0
        assert cost(0.25) == (84 if steeper else 0)


class TestWithoutSensors:
    """U2: every place that was crossed with a known margin is in the map, whatever is measured."""

    @pytest.mark.parametrize(("sinkage", "loads"), [(False, True), (True, False), (False, False)])
    def test_the_whole_way_is_in_the_map(self, sinkage: bool, loads: bool) -> None:
        drive = simulate_drive(DriveSettings(seed=3, distance=6.0))
        changes: dict[str, object] = {}
        if not loads:
            changes |= {"load.source": "static", "load.mass": drive.rover.mass}
        if not sinkage:
            changes |= {f"{wheel.name}.sinkage_topic": "" for wheel in drive.rover.wheels}
        settings = settings_of(drive, **changes)
        onboard = Onboard(settings)
        cost_map = CostMap(CostSettings(size=60.0, spread=0.0), settings.wheels)
        mapper, crossed = GroundMapper(cost_map), []
        for message in messages_of(drive):
            for result in message.give(onboard):
                reading = result.reading
                if reading.vehicle is None:
                    continue
                mapper.add(replace(result, reading=reading._replace(heading=0.0)), "odom")
                if result.forces is not None and result.forces.margin is not None:
                    crossed.append(reading.vehicle)
        grid = cost_map.grid()
        assert len(crossed) > 100
        assert math.dist(crossed[0], crossed[-1]) > 5.0
        known = [grid.cells[grid.cell(*place)] >= 0 for place in crossed]
        assert all(known), f"{sum(known)} of {len(known)} places are in the map"


class TestBeforeDriving:
    def test_the_prior_is_of_all_wheels_before_any_message(self) -> None:
        drive = simulate_drive(DriveSettings(seed=3, distance=4.0, wheels="two_sizes"))
        settings = settings_of(drive)
        onboard = Onboard(settings)
        first: dict[str, Result] = {}
        for message in messages_of(drive):
            for result in message.give(onboard):
                if result.soil.accepted == 0:
                    first.setdefault(result.wheel, result)
        prior = margin_before_driving(settings)
        told = vehicle_margin(first.values())
        assert len(first) == len(settings.wheels)
        # By the first result alone it was that of one wheel, whichever came first.
        assert prior.value == pytest.approx(told.value, abs=0.02)
        assert prior.standard_deviation == pytest.approx(told.standard_deviation, abs=0.02)

    @pytest.mark.parametrize("mass", [0.0, 12.0, 24.0, 48.0])
    def test_the_load_hardly_matters(self, mass: float) -> None:
        drive = simulate_drive(DriveSettings(seed=3, distance=4.0))
        prior = margin_before_driving(replace(settings_of(drive), mass=mass))
        other = margin_before_driving(replace(settings_of(drive), mass=24.0))
        assert prior.value == pytest.approx(other.value, abs=0.01)

    def test_a_wheel_that_is_pressed_has_none(self) -> None:
        wheel = Wheel("a", 0.2, 0.1, "pressed")
        drive = simulate_drive(DriveSettings(seed=3, distance=4.0))
        assert margin_before_driving(replace(settings_of(drive), wheels=(wheel,))) is None


class TestHealth:
    def made(self, squares: list[float], outliers: int = 0) -> FilterHealth:
        health = FilterHealth()
        for square in squares:
            health.add(
                UpdateResult(Outcome.ACCEPTED, "accepted", "", normalised_innovation_squared=square)
            )
        for _ in range(outliers):
            health.add(
                UpdateResult(Outcome.OUTLIER, "gate", "", normalised_innovation_squared=50.0)
            )
        return health

    def test_right_innovations_are_no_concern(self) -> None:
        rng = np.random.default_rng(4)
        health = self.made((rng.normal(size=200) ** 2).tolist(), outliers=4)
        assert health.concern == ""
        assert health.mean_square == pytest.approx(1.0, abs=0.3)
        assert health.outlier_share == pytest.approx(0.02)

    @pytest.mark.parametrize(
        ("scale", "outliers", "words"),
        [
            (3.0, 0, "larger than they should be"),
            (0.1, 0, "smaller than they should be"),
            (1.0, 80, "do not fit"),
        ],
    )
    def test_concerns(self, scale: float, outliers: int, words: str) -> None:
        rng = np.random.default_rng(4)
        squares = (scale * rng.normal(size=200) ** 2).tolist()
        assert words in self.made(squares, outliers).concern

    def test_a_few_updates_say_nothing_yet(self) -> None:
        assert self.made([9.0] * 20).concern == ""
        health = self.made([9.0] * 100)
        assert health.concern
        health = FilterHealth()
        assert health.concern == ""
        assert health.mean_square is None
        health.add(UpdateResult(Outcome.REFUSED, "not_finite", ""))
        assert health.count == 0
        assert math.isfinite(health.outlier_share)


class TestSpinning:
    def said(self, speeds: dict[str, float], seconds: float, rim: float = 0.3) -> bool:
        """What is said of wheel a at the end; speeds over ground by wheel, m/s, ten a second."""
        spinning, found = Spinning(), False
        for i in range(round(10 * seconds) + 1):
            for wheel, speed in speeds.items():
                reading = estimate(wheel, 30.0, None).reading
                stamp = i * 10**8
                told = spinning.add(reading._replace(stamp=stamp, speed=speed, rim_speed=rim))
                found = told if wheel == "a" else found
        return found

    def test_a_vehicle_that_gets_nowhere_for_a_second_is_stuck(self) -> None:
        assert self.said({"b": 0.03, "a": 0.03}, 1.5)
        assert self.said({"b": -0.01, "a": -0.01}, 1.5, rim=-0.3)
        assert not self.said({"b": 0.03, "a": 0.03}, 0.8)
        assert not self.said({"b": 0.1, "a": 0.1}, 1.5)

    def test_one_wheel_that_spins_is_dragged_along(self) -> None:
        assert not self.said({"b": 0.2, "c": 0.2, "a": 0.03}, 1.5)

    def test_who_stands_is_not_stuck(self) -> None:
        assert not self.said({"b": 0.0, "a": 0.0}, 1.5, rim=0.0)
