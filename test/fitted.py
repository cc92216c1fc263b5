# SPDX-License-Identifier: Apache-2.0
"""A base model fitted to a table, for tests."""

from __future__ import annotations

from collections.abc import Sequence

from smallwheel_ros.effects import Effect
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.measurements.measurements import Measurements


def fit_model(measurements: Measurements, effects: Sequence[Effect] = ()) -> FitResult:
    """Soils and effects, fitted to all channels at once."""
    parts = tuple(part_of(effect) for effect in effects)
    return Problem.of(measurements, Base(parts=parts)).result()
