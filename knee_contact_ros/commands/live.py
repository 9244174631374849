"""Commands that need ROS: demo, node, load, watch, replay."""

import os
import re
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from ..system.errors import UsageError
from ..system.files import missing_middleware
from ..system.terminal import warn
from .options import (
    FILE,
    BagNames,
    ParameterOptions,
    folder_option,
    json_option,
    names_in_bag_options,
    number_option,
    parameter_files_option,
    path_option,
    verbose_option,
)

_ROS_PATHS = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH")
"""Environment variables by which the setup file of a ROS puts itself on the path"""
_MAX_DOMAIN = 232
"""Largest ROS domain; the ports of further ones do not exist"""
_HOW = "docs/how-to/install.md in the package's sources says how to get it, under 'With ROS'"
_CLOCK = "--clock"
_NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?")


@click.command()
@path_option("--bag", "BAG", "[default: the right leg's gait]")
@parameter_files_option()
@click.option(
    "--from-sensors",
    is_flag=True,
    help="Play an encoder and an insole to the load node; the contact node answers its estimate. With --companion a "
    "controller assists the knee.",
)
@path_option(
    "--load-params",
    "FILE",
    "Parameter file of the load node, for --from-sensors. [default: load/gait2354]",
    "load_files",
    multiple=True,
)
@folder_option(
    "knee_contact_demo", "Folder for the results. Results of an earlier demo are replaced."
)
@number_option("--rate", 0.01, 100.0, 1.0, "Seconds of gait per second.")
@click.option(
    "--companion",
    is_flag=True,
    help="Also run the example of an assist controller, examples/assist_as_needed.py.",
)
@verbose_option
@json_option
def demo(
    bag: Path | None,
    parameter_files: tuple[Path, ...],
    from_sensors: bool,
    load_files: tuple[Path, ...],
    output: Path,
    rate: float,
    companion: bool,
) -> None:
    """Show the knee of a walking person.

    It starts the real node and replays a recorded gait over real topics, on this machine only. It records to MCAP,
    writes a Rerun file and prints the peaks.
    """
    if words := missing_middleware():  # the graph is its own, and what is there will do
        warn([f"{words}; the demo runs without it"])
        del os.environ["RMW_IMPLEMENTATION"]
    check_ros()
    from .demo import LOAD_FILE, run_demo

    if load_files and not from_sensors:
        raise click.UsageError("--load-params is for --from-sensors")
    of_load = ParameterOptions(load_files).files(LOAD_FILE) if from_sensors else []
    run_demo(bag, ParameterOptions(parameter_files).files(), of_load, companion, output, rate)


def check_ros(*, messages: bool = True) -> None:
    """Check that the chosen middleware is installed and can begin, and that ROS and our messages can be loaded.

    Raises:
        UsageError: ROS, the middleware or the messages are not installed, or another ROS is on the path, or a
            variable's value cannot be.
    """
    if find_spec("rclpy") is None:
        raise UsageError(f"this command needs ROS 2: {sys.executable} finds no rclpy. {_HOW}")
    if words := missing_middleware():
        raise UsageError(words)
    check_environment()
    # As under a service manager. ROS keeps its log there, and ends the process without it.
    os.environ.setdefault("HOME", str(Path("~").expanduser()))
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        advice = _HOW
        if given := [name for name in _ROS_PATHS if os.environ.get(name)]:
            advice = (
                f"is another ROS on the path, by {', '.join(given)}? Use a shell that has sourced none: env "
                f"{' '.join(f'-u {name}' for name in given)} ..."
            )
        raise UsageError(f"ROS cannot be loaded ({error}): {advice}") from None
    if messages and find_spec("knee_contact_ros.msg") is None:
        raise UsageError(
            f"this command needs the package's ROS messages, which were not built with it. {_HOW}"
        )


def check_environment() -> None:
    """Check variables for which ROS ends the process or gives no reason; warn if asked security is off.

    Raises:
        UsageError: there is no such domain, or no keystore where security is enforced.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "")
    if domain.isdecimal() and int(domain) > _MAX_DOMAIN:
        raise UsageError(
            f"ROS_DOMAIN_ID: {domain} is not allowed; it must be from 0 to {_MAX_DOMAIN}"
        )
    if os.environ.get("ROS_SECURITY_STRATEGY") == "Enforce":
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            needed = "ROS_SECURITY_STRATEGY=Enforce needs ROS_SECURITY_ENABLE=true, too"
            warn([f"nothing is encrypted: {needed}"])
        elif not keystore or not Path(keystore).is_dir():
            raise UsageError(
                f"ROS_SECURITY_KEYSTORE: {keystore!r} is no folder, and security is enforced"
            )


class RosCommand(click.Command):
    """Command that passes its arguments to ROS 2, even `-h` if it does not stand alone."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, or print its help text if the only argument asks for it."""
        if ctx.params["ros_arguments"] in (("--help",), ("-h",)):
            click.echo(ctx.get_help())
            return None
        check_ros()
        return super().invoke(ctx)


def run_kinds(ros_arguments: tuple[str, ...], realtime: bool, kinds: Sequence[Any]) -> None:
    """Run the nodes of some `kinds` until they end."""
    from ..node.managed_node import ROS_ARGUMENTS, run_nodes

    more = [ROS_ARGUMENTS, "-p", "realtime:=true"] if realtime else []
    if code := run_nodes([*ros_arguments, *more], kinds):
        sys.exit(code)


_realtime_option = click.option(
    "--realtime",
    is_flag=True,
    help="Schedule the node's threads before all ordinary processes (parameter realtime).",
)


_TO_ROS = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "help_option_names": list[str](),
}


@click.command(
    cls=RosCommand,
    context_settings=_TO_ROS,
    add_help_option=False,
    options_metavar="[--realtime] [--ros-args ...]",
)
@_realtime_option
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def node(ros_arguments: tuple[str, ...], realtime: bool) -> None:
    """Run the ROS 2 node that computes the contact.

    It takes ordinary ROS 2 arguments: --ros-args --params-file FILE -p NAME:=VALUE -r FROM:=TO ...
    """
    from ..node.contact_node import CONTACT_NODE

    run_kinds(ros_arguments, realtime, [CONTACT_NODE])


@click.command(
    cls=RosCommand,
    context_settings=_TO_ROS,
    add_help_option=False,
    options_metavar="[--with-contact] [--realtime] [--ros-args ...]",
)
@click.option(
    "--with-contact",
    is_flag=True,
    help="Run the contact node in the same process, which saves one message.",
)
@_realtime_option
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def load(ros_arguments: tuple[str, ...], with_contact: bool, realtime: bool) -> None:
    """Run the ROS 2 node that estimates the joint reaction force.

    It listens to joint_states and ground_reaction_force, and publishes joint_reaction_force and load_estimate. It takes
    ordinary ROS 2 arguments: --ros-args --params-file FILE -p NAME:=VALUE -r FROM:=TO ...
    """
    from ..node.load_node import LOAD_NODE, load_and_contact

    run_kinds(ros_arguments, realtime, load_and_contact() if with_contact else [LOAD_NODE])


@click.command()
@click.argument("name", metavar="[NODE]", default="")
@click.option(
    "--once",
    is_flag=True,
    help="Print one report, as soon as all is known; the exit code is 1 if the "
    "newest answer is not usable.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON in SI units, a line a second.")
@number_option("--wait", 0.1, 3600.0, 10.0, "With --once: wait for at most this long [s].")
def watch(name: str, once: bool, as_json: bool, wait: float) -> None:
    """Show what a running node hears and says, until Ctrl-C.

    NODE is its name, such as left/knee_contact; without it the only node with contacts is shown. On a terminal the
    picture stays in its place; elsewhere it is a line a second.
    """
    check_ros()
    from .watch import run_watch

    run_watch(name, once, as_json, wait)


class OptionalClockRate(click.Command):
    """A command whose option `--clock` may come without its number, also before the argument BAG."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Set a `--clock` without a number to 0: with every message."""
        for i, argument in enumerate(args):
            if argument == _CLOCK and not _NUMBER.fullmatch("".join(args[i + 1 : i + 2])):
                args = [*args[:i], f"{_CLOCK}=0", *args[i + 1 :]]
        return super().parse_args(ctx, args)


@click.command(cls=OptionalClockRate)
@click.argument("bag", type=FILE)
@number_option("--rate", 0.01, 100.0, 1.0, "Seconds of the bag per second.")
@click.option("--loop", is_flag=True, help="Start over at the end.")
@number_option(
    _CLOCK,
    0.0,
    10_000.0,
    None,
    "Publish /clock HZ times a second, or with every message without HZ.",
    "[HZ]",
)
@number_option("--start-offset", 0.0, 1e9, 0.0, "Skip the first SECONDS of the bag.", "SECONDS")
@number_option(
    "--duration", 0.0, 1e9, None, "Publish only SECONDS of the bag.", "SECONDS", min_open=True
)
@number_option("--delay", 0.0, 1e6, 0.0, "Wait SECONDS before the first message.", "SECONDS")
@click.option("--start-paused", is_flag=True, help="Wait for a key before the first message.")
@number_option("--wait", 0.0, 3600.0, 10.0, "Wait for subscribers for at most this long [s].")
@names_in_bag_options(
    "Publish into this namespace. Topics of the bag in this namespace are used if there are any, otherwise those "
    "without one."
)
@click.option(
    "--sensors",
    is_flag=True,
    help="Publish /ground_reaction_force for the load node instead of /joint_reaction_force.",
)
def replay(bag: Path, in_bag: BagNames, sensors: bool, **timing: Any) -> None:
    """Publish the inputs of a bag at the times of their stamps.

    BAG is an .mcap file, a .db3 file or a rosbag2 folder with the topics /joint_states and /joint_reaction_force. On a
    terminal, space pauses and resumes, s or the right arrow steps while paused, and the up and down arrows change the
    rate.
    """
    check_ros(messages=False)
    from ..bags.folder import others_beside
    from ..streams.topics import INPUTS, LOAD_INPUTS
    from .replay import Timing, has_inputs, run_replay

    warn(others_beside(bag))
    inputs = LOAD_INPUTS if sensors else INPUTS
    inside = in_bag if has_inputs(bag, in_bag.namespace, inputs) else in_bag._replace(namespace="")
    run_replay(bag, Timing(**timing), inside.names(*inputs), inputs, in_bag.namespace)
