# SPDX-License-Identifier: Apache-2.0
"""A recorded drive through the node: the node by the bag's clock, and the bag played.

    ros2 launch smallwheel_ros replay.launch.py bag:=drive params_file:=rover.yaml

Plays with `smallwheel play`; the same without DDS, faster and with a report, is `smallwheel replay`.
"""

from __future__ import annotations

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("smallwheel_ros")
    program = PathJoinSubstitution(
        [FindPackagePrefix("smallwheel_ros"), "lib", "smallwheel_ros", "smallwheel"]
    )
    player = ExecuteProcess(
        cmd=[
            *(program, "play", LaunchConfiguration("bag")),
            *("--rate", LaunchConfiguration("rate"), "--wait", "60"),
        ],
        output="screen",
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="The bag: folder, .mcap, .db3 or .bag."),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "four_wheels.yaml"]),
                description="Parameters of the node: wheels, soil, noise (smallwheel init --template).",
            ),
            DeclareLaunchArgument(
                "rate", default_value="1.0", description="Times as fast as recorded."
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(
                    PathJoinSubstitution([share, "launch", "mobility_estimator.launch.py"])
                ),
                launch_arguments={
                    "params_file": LaunchConfiguration("params_file"),
                    "use_sim_time": "true",
                }.items(),
            ),
            # The player waits for a listener; others than the node may be there before it (rviz).
            TimerAction(period=3.0, actions=[player]),
            RegisterEventHandler(
                OnProcessExit(
                    target_action=player,
                    # and a moment for the last estimates
                    on_exit=[
                        TimerAction(
                            period=3.0,
                            actions=[EmitEvent(event=Shutdown(reason="the bag has been played"))],
                        )
                    ],
                )
            ),
        ]
    )
