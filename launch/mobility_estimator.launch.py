# SPDX-License-Identifier: Apache-2.0
"""The node with a parameter file.

    ros2 launch smallwheel_ros mobility_estimator.launch.py params_file:=rover.yaml

The node configures and activates itself (its parameter autostart).
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("smallwheel_ros")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "four_wheels.yaml"]),
                description="Parameters of the node: wheels, soil, noise (docs/parameters.md).",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Take the time from /clock: for bags and simulators.",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of node and topics."
            ),
            Node(
                package="smallwheel_ros",
                executable="mobility_estimator",
                name="mobility_estimator",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    LaunchConfiguration("params_file"),
                    {
                        "use_sim_time": ParameterValue(
                            LaunchConfiguration("use_sim_time"), value_type=bool
                        )
                    },
                ],
            ),
        ]
    )
