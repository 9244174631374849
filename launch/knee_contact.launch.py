"""The node: `ros2 launch knee_contact_ros knee_contact.launch.py params:=FILE record:=FILE ...`.

What is not given is as the parameter file says. `-s` lists all arguments.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"


def knee_contact_node(context):
    """The node with the parameters that were given as arguments."""
    texts = {
        "knee.joint_name": LaunchConfiguration("joint").perform(context),
        "record.path": LaunchConfiguration("record").perform(context),
        "rerun.mode": "file" if LaunchConfiguration("rerun").perform(context) else "",
        "rerun.path": LaunchConfiguration("rerun").perform(context),
    }
    truths = {
        "autostart": LaunchConfiguration("autostart").perform(context),
        "use_sim_time": LaunchConfiguration("use_sim_time").perform(context),
    }
    given = {name: ParameterValue(text, value_type=str) for name, text in texts.items() if text}
    given |= {name: truth == "true" for name, truth in truths.items() if truth}
    return [
        Node(
            package=PACKAGE,
            executable="knee_contact",
            arguments=["node"],
            name="knee_contact",
            namespace=LaunchConfiguration("namespace"),
            # Not among `parameters`: launch leaves out a file that is not there, and the node would run with defaults.
            ros_arguments=[
                "--params-file", LaunchConfiguration("params"), "--log-level", LaunchConfiguration("log_level")
            ],
            parameters=[given] if given else [],
            output="screen",
        )
    ]  # fmt: skip


def generate_launch_description():
    healthy = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "healthy.yaml"])
    truth = ["", "true", "false"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("params", default_value=healthy, description="ROS 2 parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="of the node and its topics"),
            DeclareLaunchArgument("joint", default_value="", description="joint in joint_states"),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write"),
            DeclareLaunchArgument("rerun", default_value="", description="Rerun file (.rrd) to write"),
            DeclareLaunchArgument(
                "autostart", default_value="", choices=truth, description="configure and activate without being asked"
            ),
            DeclareLaunchArgument("use_sim_time", default_value="", choices=truth, description="go by /clock"),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            OpaqueFunction(function=knee_contact_node),
        ]
    )
