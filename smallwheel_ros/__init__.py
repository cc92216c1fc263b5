"""Terramechanics of small wheels for ROS 2: model, diagnosis, estimator and node.

The physics, the diagnosis and the command line work without ROS; only
:mod:`smallwheel_ros.ros` and the generated :mod:`smallwheel_ros.msg` need it.
"""

from __future__ import annotations

from pkgutil import extend_path

# The generated message modules are installed in site-packages. When Python is started in the
# checkout, the source folder would hide them; joining the two lets both be imported.
__path__ = extend_path(__path__, __name__)

__version__ = "0.1.0"
