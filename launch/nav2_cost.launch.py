# SPDX-License-Identifier: Apache-2.0
"""The node, and Nav2's servers that lead both costmaps to its grids.

    ros2 launch smallwheel_ros nav2_cost.launch.py params_file:=rover.yaml

Merge config/nav2_costmaps.yaml into your Nav2 parameters first; needs nav2_map_server and
nav2_lifecycle_manager. With namespace:=robot1 everything is below /robot1, and filter_info_topic in the
costmaps is /robot1/soil_filter_info and /robot1/soil_bare_filter_info.
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

# Name of each server, and the grid that it leads to.
SERVERS = {"soil_filter_info_server": "cost", "soil_bare_filter_info_server": "cost_bare"}


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("smallwheel_ros")
    sim_time = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    }
    namespace = LaunchConfiguration("namespace")

    def server(name: str, topic: str) -> Node:
        # A costmap takes a relative name for one of its own namespace, /robot1/local_costmap: a full name.
        grid = PythonExpression(
            [
                "'/'.join(['', *'",
                namespace,
                "'.strip('/').split(), 'mobility_estimator', '",
                topic,
                "'])",
            ]
        )
        return Node(
            package="nav2_map_server",
            executable="costmap_filter_info_server",
            name=name,
            namespace=namespace,
            output="screen",
            parameters=[
                LaunchConfiguration("filter_info_file"),
                sim_time,
                {"mask_topic": ParameterValue(grid, value_type=str)},
            ],
        )

    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "four_wheels.yaml"]),
                description="Parameters of the node: wheels, soil, noise (smallwheel init --template).",
            ),
            DeclareLaunchArgument(
                "filter_info_file",
                default_value=PathJoinSubstitution([share, "config", "nav2_filter_info.yaml"]),
                description="Parameters of both costmap_filter_info_servers.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Take the time from /clock: for bags and simulators.",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics."
            ),
            DeclareLaunchArgument(
                "remaps", default_value="", description="FROM:=TO, several with spaces between."
            ),
            DeclareLaunchArgument(
                "tf", default_value="/tf", description="Topic of transforms; Nav2's own is tf."
            ),
            DeclareLaunchArgument(
                "respawn", default_value="false", description="Start the node again if it dies."
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(
                    PathJoinSubstitution([share, "launch", "mobility_estimator.launch.py"])
                ),
                launch_arguments={
                    "params_file": LaunchConfiguration("params_file"),
                    "use_sim_time": LaunchConfiguration("use_sim_time"),
                    "namespace": namespace,
                    "remaps": LaunchConfiguration("remaps"),
                    "tf": LaunchConfiguration("tf"),
                    "respawn": LaunchConfiguration("respawn"),
                }.items(),
            ),
            *(server(name, topic) for name, topic in SERVERS.items()),
            # A manager of their own: these servers start with the node, whatever Nav2 does.
            Node(
                package="nav2_lifecycle_manager",
                executable="lifecycle_manager",
                name="lifecycle_manager_soil_filter",
                namespace=namespace,
                output="screen",
                parameters=[
                    sim_time,
                    {"autostart": True, "node_names": list(SERVERS)},
                ],
            ),
        ]
    )
