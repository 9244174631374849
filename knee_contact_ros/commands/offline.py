"""Commands that need no ROS and no laboratory: solve, estimate-load, recover, view, table, cite, about."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from ..system.errors import CommandError, IncompleteError, UsageError, join_faults
from ..system.files import DEFAULT_PARAMETERS, check_distinct, require
from ..system.output_files import check_name_free, check_not_input, write_complete
from ..system.portable import link_or_copy
from ..system.progress import progress
from ..system.terminal import as_json, print_json, say, warn
from .options import (
    FILE,
    BagNames,
    Output,
    ParameterOptions,
    input_path,
    json_option,
    names_in_bag_options,
    number_option,
    output_option,
    overwrite_option,
    parameter_options,
    path_option,
    verbose_option,
)

_MAX_NAME_LENGTH = 80
"""Most letters in the name of several bags together"""


@contextmanager
def merged_bags(bags: Sequence[Path]) -> Iterator[Path]:
    """Yield a bag, or a folder with links to the files of several bags, which are read together by time.

    Errors that the folder causes name the files as they were given.

    Raises:
        UsageError: a bag is given twice or does not exist, or it is not clear which files belong to it.
    """
    from ..bags.folder import files_of
    from ..bags.metadata_file import METADATA

    if len(bags) == 1:
        yield bags[0]
        return
    check_distinct(bags)
    if missing := [bag for bag in bags if not bag.exists()]:
        raise UsageError(f"no bag at {missing[0]}: give an .mcap file or a rosbag2 folder")
    files = [file for bag in bags for file in files_of(bag)]
    links = [f"{file.stem}.{number}{file.suffix}" for number, file in enumerate(files)]
    with TemporaryDirectory(prefix="knee_contact_bags_") as work:
        folder = Path(work, "+".join(bag.name for bag in bags)[:_MAX_NAME_LENGTH])
        folder.mkdir()
        for link, file in zip(links, files, strict=True):
            link_or_copy(file, folder / link)
        content = {"relative_file_paths": links, "topics_with_message_count": []}
        # JSON is YAML.
        text = json.dumps({"rosbag2_bagfile_information": content})
        (folder / METADATA).write_text(text, encoding="utf-8")
        try:
            yield folder
        except CommandError as error:
            text = str(error)
            for link, file in zip(links, files, strict=True):
                text = text.replace(str(folder / link), link).replace(link, str(file))
            raise type(error)(text.replace(str(folder), " and ".join(map(str, bags)))) from None


@click.command()
@click.argument("bags", type=FILE, nargs=-1, metavar="[BAG]...")
@parameter_options()
@path_option(
    "--subject",
    "FILE",
    "Subject file: body mass, profile, cartilage thickness and bag. --params and -p override it.",
)
@output_option(
    "OUT.mcap", "Recording to write.", ".mcap", replace="Replace OUT.mcap if it exists."
)
@names_in_bag_options()
@verbose_option
@json_option
def solve(
    bags: tuple[Path, ...],
    given: ParameterOptions,
    subject: Path | None,
    output: Path,
    overwrite: bool,
    in_bag: BagNames,
) -> None:
    """Compute a bag offline.

    It needs no ROS, runs as fast as the machine allows, and gives the same numbers as the node. BAG is an .mcap file, a
    .db3 file or a rosbag2 folder with the topics /joint_states and /joint_reaction_force. If BAG is a recording of this
    package, its own parameters are used unless you give --params. If a bag is damaged, the command computes what it can
    read, says what is missing, and ends with code 1. Several bags, for example one from each machine, are read as one.
    """
    from ..bags.bag import Bag
    from ..bags.folder import others_beside
    from ..bags.provenance import Provenance
    from ..offline.bag_parameters import (
        basis_of,
        resolved_parameters,
        weight_doubt,
        weight_row,
    )
    from ..offline.solve import solve as solve_bag
    from ..parameters.subjects import Subject
    from .tables import show_summary

    person = Subject(subject) if subject else None
    bags = bags or ((person.bag,) if person and person.bag else ())
    if not bags:
        raise UsageError("no BAG: give a BAG, or a --subject file that names one")
    with merged_bags(bags) as path, Bag(path) as bag:
        in_bag = in_bag.found_in(bag)
        basis = basis_of(
            bag, given.parameter_files or None, given.values(), person, in_bag.namespace
        )
        with progress("Solving") as advance:
            summary = solve_bag(bag, basis, output, advance, overwrite, in_bag.names())
        files = (
            (subject, *given.parameter_files)
            if subject
            else given.parameter_files or (DEFAULT_PARAMETERS,)
        )
        sources = (
            [f"those in {path.name}, made with {basis.package}"]
            if isinstance(basis, Provenance)
            else files
        )
        rows = {"parameters": ", ".join(map(str, [*sources, *given.parameter_values]))}
        if (parameters := resolved_parameters(basis)).load.rule == "fixed_share":
            rows["load"] = f"{parameters.load.share:.4g} of the axial force (load.share)"
        rows |= weight_row(bag, parameters)
        show_summary(summary, rows, {"Recording": str(output)})
        warn(sentence for one in bags for sentence in others_beside(one))
        warn(weight_doubt(bag, parameters))
        warn(summary.warnings)
        is_given = bool(given.parameter_files or given.parameter_values or person)
        if missing := summary.missing_parts(path, is_given):
            raise IncompleteError(missing)


@click.command()
@click.argument("bag", type=FILE)
@parameter_options(
    ": load/insole, load/inverse_dynamics, load/gait2354", "the knee and a vertical force"
)
@output_option("OUT.mcap", "Bag to write.", ".mcap", replace="Replace OUT.mcap if it exists.")
@names_in_bag_options()
@json_option
def estimate_load(
    bag: Path, given: ParameterOptions, output: Path, overwrite: bool, in_bag: BagNames
) -> None:
    """Estimate the joint reaction force of a bag, offline.

    BAG holds a leg's sensors on /joint_states and /ground_reaction_force. OUT.mcap gets these topics,
    /joint_reaction_force and /load_estimate, with the same numbers as the node's. Next, run `knee-contact solve
    OUT.mcap`. For research only: muscles are not measured.
    """
    from ..bags.bag import Bag
    from ..bags.folder import others_beside
    from ..offline.bag_parameters import unset_person, weight_doubt
    from ..offline.estimate_load import estimate_load as estimate
    from ..offline.estimate_load import load_parameters_for
    from ..streams.topics import LOAD_INPUTS
    from .tables import show_load

    with Bag(bag) as opened:
        in_bag = in_bag.found_in(opened, *LOAD_INPUTS)
        parameters, without, doubts = load_parameters_for(
            opened, given.files(None), given.values(), in_bag.namespace
        )
        names = in_bag.names(*LOAD_INPUTS)
        with progress("Estimating") as advance:
            summary = estimate(opened, parameters, output, advance, overwrite, names)
        doubts += weight_doubt(opened, parameters)
    sources = ", ".join(map(str, [*(given.parameter_files or [without]), *given.parameter_values]))
    weight = f"{parameters.person.constants.weight:.7g} N{unset_person(parameters)}"
    rows = {"parameters": sources, "body weight": weight}
    show_load(summary, parameters, rows, str(output))
    warn([*others_beside(bag), *doubts, *summary.implausible])
    if summary.damage:
        raise IncompleteError(
            f"bag {bag} is damaged, and read as far as it can be: {join_faults(summary.damage)}"
        )


@click.command()
@click.argument("source", type=FILE, metavar="IN")
@click.argument("output", type=Output(".mcap"), metavar="OUT.mcap")
@overwrite_option("Replace OUT.mcap if it exists.")
@json_option
def recover(source: Path, output: Path, overwrite: bool) -> None:
    """Repair a recording that was cut off.

    It writes what it can read of the MCAP file IN to OUT.mcap, and says what is missing. IN is not changed. An
    unfinished recording of this package ends in .mcap.partial.
    """
    from ..bags.recover import recover as recover_file
    from .tables import show_recovery

    with progress("Recovering") as advance:
        recovery = recover_file(source, output, advance, overwrite)
    show_recovery(recovery, str(output))


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@parameter_options()
@click.option(
    "--save",
    type=Output(".rrd"),
    metavar="OUT.rrd",
    help="Write a Rerun file instead of opening a window.",
)
@overwrite_option("Replace OUT.rrd if it exists.")
@click.option(
    "--serve",
    is_flag=True,
    help="Serve the scene to browsers and viewers on this machine instead.",
)
@number_option("--port", 1024, 65534, 9876, "Port for --serve. The next port is used too.")
def view(
    sources: tuple[str, ...],
    given: ParameterOptions,
    save: Path | None,
    overwrite: bool,
    serve: bool,
    port: int,
) -> None:
    """Show recordings in Rerun.

    FILE is a recording with answers, or a bag with inputs, which is computed first. A recording of this package is
    drawn with its own parameters, any other file with those of --params. Several knees stand side by side. FILE can
    also be a Rerun file, or the address that a node (rerun.mode serve) or --serve prints.
    """
    from ..view.output import require_viewer

    for source in sources:
        if "://" not in source:
            input_path(source)
    require_viewer()  # before what imports its library
    from .view import run_view

    run_view(sources, given, save, overwrite, serve, port)


@click.command()
@click.argument("bag", type=FILE)
@output_option(
    "OUT",
    "Table to write: .csv or .parquet.",
    ".csv",
    ".parquet",
    replace="Replace OUT if it exists.",
)
@click.option(
    "--topic",
    default="",
    metavar="NAME",
    help="Write the answers on this topic only. [default: all topics]",
)
@click.option(
    "--units", is_flag=True, help="Write the units into the header of a .csv file: load [N]."
)
@json_option
def table(bag: Path, output: Path, overwrite: bool, topic: str, units: bool) -> None:
    """Write the answers of a recording as a table.

    The table has one row for each answer, in SI units: time, run, and every number of the message. Each component of a
    vector has its own column. If there are several topics (knees, compartments), they follow each other and a column
    names them. A .parquet file also holds units, parameters and version. BAG is a recording, or the output of `solve`.
    """
    from ..bags.answers import answer_topics, read_answers
    from ..bags.bag import Bag
    from ..bags.folder import files_of
    from ..bags.names import absolute
    from ..bags.provenance import read_provenance
    from ..parameters.files import flat_parameters
    from ..results import answer_table

    check_not_input(output, files_of(bag))
    if not overwrite:
        check_name_free(output)
    with Bag(bag) as recording:
        topics = [absolute(topic)] if topic else answer_topics(recording)
        recording.check_content()
        if not topics:
            raise UsageError(f"{bag} has no answers: knee-contact solve computes them")
        if output.suffix == ".parquet":
            require("tables", "pyarrow")
        answers = {name: read_answers(recording, name) for name in topics}
        known = read_provenance(recording)
    given, package = (flat_parameters(known.parameters), known.package) if known else (None, "?")
    content = answer_table(answers, output.suffix, given, package, with_units=units)
    write_complete({output: content})
    if as_json():
        numbers = {name: len(rows) for name, rows in answers.items()}
        print_json(answers=numbers, files={"Table": output})
    else:
        say(f"{output}: {sum(map(len, answers.values()))} answers of {', '.join(topics)}")


@click.command()
@click.argument("bag", type=FILE)
@json_option
def cite(bag: Path) -> None:
    """Print what a paper cites of a recording.

    These are software, model, contact law, surfaces and load, with constants and sources. BAG is a recording, the
    output of `solve` or `estimate-load`, or an imported bag. The page "Write your methods" has sentences for a paper.
    """
    from ..bags.bag import Bag
    from ..offline.citation import citation

    with Bag(bag) as opened:
        parts = citation(opened)
        damage = opened.damage
    if as_json():
        print_json(**parts)
    else:
        for name, text in parts.items():
            say(f"{name}: {text}", hang=2)
    if damage:
        raise IncompleteError(f"bag {bag} is damaged: {join_faults(damage)}")


@click.command()
def about() -> None:
    """Tell the system, all versions and what is compiled."""
    from .about import print_about

    print_about()
