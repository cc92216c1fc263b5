# SPDX-License-Identifier: Apache-2.0
"""One wheel at one instant: update the soil by its sinkage, and say what the wheel can do."""

from __future__ import annotations

import math
from pathlib import Path

from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.path_steps import PathStep, PathSteps, WheelSample
from smallwheel_ros.estimator.soil_estimator import (
    Outcome,
    SinkageMeasurement,
    SoilEstimator,
    UpdateResult,
)
from smallwheel_ros.estimator.strength_estimate import StrengthEstimate
from smallwheel_ros.estimator.traction import TractionEstimator
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.mobility import WheelForces, wheel_forces
from smallwheel_ros.onboard.problems import ProblemLog
from smallwheel_ros.onboard.result import Result, Status
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.streams import SECOND
from smallwheel_ros.onboard.stuck_warning import StuckWarning
from smallwheel_ros.onboard.watches import DiggingInAlarm, FilterHealth, JointWatch
from smallwheel_ros.onboard.wheel_on_soil import WheelOnSoil, wheel_on_soil
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity

_OF_THE_ESTIMATE = ("prior", "estimator", "effects", "wheels", "strength", "mass")  # settings
_SLOW = 0.05  # m/s: where slip is not known at such a speed, it is because of the speed


class Assessor:
    """The estimator together with what it is asked: one step per instant.

    Attributes
    ----------
    problems
        What could not be used.
    estimator, traction, stuck, health
        What is believed of the law and the sensors, of the strength, of the risk, and whether the
        filter's innovations are as expected; others after an `apply` that starts over.
    """

    def __init__(self, settings: OnboardSettings, problems: ProblemLog | None = None) -> None:
        self.problems = problems or ProblemLog()
        self._begin(settings)

    def _begin(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.estimator = SoilEstimator(
            settings.prior, settings.estimator, settings.effects, settings.wheels
        )
        self.traction = TractionEstimator(settings.strength, settings.wheels, settings.mass)
        self._steps = PathSteps()
        self._soil_number = 0
        self.stuck = StuckWarning()
        self.health = FilterHealth()
        self._joints = JointWatch()
        self._digging = {w.name: DiggingInAlarm(settings.digging_in) for w in settings.wheels}
        self.problems.rejected = 0

    def apply(self, settings: OnboardSettings) -> bool:
        """Go on with other settings of the same wheels; return whether the soil starts over.

        It does where anything else than the handling of messages is another: what was learnt under
        the old settings does not hold under the new.
        """
        if any(getattr(self.settings, n) != getattr(settings, n) for n in _OF_THE_ESTIMATE):
            self._begin(settings)
            return True
        self.settings = settings
        for alarm in self._digging.values():
            alarm.rules = settings.digging_in
        return False

    def reset(self) -> None:
        """Forget the soil, and what ordinary driving is like."""
        self._begin(self.settings)

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
    def strength(self) -> StrengthEstimate:
        """The soil's strength as it is believed now."""
        return self.traction.estimate()

    @property
    def findings(self) -> tuple[str, ...]:
        """What seems wrong with sensors, joints or wheels, in words."""
        return (*self._joints.findings, *self.estimator.findings)

    def assess(self, instant: Instant) -> Result:
        """Use the measured sinkage, if any, then work out the wheel's mobility."""
        if self._joints.is_mirrored(instant):
            # What it shows is no slip: a wheel does not turn against its travel for metres.
            instant = instant._replace(slip=None)
        name, load = instant.wheel.name, instant.load
        update = self._update(instant)
        soil = own = self.estimator.estimate()
        if soil.soil_changes:
            own = self.estimator.estimate(name)
        predicted: Quantity | None = None
        on: WheelOnSoil | None = None
        forces: WheelForces | None = None
        step: PathStep | None = None
        failure = ""
        try:
            if load is not None:
                carried = self._carried(instant, load)
                predicted = self._predicted(instant, carried, update)
                on = self._on_soil(instant, carried, own, instant.slip)
            step = self._step(instant, on)
            if on is not None and predicted is not None:
                forces = self._forces(instant, on)
        except (SmallwheelError, ArithmeticError, ValueError) as error:
            failure = str(error) or type(error).__name__
        if forces is None:
            predicted = None
        digging = self._digging[name].update(instant)
        self.stuck.know(instant, None if forces is None else forces.margin)
        if step is not None:
            self.stuck.take(step, instant, self.settings.reference_slip)
        sunk = load is not None and not failure and forces is None
        conditions = self._conditions(instant, soil, update, sunk, failure)
        words = [text for _, text in sorted(conditions, key=lambda condition: -condition[0])]
        if digging:
            words.insert(0, "digs itself in: slip and sinkage are up, speed is down")
        return Result(
            instant=instant,
            status=max((status for status, _ in conditions), default=Status.OK),
            status_text="; ".join(words),
            sinkage_predicted=predicted,
            forces=forces,
            digging_in=digging,
            risk=self.stuck.risk,
            soil=soil,
            rejected=self.problems.rejected,
            elsewhere=self.estimator.elsewhere(name),
        )

    def _update(self, instant: Instant) -> UpdateResult | None:
        """Let the estimator use what was measured; None where load or sinkage is missing."""
        load, sinkage = instant.load, instant.sinkage
        if load is None or sinkage is None:
            return None
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
            )
        )
        self.health.add(update)
        return update

    def _carried(self, instant: Instant, load: Quantity) -> Quantity:
        """The load without the noise of its sensor, where the estimator has learnt that."""
        learnt = self.estimator.load(instant.wheel.name) if instant.sinkage is not None else None
        if learnt is None:
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
        self, instant: Instant, load: Quantity, soil: SoilEstimate, slip: Quantity | None
    ) -> WheelOnSoil | None:
        """Put the wheel on its soil; None where it is sunk to its axle."""
        effects = self.settings.effects
        return wheel_on_soil(
            instant.wheel,
            soil,
            load,
            scatter=self.settings.estimator.soil_scatter,
            slip=None if slip is None else slip.value,
            speed=instant.speed,
            effects=effects,
            strength=self.traction.estimate().strength if effects else None,
        )

    def _step(self, instant: Instant, on: WheelOnSoil | None) -> PathStep | None:
        """Collect what a wheel does, and let the step of the path that it ends tell of the strength."""
        number = self.estimator.soil_number
        if number != self._soil_number:
            self._soil_number = number
            self._steps.cut()
        if instant.slip is None or instant.speed is None or instant.rim_speed is None:
            return None
        step = self._steps.add(
            WheelSample(
                instant.wheel.name,
                instant.stamp / SECOND,
                instant.distance,
                Quantity(instant.speed, instant.speed_std),
                Quantity(instant.rim_speed, instant.rim_std),
                None if on is None else on.contact,
                instant.forward,
                instant.slope_force,
                instant.gained_force,
                instant.torque,
                instant.drawbar_pull,
            )
        )
        if step is not None:
            self.traction.take(step, number)
        return step

    def _forces(self, instant: Instant, on: WheelOnSoil) -> WheelForces:
        """Forces of the wheel."""
        slip = Quantity(self.settings.reference_slip, 0.0)
        reference: WheelOnSoil | None = on
        if self.settings.effects:
            reference = self._on_soil(instant, on.load, on.soil, slip)
        return wheel_forces(
            on,
            self.traction,
            instant.slip,
            time=instant.stamp / SECOND,
            torque=instant.torque,
            reference=reference,
            reference_slip=slip.value,
        )

    def _conditions(
        self,
        instant: Instant,
        soil: SoilEstimate,
        update: UpdateResult | None,
        sunk: bool,
        failure: str,
    ) -> list[tuple[Status, str]]:
        """All conditions that apply, in words; what could not be used is noted as a problem, too."""
        found: list[tuple[Status, str]] = []
        stream = f"{instant.wheel.name}/{'load' if instant.sinkage is None else 'sinkage'}"
        if soil.accepted == 0:
            name = self.settings.prior.soil.name
            found.append((Status.PRIOR_ONLY, f"soil not measured yet: {name} as configured"))
        if instant.slip is None and instant.wheel.contact == ROLLING:
            why = "no odometry or wheel speed near this instant"
            if self.settings.velocity == "none":
                why = "odometry comes from the wheels, and there is no velocity_topic"
            elif instant.speed is not None and abs(instant.speed) <= _SLOW:
                why = "the wheel stands"
            found.append((Status.SLIP_UNKNOWN, f"slip unknown ({why}): no thrust, no drawbar pull"))
        if update is not None and update.outcome is not Outcome.ACCEPTED:
            self.problems.add(stream, update.reason, update.message)
            found.append((Status.REJECTED, f"measured sinkage not used: {update.message}"))
        elif failure:
            # A prediction that fails leaves the measurement used all the same.
            self.problems.add(stream, "numerical", failure, unused=False)
        if instant.load is None:
            gap = self.settings.timing.maximum_gap
            text = f"no usable load within {gap:g} s of its stamp"
            self.problems.add(stream, "load_missing", text)
            found.append((Status.LOAD_MISSING, "no load near this instant: nothing is predicted"))
        if failure:
            found.append((Status.LOAD_MISSING, f"nothing is predicted: {failure}"))
        if sunk:
            found.append((Status.SUNK_TO_AXLE, "the soil does not carry this load: sunk to axle"))
        if instant.load_is_static and instant.load is not None:
            text = f"load not measured: {instant.load.value:.3g} N as configured"
            found.append((Status.OK, text))
        return found
