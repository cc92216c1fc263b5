# SPDX-License-Identifier: Apache-2.0
"""Linear algebra has one thread where matrices are small, whatever is set outside."""

from __future__ import annotations

from typing import Any

import pytest
from rows_of_drives import drive, give, static_rover
from threadpoolctl import threadpool_info, threadpool_limits

from smallwheel_ros.common.threads import one_thread
from smallwheel_ros.pipeline.pipeline import Pipeline


def threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_the_limit_ends_with_the_call_however_it_ends() -> None:
    @one_thread
    def look(*, fail: bool) -> set[int]:
        seen.update(threads())
        if fail:
            raise ValueError
        return seen

    seen: set[int] = set()
    with threadpool_limits(2, user_api="blas"):
        assert look(fail=False) == {1}
        assert threads() == {2}
        with pytest.raises(ValueError):  # noqa: PT011
            look(fail=True)
        assert threads() == {2}


def test_a_turn_of_the_pipeline_has_one() -> None:
    seen: set[int] = set()

    class Looking(Pipeline):
        def _through(self, *tables: Any) -> Any:
            seen.update(threads())
            return super()._through(*tables)

    pipeline = Looking(static_rover().onboard)
    give(pipeline.streams, drive(3.0, soil=False))
    with threadpool_limits(2, user_api="blas"):
        assert list(pipeline.turns(last=True))
    assert seen == {1}
