"""The whole chain from messages to estimates, without ROS: node and replay both are this class.

    onboard = Onboard(settings)
    onboard.on_load("front_left", stamp, 61.0)        # and so on, in the order of arrival
    for result in onboard.on_sinkage("front_left", stamp, 0.011, 1e-6):
        print(result.mobility.forces, result.soil.n)

Results may come with any message: a measured sinkage waits for what belongs to it (see `intake`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import SoilEstimate, before_driving
from smallwheel_ros.estimator.missing_effect import MissingEffect
from smallwheel_ros.onboard.arrivals import stream_names
from smallwheel_ros.onboard.assessment import Assessor
from smallwheel_ros.onboard.health import FilterHealth
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.intake import Intake
from smallwheel_ros.onboard.mobility import MobilityEstimate, Status
from smallwheel_ros.onboard.problems import Problem
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.physics.wheel import Quantity

_OF_THE_ESTIMATOR = ("prior", "estimator", "effects")


@dataclass(frozen=True)
class Result:
    """What came of one measurement: the wheel's mobility, and the soil after it.

    soil: the one that a wheel came to last; mobility is that on the wheel's own soil.
    rejected: measured sinkages that were not used for the soil since the start or the last reset.
    place, vehicle, speed, drawbar_pull: of the instant, see `Instant`.
    elsewhere: wheels that are on another soil than this one, just before or after a border.
    """

    mobility: MobilityEstimate
    soil: SoilEstimate
    rejected: int
    place: tuple[float, float] | None = None
    vehicle: tuple[float, float] | None = None
    speed: float | None = None
    elsewhere: tuple[str, ...] = ()
    drawbar_pull: Quantity | None = None


class Onboard:
    """Estimates soil and mobility from messages as they arrive.

    Every `on_` method takes the stamp (ns) of the measurement and, as `now`, what the clock says
    (ns; None or 0: there is no clock, and stamps are only compared with each other). It returns
    what the message has made ready, in the order of stamps. It raises OnboardError for an unknown
    wheel, never for what is in a message: that is counted (`counts`) and said (`take_problems`).

    on_result: is given each result as soon as it is there, before the next one is worked out.
    """

    def __init__(
        self,
        settings: OnboardSettings,
        effects: Sequence[Effect] = (),
        on_result: Callable[[Result], None] | None = None,
    ) -> None:
        self._on_result = on_result
        self.settings = replace(settings, effects=tuple(effects)) if effects else settings
        self._intake = Intake(self.settings)
        self._arrivals = self._intake.arrivals
        self._assessor = Assessor(self.settings)
        self._jumps = 0
        self._refused_before = 0

    def on_load(
        self, wheel: str, stamp: int, load: float, *, now: int | None = None
    ) -> list[Result]:
        """Take the normal load (N, positive when the wheel presses on the soil) of one wheel."""
        return self._results(self._intake.add_load(wheel, stamp, load, now=now))

    def on_drawbar_pull(
        self, wheel: str, stamp: int, pull: float, *, now: int | None = None
    ) -> list[Result]:
        """Take what a wheel pulls the vehicle with (N, positive forward)."""
        return self._results(self._intake.add_drawbar_pull(wheel, stamp, pull, now=now))

    def on_odometry(
        self,
        stamp: int,
        x: float,
        y: float,
        speed: float,
        yaw_rate: float = 0.0,
        yaw: float | None = None,
        *,
        pitch: float = 0.0,
        variances: tuple[float, float] = (0.0, 0.0),
        now: int | None = None,
    ) -> list[Result]:
        """Take position (m), forward speed (m/s), yaw rate (rad/s) and yaw (rad) of the vehicle.

        Without yaw nobody knows where its wheels are: results then have no place. pitch: rad,
        positive nose down. variances: of speed and yaw rate, 0 where not known.
        """
        return self._results(
            self._intake.add_odometry(
                stamp, x, y, speed, yaw_rate, yaw, pitch=pitch, variances=variances, now=now
            )
        )

    def on_velocity(
        self,
        stamp: int,
        speed: float,
        yaw_rate: float = 0.0,
        variance: float = 0.0,
        *,
        now: int | None = None,
    ) -> list[Result]:
        """Take forward speed (m/s) and yaw rate (rad/s) as a sensor of its own measures them.

        A sensor whose yaw rate is always 0 measures none. variance: of the speed, 0: not known.
        """
        return self._results(self._intake.add_velocity(stamp, speed, yaw_rate, variance, now=now))

    def on_wheel_speed(
        self, wheel: str, stamp: int, angular_velocity: float, *, now: int | None = None
    ) -> list[Result]:
        """Take the angular velocity of a wheel (rad/s, positive when it drives forward)."""
        return self.on_wheel_speeds(stamp, [(wheel, angular_velocity)], now=now)

    def on_wheel_speeds(
        self, stamp: int, speeds: Sequence[tuple[str, float]], *, now: int | None = None
    ) -> list[Result]:
        """Take the angular velocities (rad/s) of several wheels, measured at one instant."""
        return self._results(self._intake.add_wheel_speeds(stamp, speeds, now=now))

    def on_sinkage(
        self,
        wheel: str,
        stamp: int,
        sinkage: float,
        variance: float = 0.0,
        *,
        now: int | None = None,
    ) -> list[Result]:
        """Take the measured sinkage of a wheel (m, positive down) and its variance (m^2).

        A variance of 0 or less, or one that is not finite, means that it is not known.
        """
        return self._results(self._intake.add_sinkage(wheel, stamp, sinkage, variance, now=now))

    def flush(self) -> list[Result]:
        """Work on everything that waits, with what is there: nothing more will come."""
        return self._results(self._intake.flush())

    def reset(self) -> None:
        """Forget soil and measurements, and begin anew; the counts go on."""
        self._intake.start_over("a reset was asked for")
        self._forget_soil()

    def apply(self, settings: OnboardSettings) -> bool:
        """Go on with other settings of the same wheels; return whether the soil starts over.

        It does where the prior, the estimator's settings or the effects are others: what was learnt
        under the old ones does not hold under the new. Measurements that wait are dropped.
        """
        before, self.settings = self.settings, settings
        self._intake.apply(settings)
        if all(getattr(before, name) == getattr(settings, name) for name in _OF_THE_ESTIMATOR):
            self._assessor.apply(settings)
            return False
        self._assessor = Assessor(settings)
        self._refused_before = self._arrivals.problems.refused_sinkages
        return True

    def save(self, path: Path | str) -> None:
        """Save the soil as it is believed now. Raises EstimatorError where it cannot be."""
        self._assessor.estimator.save(path)

    def restore(self, path: Path | str) -> None:
        """Begin anew from a saved soil.

        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        self._assessor.estimator.restore(path)
        self._refused_before = self._arrivals.problems.refused_sinkages

    @property
    def soil(self) -> SoilEstimate:
        """The soil as it is believed now."""
        return self._assessor.estimator.estimate()

    @property
    def undeterminable(self) -> tuple[str, ...]:
        """What these wheels cannot determine of the soil wherever they drive, in words."""
        measured = (w for w in self.settings.wheels if w.name not in self.settings.without_sinkage)
        return before_driving(wheel.diameter for wheel in measured)

    @property
    def missing_effect(self) -> MissingEffect | None:
        """What the model misses, as far as the last metres tell; None where nothing shows."""
        return self._assessor.estimator.missing_effect

    @property
    def findings(self) -> tuple[str, ...]:
        """What seems wrong with sensors, joints or wheels, each in words with what to check."""
        return self._assessor.findings

    @property
    def health(self) -> FilterHealth:
        """How well the filter has done lately."""
        return self._assessor.health

    @property
    def rejected(self) -> int:
        """Measured sinkages that were not used for the soil since the start or the last reset."""
        return self._arrivals.problems.refused_sinkages - self._refused_before

    @property
    def time_jumps(self) -> int:
        """How often everything was forgotten because time went back."""
        return self._arrivals.time_jumps

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of everything that is listened to: `<wheel>/load`, `odom`, ..."""
        return stream_names(self.settings)

    @property
    def received(self) -> Counter[str]:
        """How many messages have come, by stream, good and bad."""
        return self._arrivals.received

    @property
    def newest(self) -> dict[str, int]:
        """The newest stamp (ns) of each stream that has had a message."""
        return self._arrivals.newest

    @property
    def counts(self) -> Counter[tuple[str, str]]:
        """How many of them could not be used, by stream and reason."""
        return self._arrivals.problems.counts

    def report(self, stream: str, reason: str, text: str) -> None:
        """Count something that went wrong before a message could come in here."""
        self._arrivals.problems.add(stream, reason, text, unused=False)

    def refuse(self, stream: str, reason: str, text: str) -> None:
        """Count a message that came and could not even be given to one of the `on_` methods."""
        self._arrivals.received[stream] += 1
        self._arrivals.problems.add(stream, reason, text)

    def take_problems(self) -> list[Problem]:
        """What could not be used since the last call, in words; the newest 1000 at most."""
        return self._arrivals.problems.take()

    def _forget_soil(self) -> None:
        self._assessor.reset()
        self._refused_before = self._arrivals.problems.refused_sinkages

    def _results(self, instants: list[Instant]) -> list[Result]:
        if self._jumps != self._arrivals.time_jumps:
            self._jumps = self._arrivals.time_jumps
            self._forget_soil()
        results = []
        for instant in instants:
            results.append(self._result(instant))
            if self._on_result is not None:
                self._on_result(results[-1])
        return results

    def _result(self, instant: Instant) -> Result:
        mobility, soil, elsewhere, problem, pull = self._assessor.assess(instant)
        if pull is not None:
            self._arrivals.problems.add(f"{instant.wheel.name}/drawbar_pull", *pull)
        if problem is not None:
            name = "load" if instant.sinkage is None else "sinkage"
            self._arrivals.problems.add(
                f"{instant.wheel.name}/{name}",
                *problem,
                # A prediction that fails leaves the measurement used all the same.
                unused=problem[0] != "numerical" or mobility.status is Status.REJECTED,
            )
        return Result(
            mobility,
            soil,
            self.rejected,
            instant.place,
            instant.vehicle,
            instant.speed,
            elsewhere,
            instant.drawbar_pull,
        )
