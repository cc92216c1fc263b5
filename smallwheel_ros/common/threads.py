# SPDX-License-Identifier: Apache-2.0
"""Threads of linear algebra."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np  # noqa: F401  # limits are of libraries that are loaded: NumPy's
import scipy.linalg  # noqa: F401  # and SciPy's
from threadpoolctl import ThreadpoolController

_THREADS = ThreadpoolController()
Function = TypeVar("Function", bound=Callable[..., Any])


def one_thread(function: Function) -> Function:
    """Wrap a function so that its linear algebra uses one thread, whatever the environment sets.

    Matrices here are small: more threads cost more than they bring, many times more on a busy machine.
    """
    return cast(Function, _THREADS.wrap(limits=1, user_api="blas")(function))
