# SPDX-License-Identifier: Apache-2.0
"""Find out which physical effect a model is missing, and what the data cannot tell."""

from __future__ import annotations

from smallwheel_ros.diagnosis.apply import Added, add_effect
from smallwheel_ros.diagnosis.held_out import Step
from smallwheel_ros.diagnosis.pipeline import Diagnosis, diagnose
from smallwheel_ros.fitting import Base
from smallwheel_ros.fitting.problem import base_of

__all__ = ["Added", "Base", "Diagnosis", "Step", "add_effect", "base_of", "diagnose"]
