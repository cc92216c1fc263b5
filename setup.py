"""Installation by pip, without ROS: the library and the command `smallwheel`.

Everything that can be said in pyproject.toml is there. With ROS, CMakeLists.txt installs.
"""

from setuptools import find_packages, setup

setup(
    # The message definitions live in msg/, where rosidl needs them, and are installed into the
    # package as data; see smallwheel_ros/interfaces.py.
    packages=[
        *find_packages(include=["smallwheel_ros", "smallwheel_ros.*"]),
        "smallwheel_ros.definitions",
    ],
    package_dir={"smallwheel_ros.definitions": "msg"},
    package_data={
        "": ["*.yaml", "*.json", "*.csv", "*.html", "*.css", "*.js", "py.typed"],
        "smallwheel_ros.definitions": ["*.msg"],
        "smallwheel_ros.report": ["web/*"],  # script and look of pages, uPlot with its licence
    },
)
