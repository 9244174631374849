"""Replay of a bag to the node: `ros2 launch knee_contact_ros replay.launch.py bag:=BAG rerun:=FILE view:=true ...`.

Starts the node, replays the bag as soon as the node listens, and then ends the node, which completes its files. `view`
opens the Rerun file at the end. `-s` lists all arguments.
"""

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

from launch import LaunchDescription

PACKAGE = "knee_contact_ros"
LAST_ANSWERS = 1.0
"""Time [s] that the node has for its last answers"""


def mode_of(rerun):
    """Value of `rerun.mode` for the argument `rerun`, which is a mode or the name of a file."""
    return rerun if rerun in ("", "serve", "spawn") else "file"


def knee_contact_node(context):
    """Node with the parameters that were given as arguments; the others come from the parameter file."""
    rerun = LaunchConfiguration("rerun").perform(context)
    mode = mode_of(rerun)
    texts = {
        "record.path": LaunchConfiguration("record").perform(context),
        "rerun.mode": mode,
        "rerun.path": rerun if mode == "file" else "",
    }
    given = {name: ParameterValue(text, value_type=str) for name, text in texts.items() if text}
    if LaunchConfiguration("clock").perform(context) == "true":
        given["use_sim_time"] = True
    return Node(
        package=PACKAGE,
        executable="knee_contact",
        arguments=["node"],
        name="knee_contact",
        namespace="/",  # a full name, or the parameters below would give way to those under a full name in the file
        # Not among `parameters`: launch leaves out a file that is not there, and the node would run with defaults.
        ros_arguments=["--params-file", LaunchConfiguration("params")],
        parameters=[given] if given else [],
        output="screen",
    )


def replay_process(context):
    """Process of the replay, which takes no ROS arguments. It waits for the node, which may have to compile first."""
    command = [
        ExecutableInPackage(package=PACKAGE, executable="knee_contact"),
        "replay",
        LaunchConfiguration("bag"),
    ]
    command += ["--rate", LaunchConfiguration("rate"), "--wait", "300"]
    if LaunchConfiguration("loop").perform(context) == "true":
        command += ["--loop"]
    if LaunchConfiguration("clock").perform(context) == "true":
        command += ["--clock"]
    return ExecuteProcess(cmd=command, name="replay", output="screen")


def node_and_replay(context):
    """Node and replay, and the actions when one of them ends."""
    node = knee_contact_node(context)
    replay = replay_process(context)
    rerun = LaunchConfiguration("rerun").perform(context)
    view = LaunchConfiguration("view").perform(context) == "true"
    if view and mode_of(rerun) != "file":
        raise RuntimeError("view:=true needs rerun:=FILE")

    def after_node(event, _context):
        if view and event.returncode == 0:
            command = [
                ExecutableInPackage(package=PACKAGE, executable="knee_contact"),
                "view",
                rerun,
            ]
            return [ExecuteProcess(cmd=command, name="view", output="screen")]
        return [Shutdown(reason="the node has ended")]

    stop_node = EmitEvent(event=ShutdownProcess(process_matcher=matches_action(node)))
    return [
        RegisterEventHandler(OnProcessExit(target_action=node, on_exit=after_node)),
        RegisterEventHandler(
            OnProcessExit(
                target_action=replay,
                on_exit=[TimerAction(period=LAST_ANSWERS, actions=[stop_node])],
            )
        ),
        node,
        replay,
    ]


def generate_launch_description():
    share = FindPackageShare(PACKAGE)
    gait = PathJoinSubstitution([share, "bags", "gait2354_right"])
    healthy = PathJoinSubstitution([share, "config", "healthy.yaml"])
    truth = ["true", "false"]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "bag", default_value=gait, description=".mcap file or rosbag2 folder"
            ),
            DeclareLaunchArgument(
                "rate", default_value="1.0", description="seconds of the bag per second"
            ),
            DeclareLaunchArgument(
                "loop", default_value="false", choices=truth, description="start over at the end"
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="false",
                choices=truth,
                description="publish /clock, go by it",
            ),
            DeclareLaunchArgument(
                "params", default_value=healthy, description="ROS 2 parameter file"
            ),
            DeclareLaunchArgument("record", default_value="", description="MCAP file to write"),
            DeclareLaunchArgument(
                "rerun",
                default_value="",
                description="Rerun file (.rrd) to write, or serve, or spawn",
            ),
            DeclareLaunchArgument(
                "view", default_value="false", choices=truth, description="open the Rerun file"
            ),
            OpaqueFunction(function=node_and_replay),
        ]
    )
