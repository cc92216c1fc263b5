"""The first measurements of a soil, kept to be linearised again at what the later ones tell.

While n and m are as uncertain as the prior, each measurement is linearised at another soil. Running
the filter over them again, all linearised at the newest soil (Gauss-Newton on all of them; the
iterated smoother of Bell 1994), brings it to what a fit of all of them at once would give. It is
done at growing intervals, and no longer once n is known or the record is full.
"""

from __future__ import annotations

from dataclasses import dataclass

from smallwheel_ros.estimator.sinkage_observation import Reading

_ALIKE = 0.05  # predicted sinkages that differ by less are one record
_ONE_SPOT = 0.1  # of the scatter length
_MOST = 120  # records
_GROWTH = 1.25  # of their number from one running to the next
_NARROW = 0.05  # standard deviation of n: slopes no longer change with the soil


@dataclass
class Record:
    """One reading, or the weighted mean of several alike at one spot.

    travelled: m since the opening began.
    """

    travelled: float
    spot: int
    reading: Reading

    def merge(self, measured: float, noise: float, load_noise: float) -> None:
        """Take in another measurement (m, m^2), brought to the conditions of this one."""
        old = self.reading
        weight = old.noise / (old.noise + noise)
        self.reading = old._replace(
            measured=old.measured + weight * (measured - old.measured),
            noise=old.noise * (1.0 - weight),
            load_noise=(1.0 - weight) ** 2 * old.load_noise + weight**2 * load_noise,
        )


class Opening:
    """Collects the records, and says when to run over them again."""

    def __init__(self, scatter_length: float) -> None:
        self._one_spot = _ONE_SPOT * scatter_length
        self.records: list[Record] = []
        self.travelled = 0.0
        self.going_on = True
        self._last: dict[tuple[int, str], Record] = {}
        self._due = 2

    def at(self, spot: int, channel: str) -> Record | None:
        """The newest record of a wheel in this channel, if it still stands there."""
        last = self._last.get((spot, channel))
        if last is None or self.travelled - last.travelled > self._one_spot:
            return None
        return last

    def add(self, reading: Reading, spot: int, here: float, there: float | None) -> bool:
        """Keep a reading that the filter has used; True when the records are due.

        here: predicted for it, m. there: predicted for the record `at` this spot; None without.
        """
        if there is not None and abs(there - here) <= _ALIKE * abs(here):
            self._last[spot, reading.channel].merge(
                reading.measured + there - here, reading.noise, reading.load_noise
            )
            return False
        record = Record(self.travelled, spot, reading)
        self.records.append(record)
        self._last[spot, reading.channel] = record
        if len(self.records) < self._due:
            return False
        self._due = int(_GROWTH * self._due) + 1
        return True

    def judge(self, exponent_deviation: float) -> None:
        """End the opening once n is known or the record is full."""
        if exponent_deviation < _NARROW or len(self.records) >= _MOST:
            self.end()

    def end(self) -> None:
        """Keep no more records."""
        self.going_on = False
        self.records.clear()
        self._last.clear()
