"""RViz with a replay: `ros2 launch knee_contact_ros rviz.launch.py bag:=BAG frame:=FRAME ...`.

Replays the bag through the node again and again (replay.launch.py, whose other arguments may be given too) until RViz
is closed. RViz shows `knee_contact/markers`, and shank and thigh (urdf/knee.urdf) as `joint_states` moves them. With
`replay:=false clock:=false` it is RViz alone, beside a node that runs. Needs the packages rviz2, tf2_ros and
robot_state_publisher. `-s` lists all arguments.
"""

from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    OpaqueFunction,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import FileContent, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"
ISB = "tibia_isb"
"""Name of the tibia frame in the URDF"""


def viewers(context):
    """RViz, and the nodes that publish where shank and thigh are."""
    share = FindPackageShare(PACKAGE)
    urdf = FileContent(PathJoinSubstitution([share, "urdf", "knee.urdf"]))
    layout = PathJoinSubstitution([share, "config", "rviz", "knee_contact.rviz"])
    time = {"use_sim_time": LaunchConfiguration("clock").perform(context) == "true"}
    body = {"robot_description": ParameterValue(urdf, value_type=str)} | time
    nodes = [
        Node(
            package="robot_state_publisher", executable="robot_state_publisher", parameters=[body]
        ),
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["--display-config", layout],
            parameters=[time],
            on_exit=Shutdown(reason="RViz was closed"),
        ),
    ]
    frame = LaunchConfiguration("frame").perform(context)
    if frame != ISB:
        same = ["--frame-id", ISB, "--child-frame-id", frame]
        nodes.append(
            Node(package="tf2_ros", executable="static_transform_publisher", arguments=same)
        )
    return nodes


def generate_launch_description():
    share = FindPackageShare(PACKAGE)
    gait = PathJoinSubstitution([share, "bags", "gait2354_right"])
    replay = PathJoinSubstitution([share, "launch", "replay.launch.py"])
    truth = ["true", "false"]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "bag", default_value=gait, description=".mcap file or rosbag2 folder"
            ),
            DeclareLaunchArgument(
                "frame", default_value="tibia_r", description="frame_id of the forces"
            ),
            DeclareLaunchArgument(
                "replay", default_value="true", choices=truth, description="with node and bag"
            ),
            DeclareLaunchArgument(
                "loop", default_value="true", choices=truth, description="start over at the end"
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="true",
                choices=truth,
                description="publish /clock, go by it",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(replay),
                launch_arguments={
                    "bag": LaunchConfiguration("bag"),
                    "loop": LaunchConfiguration("loop"),
                    "clock": LaunchConfiguration("clock"),
                }.items(),
                condition=IfCondition(LaunchConfiguration("replay")),
            ),
            OpaqueFunction(function=viewers),
        ]
    )
