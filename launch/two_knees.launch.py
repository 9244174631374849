"""Both knees: `ros2 launch knee_contact_ros two_knees.launch.py left_params:=FILE right_params:=FILE ...`.

Two nodes, in the namespaces `left` and `right`: `/left/joint_states` and `/left/joint_reaction_force` give
`/left/knee_contact`, and so on. If one topic has the angles of both knees, say which joint is which:
`joint_states:=/joint_states left_joint:=left_knee right_joint:=right_knee`. With `rerun:=serve` one viewer shows both:
`knee-contact view rerun+http://127.0.0.1:9876/proxy rerun+http://127.0.0.1:9877/proxy`. The arguments `autostart`,
`use_sim_time`, `respawn`, `respawn_delay` and `log_level` are those of knee_contact.launch.py, for both. `-s` lists all
arguments.
"""

from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import SetRemap
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"


def arguments(side):
    healthy = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "healthy.yaml"])
    return [
        DeclareLaunchArgument(
            f"{side}_params", default_value=healthy, description="ROS 2 parameter file"
        ),
        DeclareLaunchArgument(
            f"{side}_joint", default_value="", description="joint in joint_states"
        ),
        DeclareLaunchArgument(
            f"{side}_record", default_value="", description="MCAP file to write"
        ),
        DeclareLaunchArgument(
            f"{side}_rerun",
            default_value=LaunchConfiguration("rerun"),
            description="Rerun file (.rrd) to write",
        ),
    ]


def knee(side, port):
    node = PathJoinSubstitution([ThisLaunchFileDir(), "knee_contact.launch.py"])
    return GroupAction(
        [
            SetRemap("joint_states", LaunchConfiguration("joint_states")),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(node),
                launch_arguments={
                    "namespace": side,
                    "params": LaunchConfiguration(f"{side}_params"),
                    "joint": LaunchConfiguration(f"{side}_joint"),
                    "record": LaunchConfiguration(f"{side}_record"),
                    "rerun": LaunchConfiguration(f"{side}_rerun"),
                    "rerun_port": port,
                    "rerun_knees": "left,right",
                    "autostart": LaunchConfiguration("autostart"),
                    "use_sim_time": LaunchConfiguration("use_sim_time"),
                    "respawn": LaunchConfiguration("respawn"),
                    "respawn_delay": LaunchConfiguration("respawn_delay"),
                    "log_level": LaunchConfiguration("log_level"),
                }.items(),
            ),
        ]
    )


def generate_launch_description():
    truth = ["", "true", "false"]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "rerun", default_value="", description="serve: both knees to one viewer"
            ),
            *arguments("left"),
            *arguments("right"),
            DeclareLaunchArgument(
                "joint_states", default_value="joint_states", description="topic of the angles"
            ),
            DeclareLaunchArgument(
                "autostart",
                default_value="",
                choices=truth,
                description="configure and activate without being asked",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="", choices=truth, description="go by /clock"
            ),
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
            knee("left", "9876"),
            knee("right", "9877"),
        ]
    )
