# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM while something is at work."""

from __future__ import annotations

import signal
import threading

import pytest

from smallwheel_ros.common.stop import Stop


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_a_wish_and_a_second_one_stops(number: signal.Signals) -> None:
    before, stop = signal.getsignal(number), Stop()
    with stop.listening():
        assert not stop.asked
        signal.raise_signal(number)
        assert stop.asked == number.name
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) == before


def test_a_thread_leaves_signals_alone() -> None:
    before, stop, seen = signal.getsignal(signal.SIGINT), Stop(), []

    def work() -> None:
        with stop.listening():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]
