# SPDX-License-Identifier: Apache-2.0
"""The shapes that a law can have over one driver: the words of the grammar.

Each is one line of Python in `u` (the driver) and `c` (a constant). The search computes this line
and a drafted file contains it, so that the two cannot differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Constant = Literal["none", "given", "free"]


@dataclass(frozen=True)
class Shape:
    """One shape. code: Python of u and c. text: the same for people, of {u} and {c}.

    power: by which power of u's unit its value grows (0: it has none). constant: whether it has a
    c, and whether that is fitted or given (the driver's middle). written: further numbers that stand
    in its code, and have to be described as c has. alone: it is added to no other shape. side: +1 where it
    is zero for u under 0, -1 where it is for those over 0.
    """

    name: str
    code: str
    text: str
    power: float = 0.0
    constant: Constant = "none"
    written: int = 0
    alone: bool = False
    side: int = 0

    @property
    def moved(self) -> bool:
        """Whether c is a place on u's axis."""
        return "u - c" in self.code or "c - u" in self.code

    @cached_property
    def _function(self) -> Callable[[ArrayLike, ArrayLike], Array]:
        made: Callable[[ArrayLike, ArrayLike], Array] = eval(
            f"lambda u, c: {self.code}", {"np": np}
        )
        return made

    def __call__(self, u: ArrayLike, c: ArrayLike = 1.0) -> Array:
        """Value at u, of the broadcast shape."""
        return self._function(u, c)


LINEAR = Shape("linear", "u", "{u}", 1.0)
SQUARE = Shape("square", "u**2", "{u}^2", 2.0)
ROOT = Shape("root", "np.sqrt(np.abs(u))", "sqrt({u})", 0.5)
LOGARITHM = Shape("logarithm", "np.log(u / c)", "ln({u}/{c})", constant="given")
INVERSE = Shape("inverse", "1.0 / u", "1/{u}", -1.0)
SIZE = Shape("size", "np.abs(u)", "|{u}|", 1.0)
POSITIVE = Shape("positive", "np.maximum(u, 0.0)", "max({u}, 0)", 1.0, side=1)
NEGATIVE = Shape("negative", "np.maximum(-u, 0.0)", "max(-{u}, 0)", 1.0, side=-1)
POSITIVE_SQUARE = Shape("positive_square", "np.maximum(u, 0.0) ** 2", "max({u}, 0)^2", 2.0, side=1)
NEGATIVE_SQUARE = Shape(
    "negative_square", "np.maximum(-u, 0.0) ** 2", "max(-{u}, 0)^2", 2.0, side=-1
)
OFFSET = Shape("offset", "u - c", "({u} - {c})", 1.0, "free")
HINGE = Shape("hinge", "np.maximum(u - c, 0.0)", "max({u} - {c}, 0)", 1.0, "free")
FALLING_HINGE = Shape("falling_hinge", "np.maximum(c - u, 0.0)", "max({c} - {u}, 0)", 1.0, "free")
OPTIMUM = Shape("optimum", "(u - c) ** 2", "({u} - {c})^2", 2.0, "free")
SATURATION = Shape("saturation", "np.tanh(u / c)", "tanh({u}/{c})", constant="free")
POSITIVE_SATURATION = Shape(
    "positive_saturation",
    "np.tanh(np.maximum(u, 0.0) / c)",
    "tanh(max({u}, 0)/{c})",
    constant="free",
    side=1,
)
NEGATIVE_SATURATION = Shape(
    "negative_saturation",
    "np.tanh(np.maximum(-u, 0.0) / c)",
    "tanh(max(-{u}, 0)/{c})",
    constant="free",
    side=-1,
)
DECAY = Shape("decay", "np.exp(-np.abs(u) / c)", "exp(-|{u}|/{c})", constant="free")
LOG_GROWTH = Shape("log_growth", "np.log1p(np.abs(u) / c)", "ln(1 + |{u}|/{c})", constant="free")
GROWTH = Shape("growth", "np.expm1(u / c)", "(exp({u}/{c}) - 1)", constant="free")


def step(width: float) -> Shape:
    """From 0 to 1 at c, over a width in u's unit: a step that a fit of c can follow."""
    code = f"0.5 + 0.5 * np.tanh((u - c) / {width!r})"
    return Shape("step", code, f"step({{u}} - {{c}}, width {width:.2g})", constant="free")


def wave(period: float) -> Shape:
    """A sine of u with a period in u's unit; c is where it rises through 0.

    Alone: beside another shape it would follow whatever that leaves.
    """
    code = f"np.sin({2.0 * np.pi / period!r} * (u - c))"
    text = f"sin(2 pi ({{u}} - {{c}})/{period:.3g})"
    return Shape("wave", code, text, constant="free", written=1, alone=True)
