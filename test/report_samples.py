"""A diagnosis document by contract, for tests of what is made from one."""

from __future__ import annotations

from typing import Any

DOCUMENT: dict[str, Any] = {
    "schema": 1,
    "verdict": "missing_effect",
    "missing_effects": ["slip_sinkage", "bulldozing"],
    "candidates": ["hardpan", "moisture"],
    "channels": {
        "sinkage": {
            "rows": 96,
            "rmse": 0.0043,
            "bias": -0.0004,
            "noise_floor": 0.0007,
            "noise_floor_source": "repeats",
        },
        "resistance": {
            "rows": 90,
            "rmse": 6.4,
            "bias": 1.2,
            "noise_floor": None,
            "noise_floor_source": None,
        },
    },
    "lack_of_fit": {"p_value": 1e-3},
    "where_it_fails": [
        {
            "region": "slip > 0.32",
            "rows": 14,
            "channel": "sinkage",
            "bias": 0.0041,
            "rmse": 0.0043,
            "rmse_elsewhere": 0.0009,
            "p_value": 0.0002,
        }
    ],
    "ranking": [
        {
            "effect": "slip_sinkage",
            "status": "significant",
            "reason": "best of 14 families",
            "p_value": 0.001,
            "held_out_rmse": {"sinkage": 0.0012, "resistance": 2.0},
            "reduction": 0.83,
            "parameters": {
                "a": {
                    "value": 1.32,
                    "std": 0.07,
                    "unit": "1",
                    "published_range": [0.5, 5.0],
                    "plausible": True,
                }
            },
            "confounded_with": [{"effect": "penetration_rate", "similarity": 0.93}],
        },
        {
            "effect": "penetration_rate",
            "status": "confounded",
            "reason": "speed follows slip, r = 0.97",
            "p_value": 0.03,
            "held_out_rmse": {"sinkage": 0.0031},
            "reduction": 0.31,
            "parameters": {
                "mu": {
                    "value": -0.4,
                    "std": None,
                    "unit": "1",
                    "published_range": None,
                    "plausible": False,
                }
            },
            "confounded_with": [],
        },
        {
            "effect": "multipass",
            "status": "not_significant",
            "reason": "",
            "p_value": 0.4,
            "held_out_rmse": {"sinkage": 0.0043},
            "reduction": -0.02,
            "parameters": {},
            "confounded_with": [],
        },
        {
            "effect": "grouser",
            "status": "not_testable",
            "reason": "the table has no column 'grouser_height'",
        },
    ],
    "steps": [
        {"added": None, "held_out_rmse": {"sinkage": 0.0043, "resistance": 6.4}},
        {"added": "slip_sinkage", "held_out_rmse": {"sinkage": 0.0012, "resistance": 4.0}},
        {"added": "bulldozing", "held_out_rmse": {"sinkage": 0.0009, "resistance": 1.1}},
    ],
    "next_measurements": [
        {
            "settings": {"load": 60, "slip": [0.0, 0.4]},
            "separates": ["hardpan", "moisture"],
            "runs": 6,
            "expected_power": 0.95,
        }
    ],
}
