"""Parameters of what the node makes of its estimates: the alarm and the cost map."""

from __future__ import annotations

from smallwheel_ros.costmap.cost_map import CostSettings
from smallwheel_ros.onboard.parameter import Parameter, double
from smallwheel_ros.onboard.settings import DiggingInRules

_DIGGING_IN, _COST = DiggingInRules(), CostSettings()

DIGGING_IN: tuple[Parameter, ...] = (
    double(
        "digging_in.slip",
        _DIGGING_IN.slip,
        "1",
        0.31,
        1.0,
        "A wheel digs itself in where its slip is at least this, and all that follows holds.",
    ),
    double(
        "digging_in.sinkage_rise",
        _DIGGING_IN.sinkage_rise,
        "1",
        0.01,
        10.0,
        "Its sinkage is above that of ordinary driving (slip up to 0.3) by this share of it.",
    ),
    double(
        "digging_in.speed_drop",
        _DIGGING_IN.speed_drop,
        "1",
        0.01,
        1.0,
        "Its speed over ground is below that of ordinary driving by this share of it.",
    ),
    double("digging_in.time", _DIGGING_IN.time, "s", 0.0, 60.0, "All of it for so long."),
)

COST: tuple[Parameter, ...] = (
    double("cost.resolution", _COST.resolution, "m", 0.01, 10.0, "Side of a cell of ~/cost."),
    double(
        "cost.size",
        _COST.size,
        "m",
        1.0,
        2000.0,
        "Side of the window of crossed ground that goes along with the robot; what it leaves behind"
        " is forgotten. At most 4 million cells.",
    ),
    double(
        "cost.period",
        _COST.period,
        "s",
        0.1,
        3600.0,
        "Shortest time between two grids; none is published while nothing has changed.",
    ),
    Parameter(
        "cost.frame",
        "string",
        "",
        "",
        "Frame of ~/cost. Empty: that of odom. Nothing is transformed: set it only where odom's"
        " poses are in this frame.",
    ),
    double(
        "cost.easy_margin",
        _COST.rules.easy_margin,
        "1",
        0.001,
        10.0,
        "Pessimistic mobility margin from which on ground costs nothing (docs/nav2.md).",
    ),
    double(
        "cost.hard_margin",
        _COST.rules.hard_margin,
        "1",
        -10.0,
        10.0,
        "Pessimistic mobility margin up to which ground costs 99, the most that can be crossed.",
    ),
    double(
        "cost.confidence",
        _COST.rules.confidence,
        "1",
        0.5,
        0.9999,
        "Costs are those of the margin that is exceeded with this probability: more is more wary.",
    ),
    double(
        "cost.class_scatter",
        _COST.rules.class_scatter,
        "1",
        0.0,
        10.0,
        "Standard deviation of the margin between places of one terrain class, until enough of them"
        " have been crossed to tell.",
    ),
)
