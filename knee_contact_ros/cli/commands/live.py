"""Commands that need ROS: demo, node, replay."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from knee_contact_ros.cli.options import (
    OptionalClockRate,
    found,
    found_file,
    names_in_bag_options,
    parameter_files,
    timing_options,
)
from knee_contact_ros.cli.output_option import Output


@click.command()
@click.option("--bag", type=click.Path(path_type=Path), metavar="BAG", help="[default: the right leg's gait]")
@parameter_files
@click.option(
    "--from-sensors",
    is_flag=True,
    help="Play an encoder and an insole to the load node, whose estimate the contact node answers; --companion "
    "assists the knee.",
)
@click.option(
    "--load-params",
    "load_files",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Parameter file of the load node, for --from-sensors. [default: load/gait2354]",
)
@click.option(
    "--output",
    type=Output(folder=True),
    default="knee_contact_demo",
    show_default=True,
    metavar="DIR",
    help="Where the results go; those of an earlier demo are replaced.",
)
@click.option(
    "--rate", type=click.FloatRange(0.01, 100.0), default=1.0, show_default=True, help="Seconds of gait per second."
)
@click.option(
    "--companion", is_flag=True, help="Run the example of an assist controller beside it: examples/assist_as_needed.py."
)
def demo(
    bag: Path | None,
    parameter_files: tuple[Path, ...],
    from_sensors: bool,
    load_files: tuple[Path, ...],
    output: Path,
    rate: float,
    companion: bool,
) -> None:
    """See the knee of a walking person.

    Starts the real node, replays a recorded gait over real topics on this machine only, records to MCAP, writes a
    Rerun file and prints the peaks.
    """
    from knee_contact_ros.offline.demo import Recorded, Source, run_demo
    from knee_contact_ros.offline.demo_sensors import LOAD_FILE, Sensors
    from knee_contact_ros.system.resources import share_folder

    if load_files and not from_sensors:
        raise click.UsageError("--load-params is for --from-sensors")
    files = found(parameter_files)
    source: Source
    if from_sensors:
        source = Sensors(bag, files, [found_file(name) for name in load_files or (Path(LOAD_FILE),)], companion)
    else:
        source = Recorded(bag or share_folder() / "bags" / "gait2354_right", files, companion)
    run_demo(source, output, rate)


@click.command(
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    add_help_option=False,
    options_metavar="[--ros-args ...]",
)
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def node(ros_arguments: tuple[str, ...]) -> None:
    """Run the ROS 2 node.

    Takes ordinary ROS 2 arguments: --ros-args --params-file FILE -p NAME:=VALUE -r FROM:=TO ...
    """
    if ros_arguments in (("--help",), ("-h",)):
        click.echo(click.get_current_context().get_help())
        return
    from knee_contact_ros.node.contact_session import CONTACT_NODE
    from knee_contact_ros.node.node import run_nodes

    if code := run_nodes(list(ros_arguments), [CONTACT_NODE]):
        sys.exit(code)


@click.command(cls=OptionalClockRate)
@click.argument("bag", type=click.Path(path_type=Path))
@timing_options
@names_in_bag_options
@click.option(
    "--sensors", is_flag=True, help="Publish /ground_reaction_force for the load node, and not /joint_reaction_force."
)
def replay(bag: Path, remaps: tuple[str, ...], namespace: str, sensors: bool, **timing: Any) -> None:
    """Publish a bag's input topics in time.

    BAG is an .mcap file, a .db3 file or a rosbag2 folder with the topics /joint_states and /joint_reaction_force.
    On a terminal, space pauses and goes on, s or the right arrow steps while paused, the up and down arrows change the
    rate.
    """
    from knee_contact_ros.bags.bag_files import others_beside
    from knee_contact_ros.bags.topic_names import names_in_bag
    from knee_contact_ros.messages.topics import INPUTS, LOAD_INPUTS
    from knee_contact_ros.offline.replay.replay import Timing, run_replay
    from knee_contact_ros.system.terminal import warn

    warn(others_beside(bag))
    inputs = LOAD_INPUTS if sensors else INPUTS
    run_replay(bag, Timing(**timing), names_in_bag(remaps, namespace, inputs), inputs)
