# SPDX-License-Identifier: Apache-2.0
"""`compare`: models against measurements."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from smallwheel_ros.api.read import read
from smallwheel_ros.arguments import Data, Models, OwnEffects, unheard
from smallwheel_ros.model.given import registry_of

if TYPE_CHECKING:
    from smallwheel_ros.compare.comparison import Comparison


def compare(
    data: Data,
    models: Models = (),
    *,
    effects: OwnEffects | None = None,
    progress: Callable[[int, int], object] = unheard,
) -> "Comparison":
    """Compare models with measurements.

    The closed forms of Bekker and of Meirion-Griffith & Spenko, the contact integral and, where pull or
    torque was measured, the law of Wong and Reece are fitted to the data, and judged on runs that were
    held out of the fit, beside a constant, the mean of the other runs, and a log-log regression. Errors
    are given for each channel, soil, wheel and range of conditions, beside the repeatability within
    runs. `diagnose` works out what error a true model would leave.

    Parameters
    ----------
    data
        The measurements.
    models : one, several, or several by name
        A further model to compare, used as it is.
    effects : or what `sw.effects.load` made of it
        A Python file with effects of your own. It is run: name only files that you trust.
    progress
        Told how many of how many fits are done.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> found = sw.compare("rig.csv", {"sand": "dry_sand"})
    >>> [model.contender.name for model in found.models]
    ['constant', 'log_log_regression', 'bekker', 'meirion_griffith_spenko', 'contact_integral', 'sand']
    """
    from smallwheel_ros.compare.comparison import comparison_of
    from smallwheel_ros.compare.contenders import contenders_of

    return comparison_of(read(data), contenders_of(models, registry_of(effects)), progress=progress)
