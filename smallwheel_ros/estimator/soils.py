"""Which soil each wheel is on: changes of soil, found wheel by wheel, and soils met before.

One measurement that does not fit is an outlier. Several in a row of one wheel, at different spots,
are another soil. The wheels behind it are still on the old one, so each wheel has its soil, and
goes over to the next where its own measurements stop fitting. A few soils are remembered: a wheel
that comes back to one goes on where that estimate was.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field

from smallwheel_ros.estimator.identifiability import Variety
from smallwheel_ros.estimator.load_level import Level, LoadLevel
from smallwheel_ros.estimator.saved_state import SoilRecord
from smallwheel_ros.estimator.settings import EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.sinkage_observation import Reading
from smallwheel_ros.estimator.soil_state import SoilState, Taken
from smallwheel_ros.estimator.strength import StrengthState

_MOST_WIDENINGS = 3
_LEAST_STEP = 0.01  # of the scatter length: drift over less waits until it adds up
_KNOWN_SOILS = 4
_ALONE = 2  # surprises of one wheel after which it may be on another soil
_SETTLED = 10  # measurements
_TELLING = 0.3  # a soil whose prediction of ln sinkage is less sure than this would fit anything


@dataclass(eq=False)
class KnownSoil:
    """A soil that wheels are on, or were.

    at: travel (m) to which it has drifted. fitted: what was accepted since it was opened, up to
    `_SETTLED`: before that, what was accepted may be the outlier. changed: not counted as a change
    yet. strength: None before the first drawbar pull.
    """

    state: SoilState
    at: float
    fitted: int = 0
    changed: bool = False
    widenings: int = 0
    variety: Variety = field(default_factory=Variety)
    strength: StrengthState | None = None

    @property
    def settled(self) -> bool:
        """Whether there is an estimate to protect from outliers."""
        return self.fitted >= _SETTLED


@dataclass(eq=False)
class WheelTrack:
    """A wheel: its place in the state, its newest measurement, and its run of surprises."""

    spot: int
    soil: KnownSoil
    time: float = -math.inf  # s and m of the newest that was used
    distance: float = -math.inf
    level: LoadLevel = field(default_factory=LoadLevel)
    load: tuple[float, float] = (0.0, 0.0)  # N without its noise, and variance of its logarithm
    slip_level: Level = field(default_factory=Level)
    slip: float | None = None  # the newest that was known
    slip_at: float = 0.0  # m, where that was
    surprises: int = 0
    surprised_at: float = 0.0


class Soils:
    """The soils that are known, and the one that a wheel came to last."""

    def __init__(self, prior: SoilPrior, settings: EstimatorSettings, gate: float) -> None:
        self._prior, self._settings, self._gate = prior, settings, gate
        self._spots = 0
        self.changes = 0
        self.current = KnownSoil(SoilState(prior, settings), 0.0)
        self._known = [self.current]

    def resume(self, record: SoilRecord, variety: Variety) -> None:
        """Go on from a saved soil, before any wheel has been measured."""
        self.current.state.resume(record)
        self.current.variety, self.current.fitted = variety, _SETTLED

    def start(self, distance: float) -> None:
        """Count travel from here (m)."""
        self.current.at = distance

    def add_spot(self) -> int:
        """Give a wheel a spot in each soil."""
        self._spots += 1
        for soil in self._known:
            spot = soil.state.add_spot()
        return spot

    def take(
        self, reading: Reading, wheel: WheelTrack, wheels: Collection[WheelTrack], distance: float
    ) -> tuple[Taken, str]:
        """Use a reading for the soil that its wheel is on; give what came of it, and the reason.

        Raises ArithmeticError or ValueError, with nothing changed, where it cannot be computed.
        """
        soil = wheel.soil
        self._travel(soil, distance)
        taken = soil.state.take(reading, wheel.spot, self._gate)
        if taken.reason == "accepted":
            self._fits(wheel)
            return taken, self._counted(soil)
        if taken.reason != "gate":
            return taken, taken.reason
        # Before there is an estimate to protect, each surprise counts.
        apart = 0.5 * self._settings.scatter_length
        if not (wheel.surprises and soil.settled and distance - wheel.surprised_at < apart):
            wheel.surprises += 1
            wheel.surprised_at = distance
        if soil.settled and wheel.surprises >= _ALONE and self._returns(reading, wheel, distance):
            return taken, self._counted(wheel.soil)
        surprised = [w for w in wheels if w.soil is soil and w.surprises]
        enough = self._settings.surprises_to_reopen
        # One surprise may be an outlier of a wheel that is on the old soil still.
        alone = min(_ALONE, enough) if soil.settled else 1
        if sum(w.surprises for w in surprised) < enough or wheel.surprises < alone:
            return taken, "gate"
        surprised = [w for w in surprised if w.surprises >= alone]
        opened = self._open(soil, surprised, distance)
        self._forget(wheels)
        if opened.state.take(reading, wheel.spot, self._gate).reason != "accepted":
            return taken, "gate"
        self._fits(wheel)
        return taken, self._counted(opened)

    def _fits(self, wheel: WheelTrack) -> None:
        wheel.surprises = 0
        wheel.soil.fitted = min(wheel.soil.fitted + 1, _SETTLED)

    def _counted(self, soil: KnownSoil) -> str:
        """Reason of an acceptance; a change counts once the soil has been seen to fit."""
        if not soil.changed:
            return "accepted"
        soil.changed = False
        self.changes += 1
        return "soil_changed"

    def _travel(self, soil: KnownSoil, distance: float) -> None:
        step = distance - soil.at
        if step > _LEAST_STEP * self._settings.scatter_length:
            soil.state.travel(step)
            soil.at = distance

    def _returns(self, reading: Reading, wheel: WheelTrack, distance: float) -> bool:
        """Move a wheel to a known soil that its reading fits."""
        for soil in self._known:
            if soil is wheel.soil or not soil.settled:
                continue
            self._travel(soil, distance)
            try:
                if soil.state.relative_spread(reading, wheel.spot) > _TELLING:
                    continue
                if soil.state.take(reading, wheel.spot, self._gate).reason != "accepted":
                    continue
            except (ArithmeticError, ValueError):
                continue
            wheel.soil = soil
            self._fits(wheel)
            if soil is not self.current:
                self.current = soil
                soil.changed = True
            return True
        return False

    def _open(self, soil: KnownSoil, surprised: list[WheelTrack], distance: float) -> KnownSoil:
        """Begin a soil for these wheels; one not settled begins anew, wider if nothing fitted."""
        if not soil.settled:
            if not soil.fitted:
                soil.widenings = min(soil.widenings + 1, _MOST_WIDENINGS)
            soil.state.reopen(4.0**soil.widenings)
            soil.fitted, soil.variety, soil.strength = 0, Variety(), None
            opened = soil
        elif self.current is not soil and not self.current.settled:
            opened = self.current  # another wheel has just come to it
        else:
            opened = KnownSoil(SoilState(self._prior, self._settings), distance, changed=True)
            for _ in range(self._spots):
                opened.state.add_spot()
            self._known.append(opened)
            self.current = opened
        for wheel in surprised:
            wheel.soil, wheel.surprises = opened, 0
        return opened

    def _forget(self, wheels: Collection[WheelTrack]) -> None:
        """Keep a few soils only: those that wheels are on, and the newest."""
        if len(self._known) <= _KNOWN_SOILS:
            return
        used = {id(w.soil) for w in wheels} | {id(self.current)}
        for soil in self._known:
            if id(soil) not in used:
                self._known.remove(soil)
                return
        # A wheel that stays behind on the oldest soil, unmeasured, goes along with the others.
        oldest = self._known.pop(0)
        for wheel in wheels:
            if wheel.soil is oldest:
                wheel.soil = self.current
