# SPDX-License-Identifier: Apache-2.0
"""What a search for what a model is missing starts from: of `diagnose`, `add` and `learn`."""

from __future__ import annotations

from dataclasses import dataclass, field

from smallwheel_ros.arguments import AnyModel, Data, Ids, Levels, OwnEffects
from smallwheel_ros.diagnosis.next_measurement import Limits
from smallwheel_ros.effects.registry import Registry, default_registry
from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.problem import base_of
from smallwheel_ros.measurements.read import read
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.measurements.typed import limits_of
from smallwheel_ros.model.given import ids_of, model_of, registry_of


@dataclass(frozen=True)
class Start:
    """A table, the model to fit to it, and what may be missing.

    registry: the effects that compete. without: ids of those that do not. limits: by setting (SI), the
    levels that the user can set. seed: of the simulations, or of permutations and folds.
    """

    measurements: Measurements
    base: Base = field(default_factory=Base)
    registry: Registry = field(default_factory=default_registry)
    without: tuple[str, ...] = ()
    limits: Limits = field(default_factory=dict)
    seed: int = 0


def start_of(
    data: Data,
    model: AnyModel | None = None,
    effects: OwnEffects | None = None,
    without: Ids = (),
    can: Levels | None = None,
    seed: int = 0,
) -> Start:
    """The start that users describe, as `diagnose.diagnose` has it. model: also a `Base`."""
    measurements, known = read(data), registry_of(effects)
    base = Base() if model is None else model
    if not isinstance(base, Base):
        base = base_of(model_of(base, known), measurements)
    out = ids_of(without, known)
    return Start(measurements, base, known, out, limits_of(can, measurements), seed)
