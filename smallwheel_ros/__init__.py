# SPDX-License-Identifier: Apache-2.0
"""Terramechanics of small wheels for ROS 2: model, diagnosis, estimator and node.

    import smallwheel_ros as sw

    data = sw.read("rig.csv")          # or a DataFrame
    found = sw.diagnose(data)          # print(found), found.plot(), found.save("diagnosis.html")
    better = sw.add(found.missing_effects[0], model=sw.fit(data), data=data)

docs/python.md has all of it. Importing this loads nothing else: each name is imported when it is used.
ROS is needed by :mod:`smallwheel_ros.ros` and the generated :mod:`smallwheel_ros.msg` alone.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pkgutil import extend_path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from smallwheel_ros.common.release import __version__

if TYPE_CHECKING:
    from smallwheel_ros import effects
    from smallwheel_ros.api.add import add
    from smallwheel_ros.api.compare import compare
    from smallwheel_ros.api.diagnose import diagnose
    from smallwheel_ros.api.fit import fit
    from smallwheel_ros.api.learn import learn
    from smallwheel_ros.api.predict import predict
    from smallwheel_ros.api.read import read
    from smallwheel_ros.api.replay import replay
    from smallwheel_ros.common.errors import SmallwheelError as Error
    from smallwheel_ros.measurements.measurements import Measurements
    from smallwheel_ros.model.model import Model
    from smallwheel_ros.physics.soil import Soil, soil

# The generated message modules are installed in site-packages. When Python is started in the
# checkout, the source folder would hide them; joining the two lets both be imported.
__path__ = extend_path(__path__, __name__)

# name: (module, attribute; "" for the module itself)
_PUBLIC = {
    "read": ("smallwheel_ros.api.read", "read"),
    "fit": ("smallwheel_ros.api.fit", "fit"),
    "compare": ("smallwheel_ros.api.compare", "compare"),
    "diagnose": ("smallwheel_ros.api.diagnose", "diagnose"),
    "learn": ("smallwheel_ros.api.learn", "learn"),
    "add": ("smallwheel_ros.api.add", "add"),
    "predict": ("smallwheel_ros.api.predict", "predict"),
    "replay": ("smallwheel_ros.api.replay", "replay"),
    "effects": ("smallwheel_ros.effects", ""),
    "soil": ("smallwheel_ros.physics.soil", "soil"),
    "Soil": ("smallwheel_ros.physics.soil", "Soil"),
    "Model": ("smallwheel_ros.model.model", "Model"),
    "Measurements": ("smallwheel_ros.measurements.measurements", "Measurements"),
    "Error": ("smallwheel_ros.common.errors", "SmallwheelError"),
}

__all__ = [
    "Error",
    "Measurements",
    "Model",
    "Soil",
    "__version__",
    "add",
    "compare",
    "diagnose",
    "effects",
    "fit",
    "learn",
    "predict",
    "read",
    "replay",
    "soil",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module, attribute = _PUBLIC[name]
    found = import_module(module)
    return getattr(found, attribute) if attribute else found


def __dir__() -> list[str]:
    return sorted(__all__)


class _Package(ModuleType):
    """The package in which `compare`, `learn` and `replay` are the functions, not the folders of those names.

    Importing a file of a folder would put the folder where the function belongs.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in _PUBLIC and _PUBLIC[name][1]):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
