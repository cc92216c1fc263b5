"""The first measurements of a soil, kept to be linearised again at what the later ones tell.

While n is as uncertain as the prior, each measurement is linearised at another soil, and the small
differences between their slopes look like information that is not there: a filter that goes on
from them is sure of a wrong n for long. Running the filter over them again, all linearised at the
newest soil (Gauss-Newton on all of them; the iterated smoother of Bell 1994), is the remedy. It is
done at growing intervals, and no longer once n is known or the record is full.
"""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.estimator.iterated_update import Belief, exponent_of
from smallwheel_ros.estimator.sinkage_observation import Observation, Observed

_ALIKE = 0.05  # predicted sinkages that differ by less are one record
_ONE_SPOT = 0.1  # of the scatter length
_MOST = 120  # records
_GROWTH = 1.25  # of their number from one running to the next
_NARROW = 0.12  # standard deviation of the logit of n/3: slopes no longer change with the soil


@dataclass
class Record:
    """One measurement, or the weighted mean of several alike at one spot.

    travelled: m since the opening began. noise: m^2. load_noise: variance of ln load.
    """

    travelled: float
    spot: int
    observe: Observation
    measured: float
    noise: float
    load_noise: float

    def merge(self, measured: float, noise: float, load_noise: float) -> None:
        """Take in another measurement, brought to the conditions of this one."""
        weight = self.noise / (self.noise + noise)
        self.measured += weight * (measured - self.measured)
        self.load_noise = (1.0 - weight) ** 2 * self.load_noise + weight**2 * load_noise
        self.noise *= 1.0 - weight


class Opening:
    """Collects the records, and says when to run over them again."""

    def __init__(self, scatter_length: float) -> None:
        self._one_spot = _ONE_SPOT * scatter_length
        self.records: list[Record] = []
        self.travelled = 0.0
        self.going_on = True
        self._last: dict[int, Record] = {}
        self._due = 2

    def add(
        self,
        observe: Observation,
        observed: Observed,
        belief: Belief,
        measured: float,
        noise: float,
        load_noise: float,
        spot: int,
    ) -> bool:
        """Keep a measurement that the filter has used; True when the records are due.

        observed: `observe` at the belief's mean.
        """
        last = self._last.get(spot)
        if last is not None and self.travelled - last.travelled <= self._one_spot:
            there = last.observe(belief.s, exponent_of(belief.q)).sinkage
            if abs(there - observed.sinkage) <= _ALIKE * abs(observed.sinkage):
                last.merge(measured + there - observed.sinkage, noise, load_noise)
                return False
        record = Record(self.travelled, spot, observe, measured, noise, load_noise)
        self.records.append(record)
        self._last[spot] = record
        if len(self.records) < self._due:
            return False
        self._due = int(_GROWTH * self._due) + 1
        return True

    def judge(self, logit_deviation: float) -> None:
        """End the opening once n is known or the record is full."""
        if logit_deviation < _NARROW or len(self.records) >= _MOST:
            self.going_on = False
            self.records.clear()
            self._last.clear()
