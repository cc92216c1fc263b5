# SPDX-License-Identifier: Apache-2.0
"""Colours and settings that the drawings share."""

from __future__ import annotations

import matplotlib as mpl

INK, SOIL, PALE = "#4f5661", "#b98a50", "#9aa1ab"
FORCE, PRESSURE, SHEAR = "#c2402e", "#2b6cb0", "#2f855a"
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "smallwheel_ros",
    "font.family": "sans-serif",
    "font.size": 11,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.framealpha": 0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": mpl.cycler(color=[PRESSURE, FORCE, SHEAR]),
}
