# SPDX-License-Identifier: Apache-2.0
"""What a node's transitions and services do with an exception: they say it, and go on."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

Call = TypeVar("Call", bound=Callable[..., Any])


def says_why(transition: Call) -> Call:
    """Log what a transition raises, which rclpy swallows: on_error is next."""

    @wraps(transition)
    def guarded(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except Exception as error:
            self.fail(f"{transition.__name__} failed: {' '.join(str(error).split())}")
            return TransitionCallbackReturn.ERROR

    return guarded  # type: ignore[return-value]  # the same signature, by construction


def answers(service: Call) -> Call:
    """Answer with success=False what a service raises: nobody is to wait for an answer in vain."""

    @wraps(service)
    def guarded(self: Any, request: Any, response: Any) -> Any:
        try:
            return service(self, request, response)
        except Exception as error:
            self.get_logger().error(f"{service.__name__} failed:\n{traceback.format_exc()}")
            response.success = False
            if hasattr(response, "message"):
                response.message = f"failed: {type(error).__name__}: {error}"
            return response

    return guarded  # type: ignore[return-value]  # the same signature, by construction
