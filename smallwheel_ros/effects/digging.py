# SPDX-License-Identifier: Apache-2.0
"""What digging costs: soil that the wheel carried away may or may not have cost compaction work.

That is not settled, so a law of digging may come in three forms: all of the depth costs work, none of what
was dug does, or a share that data decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from smallwheel_ros.effects.base import Array, Effect, parameter
from smallwheel_ros.physics.conditions import Conditions

Form = TypeVar("Form", bound=type[Effect])


def dug(form: Form) -> Form:
    """The form whose digging costs no compaction: the work is that of the static sinkage."""

    def compaction_sinkage(self: Effect, sinkage: Array, conditions: Conditions) -> Array:
        return sinkage

    return _made(form, "Dug", "compaction resistance at z0", compaction_sinkage,
                 channels=("sinkage", "drawbar_pull", "torque"))  # fmt: skip


def partly_dug(form: Form) -> Form:
    """The form of which a share c of the growth (in ln) costs compaction: 1 as the form, 0 as `dug`."""

    def compaction_sinkage(self: Any, sinkage: Array, conditions: Conditions) -> Array:
        grown = self.sinkage(sinkage, conditions) / np.maximum(sinkage, 1e-12)
        return np.asarray(sinkage * grown**self.c)

    share = parameter(
        0.5, (0.0, 1.0), "share of the growth (in ln) that costs compaction", neutral=None
    )
    return _made(form, "PartlyDug", "compaction resistance at z0 (z / z0)^c", compaction_sinkage,
                 source=f"{form.source}; of the soil below some is compacted, some carried away",
                 c=share, __annotations__={"c": "float"})  # fmt: skip


def _made(form: Form, prefix: str, cost: str, compaction_sinkage: Any, **own: Any) -> Form:
    """A form that differs in what it costs; it belongs to the module of the form that it was made from."""
    name = f"{prefix}{form.__name__}"
    own |= {
        "compaction_sinkage": compaction_sinkage,
        "formula": f"{form.formula}; {cost}",
        "__module__": form.__module__,
        "__qualname__": name,
    }
    made: Any = dataclass(frozen=True)(type(name, (form,), own))
    return made  # type: ignore[no-any-return]
