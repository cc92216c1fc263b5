# SPDX-License-Identifier: Apache-2.0
"""The node with a parameter file.

    ros2 launch smallwheel_ros mobility_estimator.launch.py params_file:=rover.yaml \
        remaps:="odom:=odometry/filtered joint_states:=wheels" namespace:=robot1 tf:=tf

The node configures and activates itself (its parameter autostart).
"""

from __future__ import annotations

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription


def _node(context: LaunchContext) -> list[Node]:
    """Make the node; its remaps are as many as there are words in the argument.

    Raises FileNotFoundError for parameters that are not there: launch would start the node without any.
    """
    parameters = Path(LaunchConfiguration("params_file").perform(context)).expanduser()
    if not parameters.is_file():
        raise FileNotFoundError(
            f"params_file:={parameters}: there is no such file (seen from {Path.cwd()})"
        )
    remaps = LaunchConfiguration("remaps").perform(context).split()
    tf = LaunchConfiguration("tf").perform(context)
    pairs = [tuple(remap.partition(":=")[::2]) for remap in remaps]
    if tf != "/tf":
        pairs += [("/tf", tf), ("/tf_static", f"{tf}_static")]
    return [
        Node(
            package="smallwheel_ros",
            executable="mobility_estimator",
            name="mobility_estimator",
            namespace=LaunchConfiguration("namespace"),
            output="screen",
            respawn=LaunchConfiguration("respawn").perform(context).lower() == "true",
            respawn_delay=2.0,
            remappings=pairs,
            parameters=[
                str(parameters),
                {
                    "use_sim_time": ParameterValue(
                        LaunchConfiguration("use_sim_time"), value_type=bool
                    )
                },
            ],
        )
    ]


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("smallwheel_ros")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "four_wheels.yaml"]),
                description="Parameters of the node: wheels, soil, noise (smallwheel init --template).",
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
            DeclareLaunchArgument(
                "tf", default_value="/tf", description="Topic of transforms; Nav2's own is tf."
            ),
            DeclareLaunchArgument(
                "respawn", default_value="false", description="Start the node again if it dies."
            ),
            OpaqueFunction(function=_node),
        ]
    )
