# SPDX-License-Identifier: Apache-2.0
"""A wheel in a power-law soil by quadrature and root finding: a truth that shares no code with a model.

W = b k D^m * integral of z(x)^n over the front of the contact,   R = b k D^m z^(n + 1) / (n + 1)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq

from smallwheel_ros.measurements.measurements import Measurements
from smallwheel_ros.physics.conditions import Conditions

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlainSoil:
    """p = k z^n D^m."""

    k: float = 600e3
    n: float = 0.8
    m: float = 0.0
    _shapes: dict[float, tuple[Array, Array]] = field(default_factory=dict, repr=False)

    @cached_property
    def log_reference_pressure(self) -> float:
        """ln of the pressure at 10 mm under a wheel of 0.2 m."""
        return float(np.log(self.k * 0.01**self.n * 0.2**self.m))

    def carried(self, depth: float, diameter: float) -> float:
        """Load on a wheel of width 1 in soil of k D^m = 1, sunk that deep."""
        radius = 0.5 * diameter
        entry = np.arccos(1.0 - depth / radius)

        def stress(angle: float) -> float:
            z = radius * (np.cos(angle) - np.cos(entry))
            return float(max(z, 0.0) ** self.n * np.cos(angle) * radius)

        return float(quad(stress, 0.0, entry)[0])

    def sinkage(self, load: Array, diameter: Array, width: Array, firmer: Array) -> Array:
        """Where the wheel carries its load: by its curve for each diameter, interpolated in logarithms."""
        found = np.empty(load.size)
        for size in np.unique(diameter):
            if size not in self._shapes:
                depth = np.geomspace(1e-4, 0.45, 60) * size
                carried = [self.carried(float(z), float(size)) for z in depth]
                self._shapes[float(size)] = np.log(depth), np.log(carried)
            depth, carried = self._shapes[float(size)]
            mine = diameter == size
            wanted = load[mine] / (width[mine] * self.k * firmer[mine] * size**self.m)
            found[mine] = np.exp(np.interp(np.log(wanted), carried, depth))
        return found

    def exact_sinkage(self, load: float, diameter: float, width: float) -> float:
        """The same by root finding."""
        wanted = load / (width * self.k * diameter**self.m)
        return float(
            brentq(lambda z: self.carried(z, diameter) - wanted, 1e-6, 0.5 * diameter, xtol=1e-12)
        )


def rolled(seed: int, count: int = 20) -> list[dict[str, float]]:
    """Settings of runs: load, slip, and one of two wheels, drawn apart from each other."""
    rng = np.random.default_rng(seed)
    return [
        {
            "load": float(20.0 * 6.0 ** rng.uniform()),
            "slip": float(rng.uniform(0.0, 0.6)),
            "diameter": float(rng.choice([0.2, 0.3])),
        }
        for _ in range(count)
    ]


@dataclass(frozen=True)
class PlainRig:
    """What is measured and how well.

    soil_scatter: of ln k from run to run. noise: relative, of one row. slip_growth: z = z0 (1 + s i).
    """

    soil: PlainSoil = field(default_factory=PlainSoil)
    soil_scatter: float = 0.05
    noise: float = 0.02
    slip_growth: float = 0.0
    width: float = 0.1
    channels: tuple[str, ...] = ("sinkage", "resistance")

    def measure(
        self,
        runs: Sequence[Mapping[str, float]],
        seed: int,
        *,
        rows: int = 3,
        declared: float | None = None,
        name: str = "",
    ) -> Measurements:
        """A table of these runs: load, and diameter and slip where given; `name` of the soil.

        declared: the standard deviations that the table states, times the true ones.
        """
        rng = np.random.default_rng([seed, 77])
        count = len(runs)
        load = np.array([run["load"] for run in runs], dtype=float)
        diameter = np.array([run.get("diameter", 0.2) for run in runs])
        slip = np.array([run.get("slip", 0.0) for run in runs])
        width = np.full(count, self.width)
        firmer = np.exp(rng.normal(0.0, self.soil_scatter, count))
        z = self.soil.sinkage(load, diameter, width, firmer)
        z = z * (1.0 + self.slip_growth * slip)
        modulus = width * self.soil.k * firmer * diameter**self.soil.m
        true = {"sinkage": z, "resistance": modulus * z ** (self.soil.n + 1) / (self.soil.n + 1)}
        true = {channel: np.repeat(true[channel], rows) for channel in self.channels}
        measured = {
            channel: value * (1.0 + rng.normal(0.0, self.noise, value.size))
            for channel, value in true.items()
        }
        stated = {}
        if declared is not None:
            stated = {c: declared * self.noise * value for c, value in true.items()}
        wide = {"slip": np.repeat(slip, rows)} if any("slip" in run for run in runs) else {}
        return table(
            measured,
            np.repeat([f"{name}{i}" for i in range(count)], rows),
            load=np.repeat(load, rows),
            diameter=np.repeat(diameter, rows),
            width=self.width,
            soil=name or None,
            declared=stated,
            **wide,
        )


def table(
    channels: Mapping[str, Array],
    run: NDArray[np.str_] | Sequence[str],
    *,
    load: Array | float = 60.0,
    diameter: Array | float = 0.2,
    width: Array | float = 0.1,
    contact: str = "rolling",
    soil: str | None = None,
    declared: Mapping[str, Array] | None = None,
    runs_given: bool = True,
    **covariates: Array,
) -> Measurements:
    """Measurements in SI units without a file."""
    count = len(run)
    conditions = Conditions(
        *(
            np.broadcast_to(np.asarray(v, dtype=float), count).copy()
            for v in (load, diameter, width)
        ),
        np.full(count, contact),
        None if soil is None else np.full(count, soil),
        dict(covariates),
    )
    return Measurements(
        conditions,
        dict(channels),
        np.asarray(run, dtype=np.str_),
        np.full(count, "wheel"),
        np.arange(2, count + 2),
        declared_std=dict(declared or {}),
        runs_given=runs_given,
        source="made up",
    )


def joined(*tables: Measurements) -> Measurements:
    """Several tables with the same columns, one after the other."""

    def stacked(of: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        return {name: np.concatenate([one[name] for one in of]) for name in of[0]}

    all_of = [t.conditions for t in tables]
    conditions = Conditions(
        np.concatenate([c.load for c in all_of]),
        np.concatenate([c.diameter for c in all_of]),
        np.concatenate([c.width for c in all_of]),
        np.concatenate([c.contact for c in all_of]),
        np.concatenate([t.soil for t in tables]) if all_of[0].soil is not None else None,
        stacked([c.covariates for c in all_of]),
    )
    rows = sum(len(t) for t in tables)
    return Measurements(
        conditions,
        stacked([t.channels for t in tables]),
        np.concatenate([t.run for t in tables]),
        np.concatenate([t.wheel for t in tables]),
        np.arange(2, rows + 2),
        declared_std=stacked([t.declared_std for t in tables]) if tables[0].declared_std else {},
        source="made up",
    )
