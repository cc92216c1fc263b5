# SPDX-License-Identifier: Apache-2.0
"""Installation by pip, without ROS: the library and the command `smallwheel`.

Everything that can be said in pyproject.toml is there. With ROS, CMakeLists.txt installs.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup


def index_page() -> str:
    """README.md without its links into the repository: on a package index they would lead nowhere."""
    text = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    without_pictures = re.sub(r"!\[[^]]*\]\((?!https?:)[^)]*\)\n*", "", text)
    return re.sub(r"\[([^]]*)\]\((?!https?:|#)[^)]*\)", r"\1", without_pictures)


setup(
    long_description=index_page(),
    long_description_content_type="text/markdown",
    # The message definitions live in msg/, where rosidl needs them, and are installed into the
    # package as data; see smallwheel_ros/bags/types.py.
    packages=[
        *find_packages(include=["smallwheel_ros", "smallwheel_ros.*"]),
        "smallwheel_ros.definitions",
        "smallwheel_ros.views.web",  # script and look of pages
    ],
    package_dir={"smallwheel_ros.definitions": "msg"},
    package_data={
        "": ["*.yaml", "*.json", "*.csv", "*.html", "*.css", "*.js", "py.typed"],
        "smallwheel_ros.definitions": ["*.msg"],
        "smallwheel_ros.views.web": ["*"],
    },
)
