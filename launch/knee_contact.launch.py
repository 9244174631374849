"""Contact node: `ros2 launch knee_contact_ros knee_contact.launch.py params:=FILE record:=FILE ...`.

Arguments that are given override the parameter file. `-s` lists all arguments. The other launch files include this one.
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"
ENDED, REFUSED = 0, 2
"""Exit codes of the node: as it was told to end, and because of a parameter"""
LEAST_DELAY = 0.1
"""Time [s] within which launch surely handles the end of a process"""


def mode_of(rerun):
    """Value of `rerun.mode` for the argument `rerun`, which is a mode or the name of a file."""
    return rerun if rerun in ("", "serve", "spawn") else "file"


def number(name, context, kind, least):
    """Number that was given as an argument, of a type `kind` and not below `least`."""
    text = LaunchConfiguration(name).perform(context)
    try:
        value = kind(text)
    except ValueError:
        value = None
    if value is None or not value >= least:
        raise RuntimeError(f"{name}:={text}: it must be a number, at least {least}")
    return value


def end_for_good(node):
    """Keep launch from restarting a node that was told to end, or whose parameters are refused at its first start.

    A node that is refused later had good parameters before, and is restarted.
    """
    codes = []

    def on_exit(event, _context):
        codes.append(event.returncode)
        if event.returncode != ENDED and codes != [REFUSED]:
            return []
        return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(node)))]

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=on_exit))


def knee_node(context):
    """Node with the parameters that were given as arguments; if it dies, it is restarted with the same ones."""
    kind = LaunchConfiguration("node").perform(context)
    rerun = LaunchConfiguration("rerun").perform(context)
    texts = {
        "knee.joint_name": LaunchConfiguration("joint").perform(context),
        "record.path": LaunchConfiguration("record").perform(context),
        "rerun.mode": mode_of(rerun),
        "rerun.path": rerun if mode_of(rerun) == "file" else "",
        "rerun.knees": LaunchConfiguration("rerun_knees").perform(context),
    }
    truths = {
        "autostart": LaunchConfiguration("autostart").perform(context),
        "use_sim_time": LaunchConfiguration("use_sim_time").perform(context),
    }
    given = {name: ParameterValue(text, value_type=str) for name, text in texts.items() if text}
    if LaunchConfiguration("rerun_port").perform(context):
        given["rerun.port"] = number("rerun_port", context, int, 1)
    given |= {name: truth == "true" for name, truth in truths.items() if truth}
    node = Node(
        package=PACKAGE,
        executable="knee_contact",
        arguments=["node" if kind == "contact" else kind],
        name=f"knee_{kind}",
        namespace=LaunchConfiguration("namespace"),
        # Not among `parameters`: launch leaves out a file that is not there, and the node would run with defaults.
        ros_arguments=[
            "--params-file",
            LaunchConfiguration("params"),
            "--log-level",
            LaunchConfiguration("log_level"),
        ],
        parameters=[given] if given else [],
        output="screen",
        respawn=LaunchConfiguration("respawn"),
        respawn_delay=number("respawn_delay", context, float, LEAST_DELAY),
    )
    return [end_for_good(node), node]


def generate_launch_description():
    healthy = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "healthy.yaml"])
    truth = ["", "true", "false"]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "node",
                default_value="contact",
                choices=["contact", "load"],
                description="which node it is",
            ),
            DeclareLaunchArgument(
                "params", default_value=healthy, description="ROS 2 parameter file"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the node and its topics"
            ),
            DeclareLaunchArgument("joint", default_value="", description="joint in joint_states"),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write"),
            DeclareLaunchArgument(
                "rerun",
                default_value="",
                description="Rerun file (.rrd) to write, or serve, or spawn",
            ),
            DeclareLaunchArgument("rerun_port", default_value="", description="to serve on"),
            DeclareLaunchArgument(
                "rerun_knees",
                default_value="",
                description="knees that share a viewer, as left,right",
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
            OpaqueFunction(function=knee_node),
        ]
    )
