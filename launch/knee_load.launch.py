"""Load node: `ros2 launch knee_contact_ros knee_load.launch.py params:=FILE record:=FILE ...`.

It estimates the joint reaction force for the contact node, which is launched by `knee_contact.launch.py`. Arguments
that are given override the parameter file.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"


def generate_launch_description():
    insole = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "load", "insole.yaml"])
    node = PathJoinSubstitution([ThisLaunchFileDir(), "knee_contact.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params", default_value=insole, description="ROS 2 parameter file"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the node and its topics"
            ),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write"),
            DeclareLaunchArgument(
                "respawn",
                default_value="true",
                choices=["true", "false"],
                description="start a node that died again",
            ),
            DeclareLaunchArgument(
                "respawn_delay", default_value="1.0", description="[s] before that"
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="debug, info, warn, error or fatal"
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(node),
                launch_arguments={
                    "node": "load",
                    "params": LaunchConfiguration("params"),
                    "namespace": LaunchConfiguration("namespace"),
                    "record": LaunchConfiguration("record"),
                    "respawn": LaunchConfiguration("respawn"),
                    "respawn_delay": LaunchConfiguration("respawn_delay"),
                    "log_level": LaunchConfiguration("log_level"),
                }.items(),
            ),
        ]
    )
