# SPDX-License-Identifier: Apache-2.0
"""Fit a model of wheel and soil to measurements: points, variance components, posterior."""

from __future__ import annotations

from smallwheel_ros.fitting.named import FittedParameter
from smallwheel_ros.fitting.parameters import ParameterPrior
from smallwheel_ros.fitting.points import FittingError
from smallwheel_ros.fitting.problem import Base, Problem
from smallwheel_ros.fitting.result import FitResult

__all__ = ["Base", "FitResult", "FittedParameter", "FittingError", "ParameterPrior", "Problem"]
