"""Load node: `ros2 launch knee_contact_ros knee_load.launch.py params:=FILE record:=FILE ...`.

It estimates the joint reaction force for the contact node, which is launched by `knee_contact.launch.py`.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"


def generate_launch_description():
    insole = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "load", "insole.yaml"])
    record = ParameterValue(LaunchConfiguration("record"), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument("params", default_value=insole, description="ROS 2 parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="of the node and its topics"),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write"),
            DeclareLaunchArgument(
                "respawn", default_value="true", choices=["true", "false"], description="start a node that died again"
            ),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            Node(
                package=PACKAGE,
                executable="knee_contact",
                arguments=["load"],
                name="knee_load",
                namespace=LaunchConfiguration("namespace"),
                ros_arguments=[
                    "--params-file", LaunchConfiguration("params"), "--log-level", LaunchConfiguration("log_level"),
                ],
                parameters=[{"record.path": record}],
                output="screen",
                respawn=LaunchConfiguration("respawn"),
                respawn_delay=1.0,
            ),
        ]
    )  # fmt: skip
