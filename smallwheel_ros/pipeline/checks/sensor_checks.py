# SPDX-License-Identifier: Apache-2.0
"""The stage of the checks: raw rows in, believed rows out.

    RawRows -> ground speed and imu, and rules, span by span (2 s) -> doubts -> BelievedRows

What is learnt of the speed in a span depends on the doubts before it, and doubts depend on what was
learnt: both therefore advance together, in spans that begin at fixed stamps.
"""

from __future__ import annotations

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND
from smallwheel_ros.onboard.settings import OnboardSettings
from smallwheel_ros.pipeline.intake.layout import rules_of

from .believed import BelievedRows, RawRows
from .doubts import Doubts
from .ground_speed import WINDOW, GroundSpeed
from .rules import Checks, Finding
from .window import SPAN

_PAST = 2 * SECOND  # what is learnt of an odometry looks so far back, and its lag half of it


class SensorChecks:
    """Checks of one vehicle's sensors.

    Attributes
    ----------
    doubts
        Doubts recorded so far.
    ground
        What has been learnt of ground speed and imu.
    done
        Stamp up to which rows have been processed, ns.
    findings
        Faults that the newest call of `take` reported for the first time.
    """

    def __init__(self, settings: OnboardSettings) -> None:
        self.settings = settings
        self.doubts = Doubts()
        self.ground = GroundSpeed(settings, self.doubts)
        self.rules = Checks(settings, self.ground, self.doubts)
        self.done = NEVER
        self.findings: tuple[Finding, ...] = ()
        self._kept = _PAST + WINDOW + 2 * rules_of(settings).widest

    @property
    def looks_back(self) -> int:
        """Stamp (ns) of the oldest raw rows that the next call needs."""
        return self.done - self._kept

    def take(self, raw: RawRows, *, last: bool = False) -> BelievedRows:
        """Check the rows that arrived since the last call.

        Parameters
        ----------
        raw
            Rows of each stream, from `looks_back` on.
        last
            Whether no more rows will come: the newest speed is then held to the end.

        Returns
        -------
        BelievedRows
            All rows with their doubts; the new ones lie in its (since, done].
        """
        oldest = self.looks_back
        self.doubts.forget(oldest)
        self.ground.take(raw.streams, oldest)
        until = raw.until if last else self.ground.bound(raw)
        since, self.done = self.done, max(self.done, until)
        new = {name: one.between(since, self.done) for name, one in raw.streams.items()}
        ends = np.unique(np.concatenate([stamps // SPAN for stamps, _ in new.values()]))
        self.rules.keep(new)
        self.findings, before = (), since
        for end in [*(ends[ends * SPAN > since] * SPAN).tolist(), self.done]:
            if end > before:
                self.ground.learn(end)
                self.findings += tuple(self.rules.judge(end))
                before = end
        if last:
            self.findings += tuple(self.rules.flush())
        began = tuple(stamp for stamp in self.doubts.began if stamp > since)
        return self.ground.believed(since, self.done, began, tuple(self.rules.anew))
