# SPDX-License-Identifier: Apache-2.0
"""Online estimate of the soil from measured sinkage: ROS-free, one for node and replay.

estimator = SoilEstimator(SoilPrior.from_soil(soil("dry_sand")), wheels=vehicle.wheels)
result = estimator.update(Reading(wheel, stamp, load, slip, sinkage, speed, distance, path))
estimate = estimator.estimate()

The algorithm (symbols as in `law_model` and `soil_filter`):

    x     law (u, n', m) and what may be wrong with sensors and ground; prior N(x0, P0)
    at each reading (sinkage z_i, load W_i) of wheel w:
        refuse it if it cannot be one, or is not behind the wheel's last one         `find_problem`
        expect h(x), unsure by state, place and sensor; an outlier is far from that
        and from the wheel's newest readings
        collect it; where w has gone 0.2 m of its own path since the stretch began:
            z = mean of z_i within 3 (r + MAD) of their median; W = calibrated mean  `WheelTrack`
            r^2, var W = noise of one reading, from second differences
            a sensor that shows one number throughout is stuck: leave it out         `SensorWatch`
            every 2 m: does d ln z follow slip, speed or load beyond n and m?        `MissingEffectWatch`
            wait until the vehicle is 0.6 m on; meanwhile, of the wheels that lead:
                shift of ln k behind any border over 4.75 sigma and ln 1.25:         `ChangeTest`
                    law <- prior, or a remembered soil that is likelier              `Soils`
                    nuisances stay; stretches behind the border are the old soil's
            predict and update the bank of two filters by (z, W)                     `LawFilter`
    report ln p, n, m and covariance, and what of them the data has determined       `SoilEstimate`
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.estimator.identifiability import Identifiable, SoilEstimate
from smallwheel_ros.estimator.law_model import reference_wheel
from smallwheel_ros.estimator.missing_effect import (
    EffectScore,
    MissingEffect,
    MissingEffectWatch,
)
from smallwheel_ros.estimator.reading import (
    Outcome,
    Reading,
    SinkagePrediction,
    UpdateResult,
    covariates_of,
    find_problem,
)
from smallwheel_ros.estimator.saved_state import SavedState, read_state, write_state
from smallwheel_ros.estimator.sensor_watch import SensorWatch
from smallwheel_ros.estimator.settings import EstimatorError, EstimatorSettings, SoilPrior
from smallwheel_ros.estimator.soil_filter import LocalLaw
from smallwheel_ros.estimator.soils import Reported, Soils
from smallwheel_ros.estimator.stretches import NOWHERE, Position, Segment, WheelTrack
from smallwheel_ros.estimator.wheel_sinkage import NO_SINKAGE
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

__all__ = [
    "EffectScore",
    "EstimatorError",
    "EstimatorSettings",
    "Identifiable",
    "MissingEffect",
    "Outcome",
    "Reading",
    "SinkagePrediction",
    "SoilEstimate",
    "SoilEstimator",
    "SoilPrior",
    "UpdateResult",
]

Array = NDArray[np.float64]

_MOST_WHEELS = 64
_TOLD_LOAD = 0.02  # of ln load, noise of a reading until it is learnt
_PRESSED = 0.02  # of the diameter: so deep a stretch is of a wheel that is pressed, not rolled
_FAR = 3.0  # deviations of the sensor from the newest readings: else the soil is another, not the reading
_FITS = UpdateResult(Outcome.ACCEPTED, "accepted", "")


class SoilEstimator:
    """Refines the soil from measured sinkage, for any number of wheels on one soil.

    effects: act on every prediction, with the parameters that they have. wheels: of the vehicle;
    their places say which of them runs in whose rut. Raises EstimatorError for an effect whose
    covariate a Reading does not carry.
    """

    def __init__(
        self,
        prior: SoilPrior,
        settings: EstimatorSettings | None = None,
        effects: Sequence[Effect] = (),
        wheels: Sequence[Wheel] = (),
    ) -> None:
        self.prior = prior
        self.settings = settings or EstimatorSettings()
        self.effects = tuple(effects)
        self._known_wheels = {wheel.name: wheel for wheel in wheels}
        self._needs = covariates_of(self.effects)
        self._reported = Reported(prior, self.settings)
        self.reset()

    def reset(self) -> None:
        """Forget every measurement and count: the prior again."""
        self._sensors = SensorWatch(self.settings.loads_measured)
        self._soils = Soils(self.prior, self.settings, self.effects, self._sensors)
        self._wheels: dict[str, WheelTrack] = {}
        self._gate = float(chdtri(1, 1.0 - self.settings.gate_probability))
        self._watch = MissingEffectWatch(self.effects, self.settings.scatter_length)
        self._distance = 0.0
        self._forward = True
        self.outliers = 0
        self.trusted = True

    # -- in

    def update(self, reading: Reading, judged: bool = True) -> UpdateResult:
        """Use load and sinkage of a reading; never raises for what is in it (see `UpdateResult.reason`).

        judged: work out what was expected of it, too; else only where it is far from the newest ones.
        """
        name = reading.wheel.name
        wheel = self._wheels.get(name)
        given = reading if wheel is None else wheel.in_its_rut(reading)
        problem = find_problem(given, self._needs)
        if problem is None and wheel is not None:
            problem = wheel.out_of_order(given)
        elif problem is None and len(self._wheels) >= _MOST_WHEELS:
            words = f"wheel '{name}': there are {_MOST_WHEELS} other wheels already"
            problem = "too_many_wheels", words
        if problem is not None:
            return UpdateResult(Outcome.REFUSED, *problem)
        try:
            return self._use(given, wheel or self._arrive(given), judged)
        except NO_SINKAGE as error:
            return UpdateResult(Outcome.REFUSED, "numerical", _no_sinkage(given, error))

    def _arrive(self, given: Reading) -> WheelTrack:
        """Give a wheel that was never measured its place; the first one is the reference wheel.

        Raises one of `NO_SINKAGE`, and changes nothing, where it has none.
        """
        load, name = given.load, given.wheel.name
        assert load is not None, "`find_problem` says so"
        told = load.standard_deviation / load.value or _TOLD_LOAD
        now = Segment.single(given, load.value, (load.standard_deviation / load.value) ** 2)
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            law = self._soils.law or self._soils.new_law(reference_wheel(now, self.prior))
            law.sinkage(now, 0.0)
        self._soils.law = law
        index = self._soils.add_wheel()
        forward, backward = (
            Position.of(index, name, self._known_wheels, way) for way in (True, False)
        )
        length = self.settings.scatter_length
        if now.contact != ROLLING:
            length = min(length, _PRESSED * now.diameter)
        wheel = WheelTrack(length, self.settings.sinkage_std, told, (forward, backward))
        self._wheels[name] = wheel
        return wheel

    def _use(self, given: Reading, wheel: WheelTrack, judged: bool) -> UpdateResult:
        changes, (_, sinkage) = self._soils.changes, given.measured
        if given.onward is not self._forward:
            self._forward = given.onward
            self._soils.turn_back()
        newest = median([*wheel.recent, sinkage])
        far = abs(sinkage - newest) > _FAR * math.sqrt(wheel.reading_variance)
        result = self._judge(given, wheel, far) if judged or far else _FITS
        closed = wheel.add(given)
        self._distance = max(self._distance, given.distance)
        if closed is not None:
            self._take(closed)
        if self._soils.changes > changes:
            result = result._replace(outcome=Outcome.ACCEPTED, reason="soil_changed", message="")
        return result

    def _judge(self, given: Reading, wheel: WheelTrack, far: bool) -> UpdateResult:
        """Compare a reading with what is expected of it, before it counts.

        far: it is off the wheel's newest ones. Raises one of `NO_SINKAGE` where the model has none for it.
        """
        law, _ = self._soils.under(wheel)
        assert law is not None
        now = Segment.single(given, *wheel.load(given), wheel.position_of(given))
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            shown, variance, _ = law.shown(now)
            true, true_variance = law.sinkage(now, self._watch.missed_variance)
        spread = variance + wheel.reading_variance + law.scatter.additive
        if not math.isfinite(true + true_variance + spread):
            raise ArithmeticError("its uncertainty has no bounds")
        miss = now.sinkage - shown
        numbers = true, true_variance, miss, spread, miss * miss / spread
        if not far or numbers[-1] <= self._gate:
            return UpdateResult(Outcome.ACCEPTED, "accepted", "", *numbers)
        message = (
            f"wheel '{now.wheel}': sinkage {1e3 * now.sinkage:.1f} mm, expected "
            f"{1e3 * shown:.1f} +- {1e3 * math.sqrt(spread):.1f} mm"
        )
        return UpdateResult(Outcome.OUTLIER, "gate", message, *numbers)

    def _take(self, segment: Segment) -> None:
        """A segment has closed: look at its sensor, at what the model misses, at the soil."""
        self.outliers += segment.dropped
        self._sensors.add(segment)
        if self._sensors.is_stuck(segment.wheel):
            self._soils.test.drop_stuck(segment.wheel)
            return
        if segment.contact == ROLLING and self._watch.add(segment):
            law = self.estimate()
            self._watch.test(self.prior.soil, (law.k, law.n, law.m), segment.distance)
        self._soils.take(segment)

    # -- out

    @property
    def accepted(self) -> int:
        """Readings that were used for a soil."""
        return self._soils.accepted

    @property
    def settled(self) -> bool:
        """Whether enough was measured of the soil that a wheel came to last (`SoilEstimate.settled`)."""
        law = self._soils.law
        return law is not None and law.settled and self.trusted

    @property
    def distance(self) -> float:
        """Travel (m) of the newest measurement."""
        return self._distance

    @property
    def soil_changes(self) -> int:
        """How often another soil was found."""
        return self._soils.changes

    @property
    def missing_effect(self) -> MissingEffect | None:
        """The alarm that the model misses an effect, None while there is none."""
        return self._watch.alarm

    @property
    def effect_scores(self) -> tuple[EffectScore, ...]:
        """The newest test for each effect that the model has not, the best first."""
        return self._watch.scores

    @property
    def soil_number(self) -> int:
        """Which soil a wheel came to last: counted as they were met; on return it is the old number."""
        return self._soils.number

    @property
    def findings(self) -> tuple[str, ...]:
        """What seems wrong with the sensors, each in words with what to check."""
        law = self._soils.law
        return () if law is None else self._sensors.findings(law, list(self._wheels))

    def elsewhere(self, wheel: str) -> tuple[str, ...]:
        """Name the wheels that are on another soil than this one: just before or after a border."""
        known, behind = self._wheels.get(wheel), self._soils.is_behind
        if known is None or not self._soils.changes:
            return ()
        return tuple(n for n, w in self._wheels.items() if behind(w) is not behind(known))

    def load(self, wheel: str) -> tuple[float, float] | None:
        """Load of a wheel without its noise (N), and variance of its logarithm; None: not measured."""
        known = self._wheels.get(wheel)
        return None if known is None else known.load()

    def is_stuck(self, wheel: str) -> bool:
        """Whether the sinkage sensor of a wheel shows the same wherever it rolls, and is not used."""
        return self._sensors.is_stuck(wheel)

    def weigh(self, loads: Mapping[str, float], weight: Quantity) -> None:
        """Use what the loads (N) of all wheels should add up to: the vehicle's weight (N)."""
        law = self._soils.law
        if law is not None:
            known = self._wheels
            places = [
                (known[name].position.index if name in known else None, load)
                for name, load in loads.items()
            ]
            law.weigh(places, weight)

    def local(self, wheel: str) -> LocalLaw:
        """The law under a wheel; of one that was never measured, that of the soil."""
        known = self._wheels.get(wheel)
        law, _ = self._soils.under(known)
        if known is not None and law is not None:
            return law.local(known.position)
        return LocalLaw.of(self.prior.law if law is None else law.law)

    @property
    def missed_variance(self) -> float:
        """Of ln k from place to place, by an effect that seems to be missing in the model."""
        return self._watch.missed_variance

    def estimate(self, wheel: str | None = None) -> SoilEstimate:
        """Return the soil as it is believed now: the one that a wheel came to last.

        wheel: return the soil that this wheel is on, where it has been measured.
        """
        under, variety = self._soils.under(self._wheels.get(wheel) if wheel is not None else None)
        return self._reported.estimate(
            self.prior.law if under is None else under.law,
            self._watch.missed_variance,
            variety=variety,
            accepted=self._soils.accepted,
            outliers=self.outliers,
            soil_changes=self._soils.changes,
            distance=self._distance,
            missing_effect=self._watch.alarm,
            settled=under is not None and under.settled and self.trusted,
        )

    def predict(
        self,
        load: float,
        diameter: float,
        width: float,
        *,
        slip: float | None = None,
        speed: float | None = None,
        contact: str = ROLLING,
        load_std: float = 0.0,
        wheel: str | None = None,
    ) -> SinkagePrediction:
        """Predict the sinkage of a wheel; of `wheel`, in its rut, where that one has been measured.

        load: N, load_std: of its noise. Raises EstimatorError for a load, diameter or width that is not a
        number over 0, a slip or speed that an effect needs and that is not given, and where the model has
        no sinkage.
        """
        exact = None if slip is None else Quantity(slip, 0.0)
        carried = Quantity(load, load_std)
        of = Wheel(wheel or "", diameter, width, contact)
        given = Reading(of, 0, carried, exact, Quantity(0.0, 0.0), speed, 0.0, 0.0)
        problem = find_problem(given, self._needs)
        if problem is not None:
            raise EstimatorError(problem[1])
        known = self._wheels.get(wheel) if wheel is not None else None
        position = NOWHERE if known is None else known.position
        now = Segment.single(given, load, (load_std / load) ** 2, position)
        law, _ = self._soils.under(known)
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                law = law or self._soils.new_law(reference_wheel(now, self.prior))
                value, variance = law.sinkage(now, self._watch.missed_variance)
        except NO_SINKAGE as error:
            raise EstimatorError(_no_sinkage(given, error)) from None
        return SinkagePrediction(value, math.sqrt(max(variance, 0.0)), value > 0.5 * diameter)

    # -- files

    def save(self, path: str | Path, strength: Any = None) -> None:
        """Save the newest soil, whole or not at all. Raises EstimatorError where it cannot be.

        strength: see `TractionEstimator.record`.
        """
        soils = self._soils
        state = SavedState(soils.record(), soils.variety, self.accepted, strength)
        write_state(Path(path), state, self.prior, self.effects, self.estimate())

    def restore(self, path: str | Path, strength: Callable[[Any], None] = lambda _: None) -> None:
        """Begin anew from a saved soil instead of the prior.

        strength: is given what was saved of it (`TractionEstimator.restore`).
        Raises EstimatorError, and changes nothing, for a file that is missing, not whole, or saved
        under another prior or other effects.
        """
        state = read_state(Path(path), self.prior, self.effects)
        try:
            strength(state.strength)
        except ValueError as error:
            raise EstimatorError(
                f"{path}: {error}; restore the old setting, or delete the file to begin with the prior"
            ) from None
        self.reset()
        if state.soil is not None:
            self._soils.resume(state.soil, state.variety, state.accepted)


def _no_sinkage(given: Reading, error: Exception) -> str:
    load, _ = given.measured
    return f"wheel '{given.wheel.name}': the model has no sinkage under {load:g} N ({error})"
