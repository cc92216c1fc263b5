"""Which messages count: their stamps and numbers are judged, counted, and put in words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from smallwheel_ros.onboard.problems import ProblemLog, stamp_problem
from smallwheel_ros.onboard.settings import OnboardSettings, Timing, VelocitySource
from smallwheel_ros.onboard.streams import StampFault, StampRules, nanoseconds
from smallwheel_ros.physics.conditions import ROLLING

ODOMETRY = "odom"
VELOCITY = "velocity"

# In SI units nothing on a vehicle is larger; squares of such numbers still are finite.
_LARGEST = 1e9


def stream_names(settings: OnboardSettings) -> tuple[str, ...]:
    """Names of everything that is listened to: `<wheel>/load`, `odom`, ..."""
    wheels = settings.wheels
    rolling = [w for w in wheels if w.contact == ROLLING]
    own_velocity = rolling and settings.velocity is VelocitySource.TOPIC
    return (
        *(f"{w.name}/load" for w in wheels if w.name not in settings.static_loads),
        *(f"{w.name}/sinkage" for w in wheels if w.name not in settings.without_sinkage),
        *(f"{w.name}/drawbar_pull" for w in wheels if w.name in settings.with_drawbar_pull),
        *(f"{w.name}/wheel_speed" for w in rolling),
        *((ODOMETRY,) if rolling else ()),
        *((VELOCITY,) if own_velocity else ()),
    )


class Arrivals:
    """Judges what comes in, stream by stream; nothing that a message holds raises.

    Attributes
    ----------
    problems
        What could not be used.
    received
        Messages so far, by stream, good and bad.
    newest
        Each stream's newest good stamp, ns.
    time_jumps
        How often time went back.
    first, latest
        Stamps (ns) of the first and of the newest measurement that was kept; latest is None before.

    Parameters
    ----------
    on_time_jump
        Called when time has gone back: what was collected is void.
    """

    def __init__(self, timing: Timing, on_time_jump: Callable[[], None]) -> None:
        self.problems = ProblemLog()
        self.received: Counter[str] = Counter()
        self.newest: dict[str, int] = {}
        self.time_jumps = 0
        self._on_time_jump = on_time_jump
        self.apply(timing)
        self.start_over()

    def apply(self, timing: Timing) -> None:
        """Judge by other rules from now on."""
        self._timing = timing
        self._rules = StampRules(
            nanoseconds(timing.future_tolerance),
            nanoseconds(timing.maximum_age),
            nanoseconds(timing.jump_tolerance),
        )

    def start_over(self) -> None:
        """Forget what was kept; the counts go on."""
        self.newest.clear()
        self.first = 0
        self.latest: int | None = None
        self._doubted: int | None = None  # a stamp far from all others

    def take(self, stream: str, stamp: int, now: int | None) -> bool:
        """Count a message and judge its stamp by what was kept and by the clock (ns).

        Returns whether the message can be used; so can the first one of a new time.
        """
        self.received[stream] += 1
        fault = self._rules.fault(stamp, self.latest, now)
        if not now and self._is_doubtful(stamp, fault):
            ahead = fault is None
            fault = StampFault.FUTURE if ahead else StampFault.LATE
            self._note(stream, stamp, fault, now)
            return False
        if fault is not None:
            back = fault is StampFault.JUMP_BACK
            self._note(stream, stamp, fault, now, unused=not back)
            if not back:
                return False
            self.time_jumps += 1
            self._on_time_jump()
        if stamp > self.newest.get(stream, 0):
            self.newest[stream] = stamp
        return True

    def _is_doubtful(self, stamp: int, fault: StampFault | None) -> bool:
        """Without a clock one message far from all others may be corrupt: another has to agree."""
        tolerance = self._rules.jump_tolerance
        ahead = self.latest is not None and stamp > self.latest + tolerance
        if fault is not StampFault.JUMP_BACK and not (fault is None and ahead):
            return False
        agreed = self._doubted is not None and abs(stamp - self._doubted) <= tolerance
        self._doubted = None if agreed else stamp
        return not agreed

    def is_number(self, stream: str, name: str, value: float, unit: str) -> bool:
        """Whether a value is one that can be computed with; counted where it is not."""
        if abs(value) < _LARGEST:
            return True
        reason = "not_plausible" if math.isfinite(value) else "not_finite"
        text = f"{name} is {value:g} {unit}, expected a number (smaller than {_LARGEST:g})"
        self.problems.add(stream, reason, text)
        return False

    def kept(self, stream: str, stamp: int, fault: StampFault | None) -> bool:
        """Note that a measurement was kept, or why there was no place for it."""
        if fault is not None:
            self._note(stream, stamp, fault, None)
            return False
        if self.latest is None:
            self.first = self.latest = stamp
        elif stamp > self.latest:
            self.latest = stamp
        return True

    def _note(
        self, stream: str, stamp: int, fault: StampFault, now: int | None, *, unused: bool = True
    ) -> None:
        text = stamp_problem(fault, stamp, self.latest, now, self._timing)
        self.problems.add(stream, fault.value, text, unused=unused)
