# SPDX-License-Identifier: Apache-2.0
"""One wheel at one instant: update the soil by its sinkage, and say what the wheel can do.

Every reading tells of the soil, of the strength and of the risk. What is said of a wheel, its sinkage and
forces with their deviations, is worked out where it is due: `mobility.rate` times a second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.path_steps import PathStep, PathSteps, RollingContact, WheelSample
from smallwheel_ros.estimator.slip_tests import SlipTest, best
from smallwheel_ros.estimator.soil_estimator import (
    Outcome,
    SinkageMeasurement,
    SoilEstimator,
    UpdateResult,
)
from smallwheel_ros.estimator.traction import StrengthEstimate, TractionEstimator
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.level import Level
from smallwheel_ros.onboard.load_watch import LoadWatch
from smallwheel_ros.onboard.mobility import WheelForces, wheel_forces, wheel_margin
from smallwheel_ros.onboard.motion_watch import MotionWatch
from smallwheel_ros.onboard.odometry_watch import OdometryWatch
from smallwheel_ros.onboard.passes import PassCounter
from smallwheel_ros.onboard.problems import ProblemLog
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.slip_warning import SlipWarning
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.onboard.stuck_warning import STALE, StuckWarning
from smallwheel_ros.onboard.watches import DiggingInAlarm, FilterHealth
from smallwheel_ros.onboard.wheel_on_soil import (
    ContactReading,
    WheelOnSoil,
    mean_contact,
    wheel_on_soil,
)
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity

_SLOW = 0.05  # m/s: where slip is not known at such a speed, it is because of the speed


class Assessor:
    """The estimator together with what it is asked: one step per instant.

    Attributes
    ----------
    problems
        What could not be used.
    latest
        The newest instant as it was used: with what is known of way and passes, without a slip that is none.
    estimator, traction, stuck, health
        What is believed of the law and the sensors, of the strength, of the risk, and whether the
        filter's innovations are as expected; others after a reset.
    slip_tests
        For each number of the strength that is not determined, the slip test that would tell most of it,
        where that is more than driving on tells (see `look_for_slip_tests`).
    """

    def __init__(self, settings: OnboardSettings, problems: ProblemLog | None = None) -> None:
        self.problems = problems or ProblemLog()
        self.settings = settings
        self._begin()

    def _begin(self) -> None:
        settings = self.settings
        self.estimator = SoilEstimator(
            settings.prior, settings.estimator, settings.effects, settings.wheels
        )
        self.traction = TractionEstimator(settings.strength, settings.wheels, settings.mass)
        self._steps = PathSteps(self._mean_contact)
        self._due: dict[str, float] = {}  # stamps (ns) from which on estimates of wheels are due
        self._loaded: dict[
            str, tuple[Instant, Quantity]
        ] = {}  # newest of each wheel, with its load
        self._soil_number = 0
        self._wheels = {wheel.name: wheel for wheel in settings.wheels}
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
        self.latest: Instant | None = None
        self.slip_tests: tuple[SlipTest, ...] = ()
        self._tried: list[SlipTest] = []
        self._trying: Iterator[list[SlipTest]] = iter(())

    def reset(self) -> None:
        """Forget the soil, and what ordinary driving is like."""
        self._begin()

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

    def assess(self, instant: Instant) -> Result | None:
        """Use an instant for soil, strength and warnings; return the wheel's mobility where it is due."""
        if self._odometry is not None:
            instant = self._odometry.add(instant)
            if not self._odometry.shows_slip:
                self.stuck.reset()
        self.latest = instant = self._way(self._motion.add(instant))
        due = self._is_due(instant)
        update = self._update(instant, due)
        self._note(instant, update)
        if self._loads.add(instant) and self._loads.weighing is not None:
            self.estimator.weigh(*self._loads.weighing)
            self.traction.unlisted(self._loads.missing)
        if self._level.add(instant):
            self.traction.level(self._level.zero)
        self.estimator.trusted = not self._loads.interchanged
        load = None if instant.load is None else self._carried(instant, instant.load)
        if load is not None:
            self._loaded[instant.wheel.name] = instant, load
        step = self._step(instant, load)
        digging = self._digging[instant.wheel.name].update(instant)
        if step is not None:
            self._know_margin(instant.wheel.name, instant.stamp)
            self.stuck.take(step, instant, self.settings.reference_slip)
        if self._odometry is not None:
            self.stuck.warning = self._slips.add(instant, self.stuck.risk)
        return self._result(instant, load, update, digging) if due else None

    def _is_due(self, instant: Instant) -> bool:
        """Whether a wheel's mobility is to be said at this instant, by the rate.

        Half a period of slack: a sensor of the rate itself loses none by the jitter of its stamps.
        """
        if self.settings.mobility_rate == 0.0:
            return True
        period = SECOND / self.settings.mobility_rate
        due = self._due.get(instant.wheel.name, -math.inf)
        if instant.stamp < due:
            return False
        self._due[instant.wheel.name] = max(due, instant.stamp - 0.5 * period) + period
        return True

    def _result(
        self, instant: Instant, load: Quantity | None, update: UpdateResult | None, digging: bool
    ) -> Result:
        """What is said of a wheel. load: as it is carried, but for the scale and zero of its cell."""
        soil = self.estimator.estimate()
        predicted: Quantity | None = None
        forces: WheelForces | None = None
        failure = ""
        try:
            if load is not None:
                predicted = self._predicted(instant, load, update)
                on = self._on_soil(instant, load, instant.slip)
                if on is not None and predicted is not None:
                    forces = self._forces(instant, load, on)
        except (SmallwheelError, ArithmeticError, ValueError) as error:
            failure = str(error) or type(error).__name__
        if forces is None:
            predicted = None
        sunk = load is not None and not failure and forces is None
        conditions = self._conditions(instant, soil, update, sunk, failure)
        words = [text for _, text in sorted(conditions, key=lambda condition: -condition[0])]
        if digging:
            words.insert(0, "digs itself in: slip and sinkage are up, speed is down")
        return Result(
            instant=instant,
            status=max((status for status, _ in conditions), default=Status.OK),
            status_text="; ".join(words),
            sinkage_predicted=None if self._law_unknown else predicted,
            forces=forces,
            digging_in=digging,
            risk=self.stuck.risk,
            soil=soil,
            rejected=self.rejected,
            elsewhere=self.estimator.elsewhere(instant.wheel.name),
            slope=self._level.slope,
        )

    def _way(self, instant: Instant) -> Instant:
        """Which way the vehicle goes, and how often wheels have been at this place.

        While wheels turn in both directions, on the spot, it goes as before.
        """
        if not instant.stands and instant.slip is not None:
            self._ways[instant.wheel.name] = instant.forward
            if len(set(self._ways.values())) == 1:
                self._onward = instant.forward
        number = self._passes.number(instant)
        return instant._replace(pass_number=number, onward=self._onward)

    def _update(self, instant: Instant, due: bool) -> UpdateResult | None:
        """Let the estimator use what was measured; None where load or sinkage is missing."""
        load, sinkage = instant.load, instant.sinkage
        if load is None or sinkage is None:
            return None
        way = instant.path - self._looked.get(instant.wheel.name, -math.inf)
        elsewhere = way >= self.settings.estimator.scatter_length
        update = self.estimator.update(
            SinkageMeasurement(
                time=instant.stamp / SECOND,
                wheel=instant.wheel.name,
                sinkage=sinkage.value,
                variance=sinkage.standard_deviation**2,
                load=load.value,
                load_variance=load.standard_deviation**2,
                diameter=instant.wheel.diameter,
                width=instant.wheel.width,
                distance=instant.distance,
                path=instant.path,
                pitch=instant.pitch,
                slip=None if instant.slip is None else instant.slip.value,
                speed=instant.speed,
                contact=instant.wheel.contact,
                forward=instant.onward,
                pass_number=instant.pass_number,
            ),
            judged=due or elsewhere,
        )
        if elsewhere:
            self._looked[instant.wheel.name] = instant.path
        if update.reason == "soil_changed":
            self.health.forget()
        # Before the law is settled they are all of one draw of the soil, and a static load is one draw, too.
        if elsewhere and (instant.load_is_static or self.estimator.is_stuck(instant.wheel.name)):
            elsewhere = False
        self.health.add(update, elsewhere and self.estimator.settled)
        return update

    def _carried(self, instant: Instant, load: Quantity) -> Quantity:
        """The load without the noise of its sensor, where the estimator has learnt that."""
        learnt = self.estimator.load(instant.wheel.name) if instant.sinkage is not None else None
        if learnt is None or instant.load_is_static:
            return load
        return Quantity(learnt[0], learnt[0] * math.sqrt(learnt[1]))

    def _predicted(
        self, instant: Instant, load: Quantity, update: UpdateResult | None
    ) -> Quantity | None:
        """Sinkage as predicted without this measurement; None where sunk to the axle."""
        if (
            update is not None
            and update.predicted_sinkage is not None
            and update.predicted_variance is not None
        ):
            return Quantity(update.predicted_sinkage, math.sqrt(update.predicted_variance))
        prediction = self.estimator.predict(
            load.value,
            instant.wheel.diameter,
            instant.wheel.width,
            slip=None if instant.slip is None else instant.slip.value,
            speed=instant.speed,
            contact=instant.wheel.contact,
            load_variance=load.standard_deviation**2,
            wheel=instant.wheel.name,
        )
        if prediction.sunk_to_axle:
            return None
        return Quantity(prediction.sinkage, prediction.standard_deviation)

    def _on_soil(
        self, instant: Instant, shown: Quantity, slip: Quantity | None
    ) -> WheelOnSoil | None:
        """Put the wheel on its soil, under the load that is shown; None where it is sunk to its axle."""
        effects = self.settings.effects
        soil, load, together = self.estimator.under(instant.wheel.name, shown)
        return wheel_on_soil(
            instant.wheel,
            soil,
            load,
            with_load=together,
            scatter=self.settings.estimator.soil_scatter,
            slip=None if slip is None else slip.value,
            speed=instant.speed,
            effects=effects,
            strength=self.traction.estimate().strength if effects else None,
        )

    def _step(self, instant: Instant, load: Quantity | None) -> PathStep | None:
        """Collect what a wheel does, and let the step of the path that it ends tell of the strength."""
        number = self.estimator.soil_number
        if number != self._soil_number:
            self._soil_number = number
            self._steps.cut()
        if instant.stands or instant.speed is None or instant.rim_speed is None:
            return None
        contact = None
        if load is not None:
            slip = None if instant.slip is None else instant.slip.value
            law = self.estimator.local(instant.wheel.name)
            contact = ContactReading(law, load, slip, instant.speed)
        step = self._steps.add(
            WheelSample(
                instant.wheel.name,
                instant.stamp / SECOND,
                instant.distance,
                Quantity(instant.speed, instant.speed_std),
                Quantity(instant.rim_speed, instant.rim_std),
                contact,
                instant.forward,
                instant.slope_force,
                instant.gained_force,
                instant.torque,
                instant.drawbar_pull,
            )
        )
        if step is not None:
            step = self._motion.compared(step)
            # The other wheels' readings were before this step told of the strength.
            for name in self._loaded:
                self._know_margin(name, instant.stamp)
            self.traction.take(step, number)
        return step

    def _mean_contact(self, name: str, readings: Sequence[ContactReading]) -> RollingContact | None:
        """Mean contact of a wheel over a step of the path."""
        effects = self.settings.effects
        return mean_contact(
            self._wheels[name],
            readings,
            scatter=self.settings.estimator.soil_scatter,
            effects=effects,
            strength=self.traction.estimate().strength if effects else None,
        )

    def _know_margin(self, name: str, now: int) -> None:
        """Work out the margin of a wheel for the risk, from its newest reading. now: stamp, ns."""
        instant, load = self._loaded.get(name, (None, None))
        if instant is None or load is None or now - instant.stamp > STALE:
            return
        if instant.wheel.contact != ROLLING:
            return
        try:
            on = self._on_soil(instant, load, instant.slip)
            if on is not None:
                on = self._at_reference_slip(instant, load, on)
                margin = wheel_margin(on, self.traction, self.settings.reference_slip)
                self.stuck.know(instant, margin)
        except (SmallwheelError, ArithmeticError, ValueError):
            return  # nothing is predicted of this wheel, which its estimate says

    def _forces(self, instant: Instant, shown: Quantity, on: WheelOnSoil) -> WheelForces:
        """Forces of the wheel."""
        return wheel_forces(
            on,
            self.traction,
            instant.slip,
            time=instant.stamp / SECOND,
            torque=instant.torque,
            reference=self._at_reference_slip(instant, shown, on),
            reference_slip=self.settings.reference_slip,
        )

    def _at_reference_slip(
        self, instant: Instant, shown: Quantity, on: WheelOnSoil
    ) -> WheelOnSoil | None:
        """The wheel as it is at the reference slip; on: at the slip of now."""
        if not self.settings.effects:
            return on
        return self._on_soil(instant, shown, Quantity(self.settings.reference_slip, 0.0))

    def _ratio(self, instant: Instant) -> float | None:
        """A sinkage that was refused, over what the soil gives this wheel; None where it gives none."""
        load, sinkage, wheel = instant.load, instant.sinkage, instant.wheel
        if load is None or sinkage is None or not math.isfinite(sinkage.value):
            return None
        try:
            expected = self.estimator.predict(
                load.value, wheel.diameter, wheel.width, contact=wheel.contact
            )
        except SmallwheelError:
            return None
        return abs(sinkage.value) / expected.sinkage if expected.sinkage > 0.0 else None

    def _note(self, instant: Instant, update: UpdateResult | None) -> None:
        """Count what could not be used of a reading, and what could."""
        stream = _stream(instant)
        if update is not None and update.outcome is Outcome.ACCEPTED:
            self.problems.good(stream)
        elif update is not None:
            outlier = update.outcome is Outcome.OUTLIER
            ratio = None if outlier else self._ratio(instant)
            self.problems.add(stream, update.reason, update.message, outlier=outlier, ratio=ratio)
        if instant.load is None:
            gap = self.settings.timing.maximum_gap
            text = f"no usable load within {gap:g} s of its stamp"
            self.problems.add(stream, "load_missing", text)

    def _conditions(
        self,
        instant: Instant,
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
        if instant.slip is None and instant.wheel.contact == ROLLING:
            why = "no odometry or wheel speed near this instant"
            if self._odometry is not None and not self._odometry.shows_slip:
                why = "odometry shows none: it agrees with the wheels wherever they are"
            elif self.settings.velocity == "none":
                why = "odometry comes from the wheels, and there is no velocity_topic"
            elif instant.speed is not None and abs(instant.speed) <= _SLOW:
                why = "the wheel stands"
            found.append((Status.SLIP_UNKNOWN, f"slip unknown ({why}): no thrust, no drawbar pull"))
        if update is not None and update.outcome is not Outcome.ACCEPTED:
            # Whether one that does not fit is left out of the mean is known when its stretch ends.
            what = "does not fit" if update.outcome is Outcome.OUTLIER else "not used"
            found.append((Status.REJECTED, f"measured sinkage {what}: {update.message}"))
        if instant.load is None:
            found.append((Status.LOAD_MISSING, "no load near this instant: nothing is predicted"))
        if failure:
            # A prediction that fails leaves the measurement used all the same.
            self.problems.add(_stream(instant), "numerical", failure, unused=False)
            found.append((Status.LOAD_MISSING, f"nothing is predicted: {failure}"))
        if sunk:
            found.append((Status.SUNK_TO_AXLE, "the soil does not carry this load: sunk to axle"))
        if instant.load_is_static and instant.load is not None:
            text = f"load not measured: {instant.load.value:.3g} N as configured"
            found.append((Status.OK, text))
        return found


def _stream(instant: Instant) -> str:
    """Name of the stream that made an instant."""
    return f"{instant.wheel.name}/{'load' if instant.sinkage is None else 'sinkage'}"
