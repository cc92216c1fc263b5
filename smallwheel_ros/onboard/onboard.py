# SPDX-License-Identifier: Apache-2.0
"""The whole chain from messages to estimates, without ROS: node and replay both are this class.

    onboard = Onboard(settings)
    onboard.add(stamp, [("front_left/load", (61.0,))])        # and so on, in the order of arrival
    for result in onboard.add(stamp, [("front_left/sinkage", (0.011, 1e-6))]):
        print(result.forces, result.soil.n)

Results may come with any message: a measured sinkage waits for what belongs to it (see
`synchroniser`), and each wheel has as many a second as `mobility.rate` says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from smallwheel_ros.estimator.identifiability import before_driving
from smallwheel_ros.onboard.assessment import Assessor
from smallwheel_ros.onboard.instant import Instant
from smallwheel_ros.onboard.result import Result
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.onboard.synchroniser import Reading, Synchroniser


class Onboard(Assessor):
    """Estimates soil and mobility from messages as they arrive.

    What is in a message never raises: what cannot be used is counted and said (`problems`).

    on_result: is given each result as soon as it is there, before the next one is worked out.

    Attributes
    ----------
    received, counts
        How many messages have come, by stream, good and bad; and how many of them could not be
        used, by stream and reason.
    on_result, on_reading
        Are given each result as above, and each instant after that, whether a result was due or not.
    time_jumps
        How often everything was forgotten because time went back.
    """

    def __init__(
        self, settings: OnboardSettings, on_result: Callable[[Result], None] | None = None
    ) -> None:
        self.on_result = on_result
        self.on_reading: Callable[[Instant], None] | None = None
        self._synchroniser = Synchroniser(settings, self._on_time_jump)
        super().__init__(settings, self._synchroniser.problems)
        self.received, self.counts = self._synchroniser.received, self.problems.counts
        self.take_problems = self.problems.take
        self.time_jumps = 0

    def add(self, stamp: int, readings: Iterable[Reading], now: int | None = None) -> list[Result]:
        """Take what was measured at one instant; return what that has made ready, by stamps.

        Parameters
        ----------
        stamp
            When it was measured, ns.
        readings
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
        return self._results(self._synchroniser.add(stamp, readings, now))

    def flush(self) -> list[Result]:
        """Work on everything that waits, with what is there: nothing more will come."""
        return self._results(self._synchroniser.flush())

    def reset(self) -> None:
        """Forget soil and measurements, and begin anew; the counts go on."""
        self._synchroniser.start_over("a reset was asked for")
        super().reset()

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
        super().reset()

    def _results(self, instants: list[Instant]) -> list[Result]:
        results = []
        for instant in instants:
            result = self.assess(instant)
            if result is not None:
                results.append(result)
                if self.on_result is not None:
                    self.on_result(result)
            if self.on_reading is not None and self.latest is not None:
                self.on_reading(self.latest)
        return results
