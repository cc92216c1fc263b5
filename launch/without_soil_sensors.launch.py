# SPDX-License-Identifier: Apache-2.0
"""The node of a vehicle that measures neither sinkage nor load: slip, grip, risk and warnings.

    ros2 launch smallwheel_ros without_soil_sensors.launch.py params_file:=rover.yaml

It is mobility_estimator.launch.py with config/without_soil_sensors.yaml to begin with.
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("smallwheel_ros")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "without_soil_sensors.yaml"]),
                description="Parameters of the node: wheels, mass, topics (docs/parameters.md).",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Take the time from /clock: for bags and simulators.",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of node and topics."
            ),
            DeclareLaunchArgument(
                "remaps", default_value="", description="FROM:=TO, several with spaces between."
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(
                    PathJoinSubstitution([share, "launch", "mobility_estimator.launch.py"])
                ),
                launch_arguments={
                    "params_file": LaunchConfiguration("params_file"),
                    "use_sim_time": LaunchConfiguration("use_sim_time"),
                    "namespace": LaunchConfiguration("namespace"),
                    "remaps": LaunchConfiguration("remaps"),
                }.items(),
            ),
        ]
    )
