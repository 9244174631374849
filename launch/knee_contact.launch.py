"""The node: `ros2 launch knee_contact_ros knee_contact.launch.py [params:=FILE] [namespace:=NAME] [record:=FILE]`."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    healthy = PathJoinSubstitution([FindPackageShare("knee_contact_ros"), "config", "healthy.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("params", default_value=healthy, description="ROS 2 parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node and its topics"),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write; empty: none"),
            Node(
                package="knee_contact_ros",
                executable="knee_contact",
                arguments=["node"],
                name="knee_contact",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params"), {"record.path": LaunchConfiguration("record")}],
                output="screen",
            ),
        ]
    )
