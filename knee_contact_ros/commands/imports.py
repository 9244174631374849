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
    help="Says which column is what, and its unit and sign. Can be given several times; later names win. The package "
    "has locohub.",
)


@click.command("import-opensim")
@click.option("--kinematics", type=FILE, metavar="Q.sto", help="Angles from IK, RRA or CMC, or a file of states.")
@click.option("--reactions", type=FILE, metavar="JR.sto", help="Reactions of a JointReaction analysis.")
@click.option("--speeds", type=FILE, metavar="U.sto", help="Rates of the angles. [default: derived from the angles]")
@click.option(
    "--model",
    type=FILE,
    metavar="M.osim",
    help="Model, for the body weight, and for the sign of flexion if the angles do not show it.",
)
@click.option(
    "--ground",
    is_flag=False,
    flag_value="",
    metavar="[GRF.xml|GRF.mot]",
    help="External loads or ground reactions. The bag then also gets hip, ankle and ground_reaction_force for "
    "estimate-load. Needs --model and the extra opensim. With --setup you may leave out the file.",
)
@click.option(
    "--joint", metavar="NAME", help="Joint of the reactions. [default: the one with knee and side in its name]"
)
@click.option(
    "--coordinate",
    metavar="NAME",
    help="Column or coordinate of the angle. [default: the one with knee and side in its name]",
)
@click.option(
    "--angle-unit",
    type=click.Choice(["auto", "deg", "rad"]),
    default="auto",
    show_default=True,
    help="Unit of the angle. auto: from the header and the values.",
)
@click.option(
    "--angle-sign",
    type=click.Choice(["auto", "1", "-1"]),
    default="auto",
    show_default=True,
    help="Sign of the angle. -1: flexion is negative in the file.",
)
@click.option("--start", type=float, metavar="S", help="Leave out earlier samples [s].")
@click.option("--end", type=float, metavar="S", help="Leave out later samples [s].")
@click.option(
    "--rate",
    type=click.FloatRange(0.0, 10_000.0),
    default=200.0,
    show_default=True,
    metavar="HZ",
    help="Interpolate angles and reactions to this rate. 0: each row keeps its stamp.",
)
@click.option(
    "--setup",
    "setups",
    multiple=True,
    type=FILE,
    metavar="FOLDER|FILE",
    help="Run OpenSim first (extra opensim). Give the folder with the set-up files, or each file. They are copied and "
    "not changed.",
)
@click.option(
    "--steps",
    metavar="LIST",
    default="",
    help="Steps for --setup, from scale,ik,rra,cmc,static. Results of steps that you leave out must be in the folder. "
    "static is quicker than cmc, and uses its set-up file if it has none. [default: all that have a file]",
)
@click.option(
    "--work", type=Output(folder=True), metavar="DIR", help="New folder in which --setup keeps logs and all results."
)
@click.option(
    "--side",
    type=click.Choice(["right", "left", "both"]),
    required=True,
    help="Side of the knee. both: one bag for each.",
)
@click.option(
    "--output",
    type=Output(),
    required=True,
    metavar="BAG",
    help="rosbag2 folder to write. With --side both: BAG_right and BAG_left.",
)
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
@click.option(
    "--anyway", is_flag=True, help="Write the bag although a value is probably a mistake. You get a warning instead."
)
def import_opensim(side: str, output: Path, overwrite: bool, **options: Any) -> None:
    """Make a gait bag from results of OpenSim, or run OpenSim first.

    The command finds columns by their names, and units and signs from the header and the values. If something is not
    clear, it says which option decides. The reaction must act on the tibia and be expressed in its frame. A left knee
    is mirrored to a right one.
    """
    from knee_contact_ros.lab.opensim.command import import_opensim as import_all

    import_all(side, output, overwrite, **options)


@click.command("import-csv")
@click.argument("files", type=FILE, metavar="FILE...", nargs=-1, required=True)
@sensor_map_option
@click.option("--output", type=Output(), required=True, metavar="BAG", help="rosbag2 folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
@click.option(
    "--anyway", is_flag=True, help="Write the bag although a value is probably a mistake. You get a warning instead."
)
def import_csv(files: tuple[Path, ...], maps: tuple[Path, ...], output: Path, overwrite: bool, anyway: bool) -> None:
    """Make a gait bag from the files of a laboratory.

    FILE is a text table (CSV) or an OpenSim file (.sto, .mot). If there are several, each channel is read from the file
    that has its columns. MAP.yaml says which column is what, and its unit. Values that no knee can have are refused in
    one line.
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
    help="Longest lag that is tried in both directions [s]. Use less than half a stride.",
)
def align(files: tuple[Path, ...], maps: tuple[Path, ...], output: Path, overwrite: bool, longest_lag: float) -> None:
    """Find the offset and the lag of an angle sensor.

    It compares the angle of the map with its reference, in the files that import-csv reads. It writes
    knee.flexion_offset and pairing.angle_delay for --params, and warns of a wrong gain.
    """
    from knee_contact_ros.lab.align import align as align_files

    align_files(files, maps, output, longest_lag, overwrite=overwrite)
