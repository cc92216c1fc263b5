# SPDX-License-Identifier: Apache-2.0
"""A stamp before any other has to be so in the arithmetic of stamps, too."""

from __future__ import annotations

import numpy as np

from smallwheel_ros.common.stamps import NEVER, SECOND


def test_never_is_before_any_stamp_and_differences_with_it_do_not_overflow() -> None:
    century = 100 * 366 * 24 * 3600 * SECOND
    stamps = np.array([NEVER, 0, century], dtype=np.int64)
    gone = stamps - NEVER
    assert gone.tolist() == [0, -NEVER, century - NEVER]  # as without the bounds of 64 bits
    assert (np.diff(stamps) > century).tolist() == [True, False]
