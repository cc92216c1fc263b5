"""The whole chain from messages to estimates, without ROS: node and replay both are this class.

    onboard = Onboard(settings)
    onboard.on_load("front_left", stamp, 61.0)        # and so on, in the order of arrival
    for result in onboard.on_sinkage("front_left", stamp, 0.011, 1e-6):
        print(result.mobility.forces, result.soil.n)

Results may come with any message: a measured sinkage waits for what belongs to it (see
`synchroniser`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from smallwheel_ros.estimator.identifiability import SoilEstimate, before_driving
from smallwheel_ros.estimator.strength_estimate import StrengthEstimate
from smallwheel_ros.onboard.assessment import Assessor
from smallwheel_ros.onboard.instant import Instant, Motion
from smallwheel_ros.onboard.mobility import MobilityEstimate, Status
from smallwheel_ros.onboard.settings import ODOMETRY, VELOCITY, OnboardSettings
from smallwheel_ros.onboard.synchroniser import Reading, Synchroniser

_OF_THE_ESTIMATOR = ("prior", "estimator", "effects")


@dataclass(frozen=True)
class Result:
    """What came of the instant of one wheel: its mobility, and the soil after it.

    soil: the one that a wheel came to last; mobility is that on the wheel's own soil.
    rejected: measured sinkages that were not used for the soil since the start or the last reset.
    elsewhere: wheels that are on another soil than this one, just before or after a border.
    """

    instant: Instant
    mobility: MobilityEstimate
    soil: SoilEstimate
    rejected: int
    elsewhere: tuple[str, ...]


class Onboard:
    """Estimates soil and mobility from messages as they arrive.

    `add` and the `on_` methods take the stamp (ns) of the measurement and, as `now`, what the clock
    says (ns; None or 0: there is no clock, and stamps are only compared with each other). They
    return what the message has made ready, in the order of stamps. They raise OnboardError for an
    unknown wheel, never for what is in a message: that is counted and said (`problems`).

    on_result: is given each result as soon as it is there, before the next one is worked out.

    Attributes
    ----------
    received, counts
        How many messages have come, by stream, good and bad; and how many of them could not be
        used, by stream and reason.
    problems
        The same in words.
    assessor
        What is believed of the soil and of the sensors; another one after `apply`.
    time_jumps
        How often everything was forgotten because time went back.
    """

    def __init__(
        self, settings: OnboardSettings, on_result: Callable[[Result], None] | None = None
    ) -> None:
        self.settings, self._on_result = settings, on_result
        self._synchroniser = Synchroniser(settings, self._on_time_jump)
        self.problems, self.received = self._synchroniser.problems, self._synchroniser.received
        self.counts, self.take_problems = self.problems.counts, self.problems.take
        self.assessor = Assessor(settings)
        self.time_jumps = 0

    def add(self, stamp: int, readings: Iterable[Reading], now: int | None = None) -> list[Result]:
        """Take what was measured at one instant, by stream: `("front_left/load", (61.0,))`."""
        return self._results(self._synchroniser.add(stamp, readings, now))

    def on_load(
        self, wheel: str, stamp: int, load: float, *, now: int | None = None
    ) -> list[Result]:
        """Take the normal load (N, positive when the wheel presses on the soil) of one wheel."""
        return self.add(stamp, [(f"{wheel}/load", (load,))], now)

    def on_drawbar_pull(
        self, wheel: str, stamp: int, pull: float, *, now: int | None = None
    ) -> list[Result]:
        """Take what a wheel pulls the vehicle with (N, positive forward)."""
        return self.add(stamp, [(f"{wheel}/drawbar_pull", (pull,))], now)

    def on_wheel_speed(
        self, wheel: str, stamp: int, angular_velocity: float, *, now: int | None = None
    ) -> list[Result]:
        """Take the angular velocity of a wheel (rad/s, positive when it drives forward)."""
        return self.add(stamp, [(f"{wheel}/wheel_speed", (angular_velocity,))], now)

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
        return self.add(stamp, [(f"{wheel}/sinkage", (sinkage, variance))], now)

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
        motion = Motion.of(x, y, speed, yaw_rate, yaw, pitch, variances)
        return self.add(stamp, [(ODOMETRY, motion)], now)

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
        known = variance if 0.0 < variance < math.inf else 0.0
        return self.add(stamp, [(VELOCITY, (speed, yaw_rate, known))], now)

    def flush(self) -> list[Result]:
        """Work on everything that waits, with what is there: nothing more will come."""
        return self._results(self._synchroniser.flush())

    def reset(self) -> None:
        """Forget soil and measurements, and begin anew; the counts go on."""
        self._synchroniser.start_over("a reset was asked for")
        self._forget_soil()

    def apply(self, settings: OnboardSettings) -> bool:
        """Go on with other settings of the same wheels; return whether the soil starts over.

        It does where the prior, the estimator's settings or the effects are others: what was learnt
        under the old ones does not hold under the new. Measurements that wait are dropped.
        """
        before, self.settings = self.settings, settings
        self._synchroniser.apply(settings)
        if all(getattr(before, name) == getattr(settings, name) for name in _OF_THE_ESTIMATOR):
            self.assessor.apply(settings)
            return False
        self.assessor = Assessor(settings)
        self.problems.rejected = 0
        return True

    def save(self, path: Path | str) -> None:
        """Save the soil as it is believed now. Raises EstimatorError where it cannot be."""
        self.assessor.estimator.save(path, self.assessor.traction.record())

    def restore(self, path: Path | str) -> None:
        """Begin anew from a saved soil.

        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        self.assessor.estimator.restore(path, self.assessor.traction.restore)
        self.problems.rejected = 0

    @property
    def soil(self) -> SoilEstimate:
        """The soil as it is believed now."""
        return self.assessor.estimator.estimate()

    @property
    def strength(self) -> StrengthEstimate:
        """The soil's strength as it is believed now."""
        return self.assessor.traction.estimate()

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

    def refuse(self, stream: str, reason: str, text: str) -> None:
        """Count a message that came and could not even be given to `add`."""
        self.received[stream] += 1
        self.problems.add(stream, reason, text)

    def _on_time_jump(self) -> None:
        self.time_jumps += 1
        self._forget_soil()

    def _forget_soil(self) -> None:
        self.assessor.reset()
        self.problems.rejected = 0

    def _results(self, instants: list[Instant]) -> list[Result]:
        results = []
        for instant in instants:
            results.append(self._result(instant))
            if self._on_result is not None:
                self._on_result(results[-1])
        return results

    def _result(self, instant: Instant) -> Result:
        mobility, soil, elsewhere, problem = self.assessor.assess(instant)
        wheel = instant.wheel.name
        if problem is not None:
            stream = f"{wheel}/load" if instant.sinkage is None else f"{wheel}/sinkage"
            # A prediction that fails leaves the measurement used all the same.
            unused = problem[0] != "numerical" or mobility.status is Status.REJECTED
            self.problems.add(stream, *problem, unused=unused)
        return Result(instant, mobility, soil, self.problems.rejected, elsewhere)
