"""Commands that need no ROS, on bags and recordings: solve, estimate-load, recover."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.cli.options import (
    DEFAULT_PARAMETERS,
    FILE,
    Output,
    find_parameters,
    names_in_bag_options,
    parameter_files,
    parameter_files_option,
    parameter_values,
)
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.errors import IncompleteError, UsageError


@click.command()
@click.argument("bag", type=FILE, required=False)
@parameter_files
@parameter_values
@click.option(
    "--subject",
    type=FILE,
    metavar="FILE",
    help="Subject file: body mass, profile, cartilage thickness and bag; --params and -p win over it.",
)
@click.option("--output", type=Output(".mcap"), required=True, metavar="OUT.mcap", help="Recording to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
@names_in_bag_options
def solve(
    bag: Path | None,
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    subject: Path | None,
    output: Path,
    overwrite: bool,
    remaps: tuple[str, ...],
    namespace: str,
) -> None:
    """Compute a bag offline.

    As fast as the machine allows, without ROS, and with the same numbers as the node's. BAG is an .mcap file, a .db3
    file or a rosbag2 folder with the topics /joint_states and /joint_reaction_force. A recording of ours is computed
    again with the parameters stored in it, unless --params is given. Of a damaged bag, what can be read is computed;
    the command then says what is missing, and ends with code 1.
    """
    from knee_contact_ros.bags.bag_files import in_a_line, others_beside
    from knee_contact_ros.bags.provenance import Provenance
    from knee_contact_ros.bags.topic_names import names_in_bag
    from knee_contact_ros.offline.in_memory import basis_of
    from knee_contact_ros.offline.solve import solve as solve_bag
    from knee_contact_ros.offline.summary_table import show_summary
    from knee_contact_ros.parameters.files import Subject
    from knee_contact_ros.system.files import parameters_of
    from knee_contact_ros.system.terminal import progress, warn

    person = Subject(subject) if subject else None
    bag = bag or (person.bag if person else None)
    if bag is None:
        raise UsageError("no BAG: give one, or --subject with a file that names one")
    basis = basis_of(bag, parameter_files or None, parameters_of(parameter_values), person)
    names = names_in_bag(remaps, namespace)
    with progress("Solving") as advance:
        summary = solve_bag(bag, basis, output, advance, overwrite, names)
    given = (subject, *parameter_files) if subject else parameter_files or (DEFAULT_PARAMETERS,)
    files = ", ".join(map(str, given))
    source = f"those in {bag.name}, made with {basis.package}" if isinstance(basis, Provenance) else files
    rows = {"parameters": ", ".join([source, *parameter_values])}
    show_summary(summary, rows, {"Recording": str(output)})
    warn(others_beside(bag))
    warn(summary.warnings)
    if summary.damage:
        raise IncompleteError(f"bag {bag} is damaged, and solved as far as it can be read: {in_a_line(summary.damage)}")


@click.command()
@click.argument("bag", type=FILE)
@parameter_files_option(": load/insole, load/inverse_dynamics, load/gait2354", "the knee and a vertical force")
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
    from knee_contact_ros.offline.estimate_load import estimate_load as estimate
    from knee_contact_ros.parameters.schema import LoadParameters
    from knee_contact_ros.streams.topics import LOAD_INPUTS
    from knee_contact_ros.system.files import parameters_of
    from knee_contact_ros.system.terminal import progress, warn

    parameters = load_parameters(
        [*find_parameters(parameter_files, None), parameters_of(parameter_values)], LoadParameters
    )
    names = names_in_bag(remaps, namespace, LOAD_INPUTS)
    with progress("Estimating") as advance:
        summary = estimate(bag, parameters, output, advance, overwrite, names)
    given = ", ".join([*map(str, parameter_files), *parameter_values]) or "the defaults"
    show_load(summary, parameters, {"parameters": given}, str(output))
    warn(others_beside(bag))
    if summary.damage:
        raise IncompleteError(f"bag {bag} is damaged, and read as far as it can be: {in_a_line(summary.damage)}")


@click.command()
@click.argument("source", type=FILE, metavar="IN")
@click.argument("output", type=Output(".mcap"), metavar="OUT.mcap")
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
def recover(source: Path, output: Path, overwrite: bool) -> None:
    """Make a cut-off recording whole again.

    Writes all that can be read of the MCAP file IN (ours end in .mcap.partial) to OUT.mcap, and says what is missing.
    IN stays as it is.
    """
    from knee_contact_ros.bags.recover import recover as recover_file
    from knee_contact_ros.cli.recovery_table import show_recovery
    from knee_contact_ros.system.terminal import progress

    with progress("Recovering") as advance:
        recovery = recover_file(source, output, advance, overwrite)
    show_recovery(recovery, str(output))
