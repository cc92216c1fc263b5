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
    c, and whether that is fitted or given (the driver's middle).
    """

    name: str
    code: str
    text: str
    power: float = 0.0
    constant: Constant = "none"

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
POSITIVE = Shape("positive", "np.maximum(u, 0.0)", "max({u}, 0)", 1.0)
NEGATIVE = Shape("negative", "np.maximum(-u, 0.0)", "max(-{u}, 0)", 1.0)
OFFSET = Shape("offset", "u - c", "({u} - {c})", 1.0, "free")
HINGE = Shape("hinge", "np.maximum(u - c, 0.0)", "max({u} - {c}, 0)", 1.0, "free")
FALLING_HINGE = Shape("falling_hinge", "np.maximum(c - u, 0.0)", "max({c} - {u}, 0)", 1.0, "free")
OPTIMUM = Shape("optimum", "(u - c) ** 2", "({u} - {c})^2", 2.0, "free")
SATURATION = Shape("saturation", "np.tanh(u / c)", "tanh({u}/{c})", constant="free")
DECAY = Shape("decay", "np.exp(-np.abs(u) / c)", "exp(-|{u}|/{c})", constant="free")
LOG_GROWTH = Shape("log_growth", "np.log1p(np.abs(u) / c)", "ln(1 + |{u}|/{c})", constant="free")
GROWTH = Shape("growth", "np.expm1(u / c)", "(exp({u}/{c}) - 1)", constant="free")
