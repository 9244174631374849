"""Commands that make bags and sensor parameters of other programs' files: import-opensim, import-csv, align."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.commands.options import FILE, Output

sensor_map_option = click.option(
    "--map",
    "maps",
    type=FILE,
    required=True,
    multiple=True,
    metavar="MAP.yaml",
    help="Which columns are what, in which units and signs; the later of several wins, name by name. The package has "
    "locohub.",
)


@click.command("import-opensim")
@click.option("--kinematics", type=FILE, metavar="Q.sto", help="Of IK, RRA, CMC, or states.")
@click.option("--reactions", type=FILE, metavar="JR.sto", help="Of a JointReaction analysis.")
@click.option("--speeds", type=FILE, metavar="U.sto", help="Rates of the angles; else they are derived.")
@click.option(
    "--model",
    type=FILE,
    metavar="M.osim",
    help="Tells the sign of flexion where the angles do not, and the body weight.",
)
@click.option(
    "--ground",
    is_flag=False,
    flag_value="",
    metavar="[GRF.xml|GRF.mot]",
    help="External loads or ground reactions: also what the leg's sensors would have told, for estimate-load (hip, "
    "ankle, ground_reaction_force). Needs --model and the extra opensim; with --setup the file may be left out.",
)
@click.option(
    "--joint", metavar="NAME", help="Joint of the reactions. [default: the one with knee and side in its name]"
)
@click.option("--coordinate", metavar="NAME", help="Column or coordinate of the angle. [default: likewise]")
@click.option(
    "--angle-unit",
    type=click.Choice(["auto", "deg", "rad"]),
    default="auto",
    show_default=True,
    help="auto: as header and values say.",
)
@click.option(
    "--angle-sign",
    type=click.Choice(["auto", "1", "-1"]),
    default="auto",
    show_default=True,
    help="-1: flexion is negative in the file.",
)
@click.option("--start", type=float, metavar="S", help="Leave out what is earlier [s].")
@click.option("--end", type=float, metavar="S", help="Leave out what is later [s].")
@click.option(
    "--rate",
    type=click.FloatRange(0.0, 10_000.0),
    default=200.0,
    show_default=True,
    metavar="HZ",
    help="Interpolate both; 0: every row keeps its stamp.",
)
@click.option(
    "--setup",
    "setups",
    multiple=True,
    type=FILE,
    metavar="FOLDER|FILE",
    help="Run OpenSim instead (extra opensim): the folder with the set-up files, or each "
    "of them. It is copied, and stays as it is.",
)
@click.option(
    "--steps",
    metavar="LIST",
    default="",
    help="For --setup: of scale,ik,rra,cmc,static; what is left out must be in the folder. static is quicker than "
    "cmc, and is set up from cmc's file if it has none. [default: all there are]",
)
@click.option(
    "--work", type=Output(folder=True), metavar="DIR", help="For --setup: a new folder that keeps logs and all results."
)
@click.option("--side", type=click.Choice(["right", "left", "both"]), required=True, help="both: a bag for each.")
@click.option(
    "--output",
    type=Output(),
    required=True,
    metavar="BAG",
    help="rosbag2 folder to write; of both sides BAG_right and BAG_left.",
)
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
@click.option("--anyway", is_flag=True, help="Write it although something is likely a mistake; that is then a warning.")
def import_opensim(side: str, output: Path, overwrite: bool, **options: Any) -> None:
    """Make a gait bag of OpenSim's results, or run OpenSim first.

    Columns are found by their names, units and signs by header and values; what is not clear is asked for. The
    reaction must act on the tibia and be expressed in its frame; a left knee is mirrored to a right one.
    """
    from knee_contact_ros.lab.opensim.command import import_opensim as import_all

    import_all(side, output, overwrite, **options)


@click.command("import-csv")
@click.argument("files", type=FILE, metavar="FILE...", nargs=-1, required=True)
@sensor_map_option
@click.option("--output", type=Output(), required=True, metavar="BAG", help="rosbag2 folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
@click.option("--anyway", is_flag=True, help="Write it although something is likely a mistake; that is then a warning.")
def import_csv(files: tuple[Path, ...], maps: tuple[Path, ...], output: Path, overwrite: bool, anyway: bool) -> None:
    """Make a gait bag of a laboratory's own files.

    FILE is a text table (CSV) or an OpenSim file (.sto, .mot); of several, each channel is taken from the one that has
    its columns. MAP.yaml says which columns are what, in which units. What cannot be a knee's is refused in one line.
    """
    from knee_contact_ros.lab.sensors import import_csv as import_files

    import_files(files, maps, output, overwrite=overwrite, anyway=anyway)


@click.command()
@click.argument("files", type=FILE, metavar="FILE...", nargs=-1, required=True)
@sensor_map_option
@click.option("--output", type=Output(".yaml"), required=True, metavar="OUT.yaml", help="Parameter file to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.yaml if it exists.")
@click.option(
    "--longest-lag",
    type=click.FloatRange(0.01, 1.0),
    default=0.25,
    show_default=True,
    metavar="S",
    help="Lags that are tried, to both sides [s]; less than half a stride.",
)
def align(files: tuple[Path, ...], maps: tuple[Path, ...], output: Path, overwrite: bool, longest_lag: float) -> None:
    """Find out what an angle sensor is off by.

    Offset and lag of the map's angle against its reference, from the files that import-csv takes, as
    knee.flexion_offset and pairing.angle_delay for --params. A gain that is wrong is told.
    """
    from knee_contact_ros.lab.align import align as align_files

    align_files(files, maps, output, longest_lag, overwrite=overwrite)
