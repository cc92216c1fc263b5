# SPDX-License-Identifier: Apache-2.0
"""The whole chain from messages to estimates, without ROS: node and replay both are this class.

    onboard = Onboard(settings)
    onboard.add(stamp, [("front_left/load", (61.0,))])        # and so on, in the order of arrival
    for result in onboard.add(stamp, [("front_left/sinkage", (0.011, 1e-6))]):
        print(result.forces, result.soil.n)

Results may come with any message: a measured sinkage waits for what belongs to it (see
`synchroniser`). Every reading tells of the soil, of the strength and of the risk: `assess` is all of it.
What is said of a wheel, its sinkage and forces with their deviations, is worked out where it is due:
`mobility.rate` times a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate, before_driving
from smallwheel_ros.estimator.path_steps import PathStep, PathSteps, Sample
from smallwheel_ros.estimator.reading import SECOND, Outcome, Reading, UpdateResult
from smallwheel_ros.estimator.slip_tests import SlipTest, best
from smallwheel_ros.estimator.soil_estimator import SoilEstimator
from smallwheel_ros.estimator.traction import StrengthEstimate, TractionEstimator
from smallwheel_ros.onboard.ground import PassCounter
from smallwheel_ros.onboard.load_watch import Level, LoadWatch
from smallwheel_ros.onboard.mobility import Mobility, WheelForces
from smallwheel_ros.onboard.motion_watch import MotionWatch, OdometryWatch
from smallwheel_ros.onboard.problems import FilterHealth
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.stuck_warning import STALE, DiggingInAlarm, SlipWarning, StuckWarning
from smallwheel_ros.onboard.synchroniser import Measured, Synchroniser
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity

_SLOW = 0.05  # m/s: where slip is not known at such a speed, it is because of the speed


class Onboard:
    """Estimates soil and mobility from messages as they arrive.

    What is in a message never raises: what cannot be used is counted and said (`problems`).

    Attributes
    ----------
    received, counts
        How many messages have come, by stream, good and bad; and how many of them could not be
        used, by stream and reason.
    on_result, on_reading
        Are given each result as soon as it is there, before the next one is worked out, and each reading
        after that, whether a result was due or not: as it was used, with what is known of way and passes,
        without a slip that is none.
    time_jumps
        How often everything was forgotten because time went back.
    problems
        What could not be used.
    estimator, traction, stuck, health
        What is believed of the law and the sensors, of the strength, of the risk, and whether the
        filter's innovations are as expected; others after a reset.
    slip_tests
        For each number of the strength that is not determined, the slip test that would tell most of it,
        where that is more than driving on tells (see `look_for_slip_tests`).
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.on_result: Callable[[Result], None] | None = None
        self.on_reading: Callable[[Reading], None] | None = None
        self._synchroniser = Synchroniser(settings, self._on_time_jump)
        self.problems = self._synchroniser.problems
        self.received, self.counts = self._synchroniser.received, self.problems.counts
        self.take_problems = self.problems.take
        self.time_jumps = 0
        self._begin()

    def _begin(self) -> None:
        settings = self.settings
        self.estimator = SoilEstimator(
            settings.prior, settings.estimator, settings.effects, settings.wheels
        )
        self.traction = TractionEstimator(settings.strength, settings.wheels, settings.mass)
        self._mobility = Mobility(settings, self.estimator, self.traction)
        self._steps = PathSteps(self._mobility.mean_contacts)
        self._due: dict[str, float] = {}  # stamps (ns) from which on estimates of wheels are due
        # The newest reading of each wheel, with its load.
        self._loaded: dict[str, tuple[Reading, Quantity]] = {}
        self._soil_number = 0
        rolling = [wheel for wheel in settings.wheels if wheel.contact == ROLLING]
        self.stuck = StuckWarning(len(rolling))
        self.health = FilterHealth()
        self._motion = MotionWatch(rolling)
        self._law_unknown = settings.law_unknown
        self._odometry: OdometryWatch | None = None
        if settings.without_soil_sensors:
            self._odometry = OdometryWatch(rolling, settings.standstill_speed)
            self._slips = SlipWarning(len(rolling), settings.reference_slip)
        self._passes = PassCounter(settings.wheels)
        # m, paths of the wheels at the newest look at an innovation.
        self._looked: dict[str, float] = {}
        self._ways: dict[str, bool] = {}
        self._onward = True
        self._level = Level()
        self._loads = LoadWatch(settings.wheels, settings.mass)
        self._digging = {w.name: DiggingInAlarm(settings.digging_in) for w in settings.wheels}
        self.problems.rejected = 0
        self.slip_tests: tuple[SlipTest, ...] = ()
        self._tried: list[SlipTest] = []
        self._trying: Iterator[list[SlipTest]] = iter(())

    # -- in

    def add(self, stamp: int, measured: Iterable[Measured], now: int | None = None) -> list[Result]:
        """Take what was measured at one instant; return what that has made ready, by stamps.

        Parameters
        ----------
        stamp
            When it was measured, ns.
        measured
            Name and values of each stream (see `OnboardSettings.streams`), of a wheel's: load and
            drawbar pull (N), wheel speed (rad/s), torque (N m), or sinkage (m) and its variance
            (m^2), which is not known where it is not over 0. `odom` is a `Motion`; `velocity` is
            speed (m/s), yaw rate (rad/s), and variance of the speed or 0; `imu` the specific force
            of the slope and of all, NaN where not known, and of the slope across
            (m/s^2, positive where the left side is higher).
        now
            What the clock says, ns; None or 0: there is none, and stamps are only compared with
            each other.

        Raises OnboardError for a stream of no wheel of the vehicle.
        """
        return self._results(self._synchroniser.add(stamp, measured, now))

    def flush(self) -> list[Result]:
        """Work on everything that waits, with what is there: nothing more will come."""
        return self._results(self._synchroniser.flush())

    def reset(self) -> None:
        """Forget soil, measurements and what ordinary driving is like; the counts go on."""
        self._synchroniser.start_over("a reset was asked for")
        self._begin()

    def refuse(self, stream: str, reason: str, text: str) -> None:
        """Count a message that came and could not even be given to `add`."""
        self.received[stream] += 1
        self.problems.add(stream, reason, text)

    def _on_time_jump(self) -> None:
        self.time_jumps += 1
        self._begin()

    def _results(self, readings: list[Reading]) -> list[Result]:
        return [one for reading in readings if (one := self.assess(reading)) is not None]

    def save(self, path: Path | str) -> None:
        """Save the soil as it is believed now. Raises EstimatorError where it cannot be."""
        self.estimator.save(path, self.traction.record())

    def restore(self, path: Path | str) -> None:
        """Begin anew from a saved soil.

        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        self.estimator.restore(path, self.traction.restore)
        self.problems.rejected = 0

    # -- the algorithm

    def assess(self, reading: Reading) -> Result | None:
        """Use a reading for soil, strength and warnings; return the wheel's mobility where it is due."""
        # What it is: whether its slip is one, which way it goes, how often this place was rolled over.
        if self._odometry is not None:
            reading = self._odometry.add(reading)
            if not self._odometry.shows_slip:
                self.stuck.reset()
        reading = self._on_its_way(self._motion.add(reading))
        # The soil, by load and sinkage.
        due = self._is_due(reading)
        update = self._update(reading, due)
        self._count(reading, update)
        # All loads against weight and tilt, and the zero of the imu.
        if self._loads.add(reading) and self._loads.weighing is not None:
            self.estimator.weigh(*self._loads.weighing)
            self.traction.unlisted(self._loads.missing)
        if self._level.add(reading):
            self.traction.level(self._level.zero)
        self.estimator.trusted = not self._loads.interchanged
        # The strength, by steps of the path.
        load = None if reading.load is None else self._carried(reading, reading.load)
        if load is not None:
            self._loaded[reading.wheel.name] = reading, load
        step = self._step(reading, load)
        # The warnings.
        digging = self._digging[reading.wheel.name].update(reading)
        if step is not None:
            own = [one for one in self._loaded.values() if one[0].wheel is reading.wheel]
            self._know_margins(own, reading.stamp)
            self.stuck.take(step, reading, self.settings.reference_slip)
        if self._odometry is not None:
            self.stuck.warning = self._slips.add(reading, self.stuck.risk)
        # What is said.
        result = self._result(reading, load, update, digging) if due else None
        if result is not None and self.on_result is not None:
            self.on_result(result)
        if self.on_reading is not None:
            self.on_reading(reading)
        return result

    def _on_its_way(self, reading: Reading) -> Reading:
        """Which way the vehicle goes, and how often wheels have been at this place.

        While wheels turn in both directions, on the spot, it goes as before.
        """
        if not reading.stands and reading.slip is not None:
            self._ways[reading.wheel.name] = reading.forward
            if len(set(self._ways.values())) == 1:
                self._onward = reading.forward
        number = self._passes.number(reading)
        return reading.on_way(number, self._onward)

    def _is_due(self, reading: Reading) -> bool:
        """Whether a wheel's mobility is to be said at this reading, by the rate.

        Half a period of slack: a sensor of the rate itself loses none by the jitter of its stamps.
        """
        if self.settings.mobility_rate == 0.0:
            return True
        period = SECOND / self.settings.mobility_rate
        due = self._due.get(reading.wheel.name, -math.inf)
        if reading.stamp < due:
            return False
        self._due[reading.wheel.name] = max(due, reading.stamp - 0.5 * period) + period
        return True

    def _update(self, reading: Reading, due: bool) -> UpdateResult | None:
        """Let the estimator use what was measured; None where load or sinkage is missing."""
        if reading.load is None or reading.sinkage is None:
            return None
        way = reading.path - self._looked.get(reading.wheel.name, -math.inf)
        elsewhere = way >= self.settings.estimator.scatter_length
        update = self.estimator.update(reading, judged=due or elsewhere)
        if elsewhere:
            self._looked[reading.wheel.name] = reading.path
        if update.reason == "soil_changed":
            self.health.forget()
        # Before the law is settled they are all of one draw of the soil, and a static load is one draw, too.
        if elsewhere and (reading.load_is_static or self.estimator.is_stuck(reading.wheel.name)):
            elsewhere = False
        self.health.add(update, elsewhere and self.estimator.settled)
        return update

    def _carried(self, reading: Reading, load: Quantity) -> Quantity:
        """The load without the noise of its sensor, where the estimator has learnt that."""
        learnt = self.estimator.load(reading.wheel.name) if reading.sinkage is not None else None
        if learnt is None or reading.load_is_static:
            return load
        return Quantity(learnt[0], learnt[0] * math.sqrt(learnt[1]))

    def _ratio(self, reading: Reading) -> float | None:
        """A sinkage that was refused, over what the soil gives this wheel; None where it gives none."""
        load, sinkage, wheel = reading.load, reading.sinkage, reading.wheel
        if load is None or sinkage is None or not math.isfinite(sinkage.value):
            return None
        try:
            expected = self.estimator.predict(
                load.value, wheel.diameter, wheel.width, contact=wheel.contact
            )
        except SmallwheelError:
            return None
        return abs(sinkage.value) / expected.sinkage if expected.sinkage > 0.0 else None

    def _count(self, reading: Reading, update: UpdateResult | None) -> None:
        """Count what could not be used of a reading, and what could."""
        stream = _stream(reading)
        if update is not None and update.outcome is Outcome.ACCEPTED:
            self.problems.good(stream)
        elif update is not None:
            outlier = update.outcome is Outcome.OUTLIER
            ratio = None if outlier else self._ratio(reading)
            self.problems.add(stream, update.reason, update.message, outlier=outlier, ratio=ratio)
        if reading.load is None:
            gap = self.settings.timing.maximum_gap
            text = f"no usable load within {gap:g} s of its stamp"
            self.problems.add(stream, "load_missing", text)

    def _step(self, reading: Reading, load: Quantity | None) -> PathStep | None:
        """Collect what a wheel does, and let the step of the path that it ends tell of the strength."""
        number = self.estimator.soil_number
        if number != self._soil_number:
            self._soil_number = number
            self._steps.cut()
        if reading.stands or reading.speed is None or reading.rim_speed is None:
            return None
        law = self.estimator.local(reading.wheel.name)
        step = self._steps.add(Sample(reading, law, load))
        if step is not None:
            step = self._motion.compared(step)
            # The other wheels' readings were before this step told of the strength.
            self._know_margins(self._loaded.values(), reading.stamp)
            self.traction.take(step, number)
        return step

    def _know_margins(self, loaded: Iterable[tuple[Reading, Quantity]], now: int) -> None:
        """Work out the margins of wheels for the risk, from their newest readings. now: stamp, ns."""
        rolling = [one for one in loaded if one[0].wheel.contact == ROLLING]
        recent = [one for one in rolling if now - one[0].stamp <= STALE]
        if not recent:
            return
        try:
            margins = self._mobility.margins(recent)
        except (SmallwheelError, ArithmeticError, ValueError):
            if len(recent) > 1:
                for one in recent:
                    self._know_margins([one], now)
            return  # nothing is predicted of this wheel, which its estimate says
        for (reading, _), margin in zip(recent, margins, strict=True):
            self.stuck.know(reading, margin)

    # -- what is said

    def _result(
        self, reading: Reading, load: Quantity | None, update: UpdateResult | None, digging: bool
    ) -> Result:
        """What is said of a wheel. load: as it is carried, but for the scale and zero of its cell."""
        soil = self.estimator.estimate()
        predicted: Quantity | None = None
        forces: WheelForces | None = None
        failure = ""
        try:
            if load is not None:
                predicted = self._mobility.sinkage(reading, load, update)
                if predicted is not None:
                    forces = self._mobility.forces(reading, load)
        except (SmallwheelError, ArithmeticError, ValueError) as error:
            failure = str(error) or type(error).__name__
        if forces is None:
            predicted = None
        sunk = load is not None and not failure and forces is None
        conditions = self._conditions(reading, soil, update, sunk, failure)
        words = [text for _, text in sorted(conditions, key=lambda condition: -condition[0])]
        if digging:
            words.insert(0, "digs itself in: slip and sinkage are up, speed is down")
        return Result(
            reading=reading,
            status=max((status for status, _ in conditions), default=Status.OK),
            status_text="; ".join(words),
            sinkage_predicted=None if self._law_unknown else predicted,
            forces=forces,
            digging_in=digging,
            risk=self.stuck.risk,
            soil=soil,
            rejected=self.rejected,
            elsewhere=self.estimator.elsewhere(reading.wheel.name),
            slope=self._level.slope,
        )

    def _conditions(
        self,
        reading: Reading,
        soil: SoilEstimate,
        update: UpdateResult | None,
        sunk: bool,
        failure: str,
    ) -> list[tuple[Status, str]]:
        """All conditions that apply, in words."""
        found: list[tuple[Status, str]] = []
        if soil.accepted == 0:
            words = f"soil not measured yet: {self.settings.prior.soil.name} as configured"
            if self._law_unknown:
                words = "nobody measures sinkage or names the soil: sinkage and resistance unknown"
            found.append((Status.PRIOR_ONLY, words))
        if reading.slip is None and reading.wheel.contact == ROLLING:
            why = "no odometry or wheel speed near this reading"
            if self._odometry is not None and not self._odometry.shows_slip:
                why = "odometry shows none: it agrees with the wheels wherever they are"
            elif self.settings.velocity == "none":
                why = "odometry comes from the wheels, and there is no velocity_topic"
            elif reading.speed is not None and abs(reading.speed) <= _SLOW:
                why = "the wheel stands"
            found.append((Status.SLIP_UNKNOWN, f"slip unknown ({why}): no thrust, no drawbar pull"))
        if update is not None and update.outcome is not Outcome.ACCEPTED:
            # Whether one that does not fit is left out of the mean is known when its stretch ends.
            what = "does not fit" if update.outcome is Outcome.OUTLIER else "not used"
            found.append((Status.REJECTED, f"measured sinkage {what}: {update.message}"))
        if reading.load is None:
            found.append((Status.LOAD_MISSING, "no load near this reading: nothing is predicted"))
        if failure:
            # A prediction that fails leaves the measurement used all the same.
            self.problems.add(_stream(reading), "numerical", failure, unused=False)
            found.append((Status.LOAD_MISSING, f"nothing is predicted: {failure}"))
        if sunk:
            found.append((Status.SUNK_TO_AXLE, "the soil does not carry this load: sunk to axle"))
        if reading.load_is_static and reading.load is not None:
            text = f"load not measured: {reading.load.value:.3g} N as configured"
            found.append((Status.OK, text))
        return found

    @property
    def soil(self) -> SoilEstimate:
        """The soil as it is believed now."""
        return self.estimator.estimate()

    @property
    def rejected(self) -> int:
        """Measured sinkages that were not used for the soil since the start or the last reset."""
        return self.problems.rejected + self.estimator.outliers

    @property
    def strength(self) -> StrengthEstimate:
        """The soil's strength as it is believed now."""
        return self.traction.estimate()

    @property
    def findings(self) -> tuple[str, ...]:
        """What seems wrong with sensors, joints or wheels, in words."""
        watches = self.problems, self._motion, self._loads, self._level, self.estimator
        found = tuple(words for watch in watches for words in watch.findings)
        return found if self._odometry is None else (*self._odometry.findings, *found)

    @property
    def concern(self) -> str:
        """What is wrong with the filter, in words; empty where nothing is."""
        return self.health.concern

    def look_for_slip_tests(self) -> bool:
        """Go on looking for slip tests that tell more than driving on; return whether all are looked at.

        Nobody is told to slip where the vehicle may get stuck.
        """
        found = next(self._trying, None)
        if found is not None:
            self._tried += found
            return False
        self.slip_tests = () if self.stuck.warning else best(self._tried)
        self._tried = []
        self._trying = self.traction.slip_tests(self.settings.reference_slip)
        return True

    def find_slip_tests(self) -> None:
        """Look at all of them in one go, for who answers nobody meanwhile: some hundredths of a second."""
        self._trying = iter(())  # a round that was begun is of a state before this one
        self.look_for_slip_tests()
        while not self.look_for_slip_tests():
            continue

    @property
    def lacking(self) -> dict[str, str]:
        """By source of the strength that is not in use: what it needs, and what it would bring."""
        settings, used = self.settings, self.strength.sources
        found = {}
        if "balance" not in used:
            found["balance"] = (
                "not yet: it needs load and slip of all wheels, and a slope (imu_topic, or odom with"
                " pitch)"
                if settings.mass
                else "vehicle.mass is not given; it would tell friction and the reserve on slopes"
            )
        if "torque" not in used and not settings.with_torque:
            found["torque"] = (
                "<wheel>.torque_source is none; it would tell what each wheel pulls at this moment"
            )
        return found

    @property
    def undeterminable(self) -> tuple[str, ...]:
        """What these wheels cannot determine of the soil wherever they drive, in words."""
        measured = (w for w in self.settings.wheels if w.name not in self.settings.without_sinkage)
        return before_driving(wheel.diameter for wheel in measured)

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of everything that is listened to: `<wheel>/load`, `odom`, ..."""
        return self.settings.streams

    def newest(self, stream: str) -> int | None:
        """Return the newest stamp (ns) of what was kept of a stream; None where there is none."""
        return self._synchroniser.newest(stream)


def _stream(reading: Reading) -> str:
    """Name of the stream that made an reading."""
    return f"{reading.wheel.name}/{'load' if reading.sinkage is None else 'sinkage'}"
