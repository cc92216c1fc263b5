"""Forces by a strength that drawbar pull has told: its other resistance, and its covariance."""

from __future__ import annotations

from typing import NamedTuple

from smallwheel_ros.estimator.identifiability import SoilEstimate
from smallwheel_ros.estimator.law_covariance import LawCovariance
from smallwheel_ros.estimator.strength_estimate import StrengthEstimate
from smallwheel_ros.onboard.force_gradients import UNCERTAIN, ForceGradients, Gradient
from smallwheel_ros.physics.conditions import ROLLING
from smallwheel_ros.physics.wheel import Quantity, Wheel

_N, _LOAD = UNCERTAIN.index("n"), UNCERTAIN.index("load")
Row = tuple[float, float, float, float]


def with_other_resistance(
    forces: ForceGradients, strength: StrengthEstimate, wheel: Wheel, load: float
) -> ForceGradients:
    """Add the resistance that the law does not give (a share of the load, N) for a rolling wheel.

    The share is the ninth that the forces are differentiated by.
    """
    share, by_n = strength.other_resistance.value, strength.other_by_n
    if wheel.contact != ROLLING:
        share = by_n = load = 0.0

    def added(gradient: Gradient, sign: float) -> Gradient:
        slopes = [*gradient, sign * load]
        slopes[_LOAD] += sign * share
        slopes[_N] += sign * by_n * load
        return slopes

    sinkage, compaction, other, push, pull = forces.value
    by_sinkage, by_compaction, by_other, by_push, by_pull = forces.gradient
    return ForceGradients(
        (sinkage, compaction, other + share * load, push, pull - share * load),
        (
            (*by_sinkage, 0.0),
            (*by_compaction, 0.0),
            added(by_other, 1.0),
            (*by_push, 0.0),
            added(by_pull, -1.0),
        ),
    )


class MeasuredSpread(NamedTuple):
    """How uncertain everything is that such forces are differentiated by.

    law: of ln pressure, n and m. load, slip: variances. strength: covariance of cohesion, friction
    angle, shear displacement and the share, 4 by 4, with the scatter of the thrust from spot to spot.
    """

    law: LawCovariance
    load: float
    slip: float
    strength: tuple[Row, Row, Row, Row]

    @classmethod
    def of(
        cls,
        soil: SoilEstimate,
        strength: StrengthEstimate,
        load: Quantity,
        slip: Quantity | None,
        scatter: float,
    ) -> MeasuredSpread:
        """Collect it. scatter: standard deviation of ln k from spot to spot."""
        law = soil.law_covariance
        one, two, three, four = map(tuple, strength.spot_covariance.tolist())
        return cls(
            law._replace(pp=law.pp + scatter**2),
            load.standard_deviation**2,
            0.0 if slip is None else slip.standard_deviation**2,
            (one, two, three, four),
        )

    def quantity(self, value: float, gradient: Gradient) -> Quantity:
        """Put a value together with its standard deviation, to first order."""
        p, n, m, load, slip, *strength = gradient
        variance = self.law.variance((p, n, m)) + load**2 * self.load + slip**2 * self.slip
        for slope, row in zip(strength, self.strength, strict=True):
            variance += slope * sum(a * b for a, b in zip(row, strength, strict=True))
        # Rounding can leave a variance that is zero a little below it.
        return Quantity(value, max(variance, 0.0) ** 0.5)
