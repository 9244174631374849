"""Commands that make a load to stream: load, estimate-load."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from knee_contact_ros.cli.options import found_file, names_in_bag_options, parameter_files_option, parameter_values
from knee_contact_ros.cli.output_option import Output
from knee_contact_ros.system.errors import IncompleteError

load_parameter_files = parameter_files_option(
    ": load/insole, load/inverse_dynamics, load/gait2354", "the knee and a vertical force"
)


@click.command(
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    add_help_option=False,
    options_metavar="[--with-contact] [--ros-args ...]",
)
@click.option("--with-contact", is_flag=True, help="Run the contact node in the same process: quicker by a hop.")
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def load(ros_arguments: tuple[str, ...], with_contact: bool) -> None:
    """Run the ROS 2 node that estimates the joint reaction force.

    It listens to joint_states and ground_reaction_force, and publishes joint_reaction_force and load_estimate. Takes
    ordinary ROS 2 arguments: --ros-args --params-file FILE -p NAME:=VALUE -r FROM:=TO ...
    """
    if ros_arguments in (("--help",), ("-h",)):
        click.echo(click.get_current_context().get_help())
        return
    from knee_contact_ros.node.load_session import LOAD_NODE
    from knee_contact_ros.node.node import run_nodes

    kinds = [LOAD_NODE]
    if with_contact:
        from knee_contact_ros.node.sensors_to_contact import load_and_contact

        kinds = [*load_and_contact()]
    if code := run_nodes(list(ros_arguments), kinds):
        sys.exit(code)


@click.command()
@click.argument("bag", type=click.Path(path_type=Path))
@load_parameter_files
@parameter_values
@click.option("--output", type=Output(".mcap"), required=True, metavar="OUT.mcap", help="Bag to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
@names_in_bag_options
def estimate_load(
    bag: Path,
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    output: Path,
    overwrite: bool,
    remaps: tuple[str, ...],
    namespace: str,
) -> None:
    """Estimate the joint reaction force of a bag, offline.

    BAG holds what sensors of a leg tell, on /joint_states and /ground_reaction_force. OUT.mcap gets them too, and
    /joint_reaction_force and /load_estimate, with the same numbers as the node's: `knee-contact solve OUT.mcap` goes on
    from there. Research only: muscles are not measured.
    """
    from knee_contact_ros.bags.bag_files import in_a_line, others_beside
    from knee_contact_ros.bags.topic_names import names_in_bag
    from knee_contact_ros.cli.load_table import show_load
    from knee_contact_ros.messages.topics import LOAD_INPUTS
    from knee_contact_ros.offline.estimate_load import estimate_load as estimate
    from knee_contact_ros.parameters.load_schema import LOAD_READING
    from knee_contact_ros.system.ros_arguments import parameters_of
    from knee_contact_ros.system.terminal import progress, warn

    parameters = LOAD_READING.load([*map(found_file, parameter_files), parameters_of(parameter_values)])
    names = names_in_bag(remaps, namespace, LOAD_INPUTS)
    with progress("Estimating") as advance:
        summary = estimate(bag, parameters, output, advance, overwrite, names)
    given = ", ".join([*map(str, parameter_files), *parameter_values]) or "the defaults"
    show_load(summary, parameters, {"parameters": given}, str(output))
    warn(others_beside(bag))
    if summary.damage:
        raise IncompleteError(f"bag {bag} is damaged, and read as far as it can be: {in_a_line(summary.damage)}")
