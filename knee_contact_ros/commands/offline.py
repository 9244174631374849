"""Commands that need no ROS: solve, estimate-load, recover, view, warm."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.commands.options import (
    DEFAULT_PARAMETERS,
    FILE,
    Output,
    check_input,
    find_parameters,
    names_in_bag_options,
    parameter_files,
    parameter_files_option,
    parameter_values,
)
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
@names_in_bag_options()
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
    from knee_contact_ros.bags.provenance import Provenance, weight_of
    from knee_contact_ros.bags.reader import names_in_bag, others_beside
    from knee_contact_ros.commands.tables import show_summary
    from knee_contact_ros.offline.solve import Subject, basis_of, parameters_in, weight_doubt
    from knee_contact_ros.offline.solve import solve as solve_bag
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.system.errors import in_a_line
    from knee_contact_ros.system.terminal import progress, warn

    person = Subject(subject) if subject else None
    bag = bag or (person.bag if person else None)
    if bag is None:
        raise UsageError("no BAG: give one, or --subject with a file that names one")
    basis = basis_of(bag, parameter_files or None, parameters_of(parameter_values), person, namespace)
    names = names_in_bag(remaps, namespace)
    with progress("Solving") as advance:
        summary = solve_bag(bag, basis, output, advance, overwrite, names)
    given = (subject, *parameter_files) if subject else parameter_files or (DEFAULT_PARAMETERS,)
    files = ", ".join(map(str, given))
    source = f"those in {bag.name}, made with {basis.package}" if isinstance(basis, Provenance) else files
    rows = {"parameters": ", ".join([source, *parameter_values])}
    parameters = parameters_in(basis)
    if weight_of(bag) == parameters.body_weight:
        rows["body weight"] = f"{parameters.body_weight:.7g} N, as {bag.name} was imported with"
    show_summary(summary, rows, {"Recording": str(output)})
    warn(others_beside(bag))
    warn(weight_doubt(bag, parameters))
    warn(summary.warnings)
    damage = f" is damaged, and solved as far as it can be read: {in_a_line(summary.damage)}" if summary.damage else ""
    if damage or summary.unanswered:
        raise IncompleteError(f"bag {bag}{damage}" + (f": {summary.unanswered}" if summary.unanswered else ""))


@click.command()
@click.argument("bag", type=FILE)
@parameter_files_option(": load/insole, load/inverse_dynamics, load/gait2354", "the knee and a vertical force")
@parameter_values
@click.option("--output", type=Output(".mcap"), required=True, metavar="OUT.mcap", help="Bag to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
@names_in_bag_options()
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
    from knee_contact_ros.bags.reader import names_in_bag, others_beside
    from knee_contact_ros.commands.tables import show_load
    from knee_contact_ros.offline.estimate_load import estimate_load as estimate
    from knee_contact_ros.offline.estimate_load import load_parameters_for
    from knee_contact_ros.offline.solve import weight_doubt
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.streams.topics import LOAD_INPUTS
    from knee_contact_ros.system.errors import in_a_line
    from knee_contact_ros.system.terminal import progress, warn

    parameters, without, doubts = load_parameters_for(
        bag, find_parameters(parameter_files, None), parameters_of(parameter_values), namespace
    )
    names = names_in_bag(remaps, namespace, LOAD_INPUTS)
    with progress("Estimating") as advance:
        summary = estimate(bag, parameters, output, advance, overwrite, names)
    given = ", ".join([*(map(str, parameter_files) if parameter_files else [without]), *parameter_values])
    rows = {"parameters": given, "body weight": f"{parameters.person.constants.weight:.7g} N"}
    show_load(summary, parameters, rows, str(output))
    warn([*others_beside(bag), *weight_doubt(bag, parameters), *doubts])
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
    from knee_contact_ros.commands.tables import show_recovery
    from knee_contact_ros.system.terminal import progress

    with progress("Recovering") as advance:
        recovery = recover_file(source, output, advance, overwrite)
    show_recovery(recovery, str(output))


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@parameter_files
@parameter_values
@click.option("--save", type=Output(".rrd"), metavar="OUT.rrd", help="Write a Rerun file instead.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.rrd if it exists.")
@click.option("--serve", is_flag=True, help="Serve it to browsers and viewers on this machine instead.")
@click.option(
    "--port", type=click.IntRange(1024, 65534), default=9876, show_default=True, help="For --serve; and the next one."
)
def view(
    sources: tuple[str, ...],
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    save: Path | None,
    overwrite: bool,
    serve: bool,
    port: int,
) -> None:
    """See recordings in Rerun.

    FILE is a recording with answers, or a bag with inputs, which is computed first. A recording of ours is drawn with
    the parameters stored in it, others with those of --params. Several knees, of one recording or of several, are seen
    side by side. FILE can also be a Rerun file, or the address that a node (rerun.mode serve) or
    --serve tells.
    """
    from knee_contact_ros.view.viewer import executable

    for source in sources:
        check_input(Path(source))  # an address is no path that is there
    executable()  # before what imports its library
    from knee_contact_ros.bags.reader import others_beside
    from knee_contact_ros.commands.view import ViewOptions, run_view
    from knee_contact_ros.parameters.files import load_parameters
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.system.terminal import warn

    warn(sentence for source in sources for sentence in others_beside(Path(source)))
    parameters = load_parameters([*find_parameters(parameter_files), parameters_of(parameter_values)])
    run_view(sources, parameters, ViewOptions(save, overwrite, serve, port))


@click.command()
@click.argument("bag", type=FILE)
@click.option(
    "--output", type=Output(".csv", ".parquet"), required=True, metavar="OUT", help="Table to write: .csv or .parquet."
)
@click.option("--topic", default="", metavar="NAME", help="Answers of this topic. [default: of all of them]")
def table(bag: Path, output: Path, topic: str) -> None:
    """Write answers as a table.

    One row an answer, in SI units: time, run, and every number of the message; vectors are columns of their components.
    Several topics (knees, compartments) follow each other, with their names in a column. BAG is a recording, or a bag
    that `solve` has made.
    """
    from knee_contact_ros.bags.reader import absolute, answer_topics, read_answers
    from knee_contact_ros.results import answer_table
    from knee_contact_ros.system.files import require
    from knee_contact_ros.system.output_files import write_complete
    from knee_contact_ros.system.terminal import say

    topics = [absolute(topic)] if topic else answer_topics(bag)
    if not topics:
        raise UsageError(f"{bag} has no answers: knee-contact solve computes them")
    if output.suffix == ".parquet":
        require("tables", "pyarrow")
    answers = {name: read_answers(bag, name) for name in topics}
    write_complete({output: answer_table(answers, output.suffix)})
    say(f"{output}: {sum(map(len, answers.values()))} answers of {', '.join(topics)}")


@click.command()
@parameter_files
@parameter_values
def warm(parameter_files: tuple[Path, ...], parameter_values: tuple[str, ...]) -> None:
    """Compile the model ahead of its first use.

    An installation does so by itself. The compiled model is for every kind of knee; --params and -p are only checked.
    It is kept beside the package if you can write there, else in $XDG_CACHE_HOME/knee_contact_ros or
    ~/.cache/knee_contact_ros, for this version of the model, of its compiler and of Python on this kind of processor.
    What is kept already is left as it is.
    """
    from knee_contact_ros.model.compiler import compiled_run, folders, kept_files
    from knee_contact_ros.model.ticks import run
    from knee_contact_ros.parameters.build import load_model
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.system.errors import IncompleteError, UsageError
    from knee_contact_ros.system.terminal import say

    if parameter_files or parameter_values:
        load_model([*find_parameters(parameter_files), parameters_of(parameter_values)], compiled=False)
    before, compiled, after = kept_files(), compiled_run(), kept_files()
    if compiled and after:
        say("was there already" if set(before) == set(after) else "compiled")
        say(f"kept in {after[0].parent}")
        return
    places = folders(run)
    if len(places) == 1:
        raise UsageError(
            f"XDG_CACHE_HOME is not set, and this user has no home and cannot write in {places[0]}: there is no folder "
            "to keep the compiled model in"
        )
    raise IncompleteError(f"the model could not be compiled and kept in {places[0]} or {places[1]}")
