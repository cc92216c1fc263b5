# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as a request to stop, which the worker checks between two messages."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Stop:
    """Whether the user asked to stop, by Ctrl-C or SIGTERM; a second request raises KeyboardInterrupt.

    Attributes
    ----------
    asked
        Name of the signal, such as `SIGINT`; empty while none has come.
    """

    def __init__(self) -> None:
        self.asked = ""

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Handle the signals inside the `with` block; in a thread other than the main one it does nothing."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        signals = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(number, self._take) for number in signals]
        try:
            yield
        finally:
            for number, handler in zip(signals, before, strict=True):
                signal.signal(number, handler)

    def _take(self, number: int, _frame: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = signal.Signals(number).name
