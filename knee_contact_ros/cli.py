"""The command `knee-contact`.

Bad input ends it with code 2 and one line, a full disk or a damaged bag with 1, Ctrl-C with 130.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from knee_contact_ros import __version__
from knee_contact_ros.errors import IncompleteError, UsageError
from knee_contact_ros.options import (
    DEFAULT_PARAMETERS,
    OptionalClockRate,
    names_in_bag_options,
    opensim_results_options,
    opensim_run_options,
    parameter_files,
    parameter_values,
    timing_options,
)
from knee_contact_ros.profiles.options import fit_profile_options

INTERRUPTED = 130


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, package_name="knee_contact_ros", message="%(prog)s %(version)s")
def knee_contact() -> None:
    """Live tibiofemoral contact from streamed gait. A research tool, not a medical device."""


@knee_contact.command()
@click.option("--bag", type=click.Path(path_type=Path), metavar="BAG", help="[default: the right leg's gait]")
@parameter_files
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
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
def demo(bag: Path | None, parameter_files: tuple[Path, ...], output: Path, rate: float, companion: bool) -> None:
    """See the knee of a walking person.

    Starts the real node, replays a recorded gait over real topics on this machine only, records to MCAP, writes a
    Rerun file and prints the peaks.
    """
    from knee_contact_ros.demo import run_demo
    from knee_contact_ros.resources import share_folder

    run_demo(bag or share_folder() / "bags" / "gait2354_right", found(parameter_files), output, rate, companion)


@knee_contact.command(
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
    from knee_contact_ros.node import run_node

    run_node(list(ros_arguments))


@knee_contact.command(cls=OptionalClockRate)
@click.argument("bag", type=click.Path(path_type=Path))
@timing_options
@names_in_bag_options
def replay(bag: Path, remaps: tuple[str, ...], namespace: str, **timing: Any) -> None:
    """Publish a bag's input topics in time.

    BAG is an .mcap file, a .db3 file or a rosbag2 folder with the topics /joint_states and /joint_reaction_force.
    On a terminal, space pauses and goes on, s or the right arrow steps while paused, the up and down arrows change the
    rate.
    """
    from knee_contact_ros.stream_in.names import names_in_bag
    from knee_contact_ros.stream_in.replay import Timing, run_replay

    run_replay(bag, Timing(**timing), names_in_bag(remaps, namespace))


@knee_contact.command()
@click.argument("bag", type=click.Path(path_type=Path), required=False)
@parameter_files
@parameter_values
@click.option(
    "--subject",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Subject file: body mass, profile, cartilage thickness and bag; --params and -p win over it.",
)
@click.option(
    "--output", type=click.Path(path_type=Path), required=True, metavar="OUT.mcap", help="Recording to write."
)
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
    from knee_contact_ros.parameters import load_parameters
    from knee_contact_ros.provenance import read_provenance, with_values
    from knee_contact_ros.ros_spelling import parameters_of
    from knee_contact_ros.salvage.source import in_a_line
    from knee_contact_ros.solve import solve as solve_bag
    from knee_contact_ros.stream_in.names import names_in_bag
    from knee_contact_ros.subject import Subject
    from knee_contact_ros.terminal import progress, show_summary

    person = Subject(subject) if subject else None
    bag = bag or (person.bag if person else None)
    if bag is None:
        raise UsageError("no BAG: give one, or --subject with a file that names one")
    stored = None if parameter_files or person else read_provenance(bag)
    values = parameters_of(parameter_values)
    sources = [*person.sources(), *map(found_file, parameter_files)] if person else found(parameter_files)
    how = with_values(stored, values) if stored else load_parameters([*sources, values])
    names = names_in_bag(remaps, namespace)
    with progress("Solving") as advance:
        summary = solve_bag(bag, how, output, advance, overwrite, names)
    given = (subject, *parameter_files) if subject else parameter_files or (DEFAULT_PARAMETERS,)
    files = ", ".join(map(str, given))
    source = f"those in {bag.name}, made with {stored.package}" if stored else files
    rows = {"parameters": ", ".join([source, *parameter_values])}
    show_summary(summary, rows, {"Recording": str(output)})
    if summary.split and summary.split.problem:
        click.echo(f"knee-contact: warning: {summary.split.problem}", err=True)
    if summary.damage:
        raise IncompleteError(f"bag {bag} is damaged, and solved as far as it can be read: {in_a_line(summary.damage)}")


@knee_contact.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@parameter_files
@parameter_values
@click.option("--save", type=click.Path(path_type=Path), metavar="OUT.rrd", help="Write a Rerun file instead.")
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
    side by side. FILE can also be a Rerun file, or the address that a node logs when it serves (rerun.mode serve).
    """
    from knee_contact_ros.parameters import load_parameters
    from knee_contact_ros.ros_spelling import parameters_of
    from knee_contact_ros.view.run import Way, run_view

    parameters = load_parameters([*found(parameter_files), parameters_of(parameter_values)])
    run_view(sources, parameters, Way(save, overwrite, serve, port))


@knee_contact.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE...")
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default="knee_contact_report",
    show_default=True,
    metavar="DIR",
    help="Where the page, its figures and data go; those of an earlier report are replaced.",
)
@parameter_files
@parameter_values
@click.option(
    "--compare",
    "compare",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Compute each FILE again with this parameter file over its own parameters, as --compare osteoarthritis.yaml, "
    "and show it beside. Can be given several times, the later one wins.",
)
@click.option("--label", "labels", multiple=True, metavar="TEXT", help="Name of a FILE; once for each, in their order.")
@names_in_bag_options
def report(
    files: tuple[Path, ...],
    output: Path,
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    compare: tuple[Path, ...],
    labels: tuple[str, ...],
    remaps: tuple[str, ...],
    namespace: str,
) -> None:
    """Write figures and tables that need no viewer.

    A page (report.html, which needs no other file), figures (PNG) and data (CSV). FILEs are recordings of ours, or
    bags with the inputs, which are computed with --params; several are shown side by side, as both knees. Needs
    pip install 'knee-contact-ros[report]'.
    """
    from knee_contact_ros.report.run import run_report
    from knee_contact_ros.report.runs import Asked
    from knee_contact_ros.ros_spelling import parameters_of
    from knee_contact_ros.stream_in.names import names_in_bag

    values = parameters_of(parameter_values)
    sources: list[Path | dict[str, Any]] = [*found(parameter_files), *([values] if values else [])]
    given, names = bool(parameter_files or values), names_in_bag(remaps, namespace)
    compared = found(compare) if compare else []
    for path in run_report(Asked(files, labels, sources, given, compared, names), output):
        click.echo(str(path))


@knee_contact.command("fit-profile")
@click.argument("mesh", type=click.Path(path_type=Path), metavar="MESH")
@fit_profile_options
def fit_profile(mesh: Path, side: str, compartment: str, tolerance: float, slab: float, **others: Any) -> None:
    """From a mesh of cartilage to a profile.

    Cuts MESH (STL, PLY, OBJ, VTP; points as text; a NIfTI label map), smooths the articular side of the slice, and
    writes
    it as femur.profile and tibia.profile take it, with a picture and a parameter file beside it. Needs
    pip install 'knee-contact-ros[mesh]'.
    """
    from knee_contact_ros.profiles.run import Asked, run_fit_profile

    asked = Asked(
        mesh,
        femur=side == "femur",
        medial=compartment == "medial",
        tolerance=1e-3 * tolerance,
        slab=1e-3 * slab,
        **others,
    )
    for line in run_fit_profile(asked):
        click.echo(line)


@knee_contact.command()
@click.argument("source", type=click.Path(path_type=Path), metavar="IN")
@click.argument("output", type=click.Path(path_type=Path), metavar="OUT.mcap")
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
def recover(source: Path, output: Path, overwrite: bool) -> None:
    """Make a cut-off recording whole again.

    Writes all that can be read of the MCAP file IN (ours: *.mcap.partial) to OUT.mcap, and says what is missing. IN
    stays as it is.
    """
    from knee_contact_ros.salvage.recover import recover as recover_file
    from knee_contact_ros.terminal import progress, show_recovery

    with progress("Recovering") as advance:
        recovery = recover_file(source, output, advance, overwrite)
    show_recovery(recovery, str(output))


@knee_contact.command("import-opensim")
@opensim_results_options
@opensim_run_options
@click.option("--side", type=click.Choice(["right", "left", "both"]), required=True, help="both: a bag for each.")
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="BAG",
    help="rosbag2 folder to write; of both sides BAG_right and BAG_left.",
)
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
def import_opensim(side: str, output: Path, overwrite: bool, **options: Any) -> None:
    """Make a gait bag of OpenSim's results, or run OpenSim first.

    Columns are found by their names, units and signs by header and values; what is not clear is asked for. The
    reaction must act on the tibia and be expressed in its frame; a left knee is mirrored to a right one.
    """
    from knee_contact_ros.importers.run import import_opensim as import_all

    import_all(side, options, output, overwrite)


@knee_contact.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default="knee_contact_trade",
    show_default=True,
    metavar="DIR",
    help="Where trade.md, trade.csv and trade.png go.",
)
@click.option("--problem", "problems", multiple=True, metavar="NAME", help="Can be given several times. [default: all]")
@click.option(
    "--solver",
    "solvers",
    multiple=True,
    metavar="NAME",
    help="Name or its beginning, as SciPy; can be given several times. [default: all that are installed]",
)
@click.option("--repeat", type=click.IntRange(1, 100), default=3, show_default=True, help="Repetitions of short runs.")
def trade(output: Path, problems: tuple[str, ...], solvers: tuple[str, ...], repeat: int) -> None:
    """Measure what precision costs.

    Work and precision of this model and of what could be taken instead (SciPy, CVODE, MuJoCo, Exudyn, Drake, OpenSim:
    pip install 'knee-contact-ros[trade]'). All of it takes some ten minutes.
    """
    from knee_contact_ros.trade.run import run_trade

    run_trade(output, problems, solvers, repeat)


@knee_contact.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default="knee_contact_latency",
    show_default=True,
    metavar="DIR",
    help="Where the pages and their data go; those of an earlier run are replaced.",
)
@click.option(
    "--rate", type=click.FloatRange(10.0, 20_000.0), default=1000.0, show_default=True, help="Samples per second."
)
@click.option(
    "--duration", type=click.FloatRange(0.5, 3600.0), default=20.0, show_default=True, help="Seconds of a run."
)
@click.option(
    "--rounds", type=click.IntRange(1, 100), default=3, show_default=True, help="How often all candidates take turns."
)
@click.option("--sustained", is_flag=True, help="Search the highest rate that each candidate sustains instead.")
@click.option(
    "--soak",
    type=click.IntRange(1, 1_000_000_000),
    metavar="TICKS",
    help="Run the node alone for so many ticks at --rate instead: its memory, and what it recorded.",
)
def latency(output: Path, rate: float, duration: float, rounds: int, sustained: bool, soak: int | None) -> None:
    """Measure the node beside a bare one.

    Latency, losses and CPU time of the node, recording and drawing, and of bare rclpy nodes that compute nothing, over
    real topics on this machine only. Writes latency.md and latency.csv (sustained.*, soak.*).
    """
    from knee_contact_ros.latency.run import Asked, run_latency

    run_latency(output, Asked(rate, duration, rounds, sustained, soak or 0))


def found(files: tuple[Path, ...]) -> list[Path]:
    """Parameter files as given, or from the package's config folder."""
    return [found_file(name) for name in files or (Path(DEFAULT_PARAMETERS),)]


def found_file(name: Path) -> Path:
    """A parameter file as given, or from the package's config folder."""
    from knee_contact_ros.resources import find_file

    return find_file(str(name))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit code."""
    try:
        knee_contact.main(arguments, prog_name="knee-contact", standalone_mode=False)
    except (UsageError, IncompleteError) as error:
        return fail(str(error), code=2 if isinstance(error, UsageError) else 1)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "knee-contact"
        return fail(f"{error.format_message().rstrip('.')}; see {command} --help")
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # the reader of our output has gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        return fail(f"{error.filename or 'writing'}: {error.strerror or error}", code=1)
    except (click.Abort, KeyboardInterrupt):
        click.echo("knee-contact: interrupted", err=True)
        return INTERRUPTED
    return 0


def fail(text: str, code: int = 2) -> int:
    """Say in one line what is wrong."""
    click.echo(f"knee-contact: {' '.join(text.split())}", err=True)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
