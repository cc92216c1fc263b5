# SPDX-License-Identifier: Apache-2.0
"""All forms of all effects, and rows of a rolling wheel on which each of them acts."""

from __future__ import annotations

from smallwheel_ros.effects.base import Effect
from smallwheel_ros.effects.registry import covariate, families
from smallwheel_ros.physics.conditions import Conditions

FORMS = [form for forms in families().values() for form in forms] + list(covariate("temperature"))
# Every covariate that an effect reads, varied, so that no form is at its neutral point.
ROLLING = Conditions.of(
    load=[40.0, 60.0, 90.0],
    diameter=[0.15, 0.2, 0.3],
    width=[0.08, 0.1, 0.15],
    slip=[-0.3, 0.2, 0.6],
    speed=[0.02, 0.2, 0.4],
    slip_angle=[0.2, -0.3, 0.5],
    pass_number=[2, 3, 5],
    grouser_height=[0.005, 0.01, 0.015],
    moisture=[0.05, 0.12, 0.2],
    temperature=[270.0, 290.0, 320.0],
    slope=[-0.2, 0.1, 0.3],
)


def named(form: type[Effect]) -> str:
    return f"{form.id}/{form.form}"
