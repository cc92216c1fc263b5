# SPDX-License-Identifier: Apache-2.0
"""From "something unknown is missing" to a law in a file."""

from smallwheel_ros.learn.learning import LearnError, Learnt, learn

__all__ = ["LearnError", "Learnt", "learn"]
