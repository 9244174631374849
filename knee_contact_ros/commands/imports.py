"""Commands that make bags and sensor parameters of other programs' files: import-opensim, import-csv, align."""

from __future__ import annotations

from typing import Any

import click

from knee_contact_ros.commands.options import (
    FILE,
    Output,
    choice_option,
    number_option,
    output_option,
    path_option,
)

anyway_option = click.option(
    "--anyway", is_flag=True, help="Write the bag although a value is probably a mistake. You get a warning instead."
)
files_argument = click.argument("files", type=FILE, metavar="FILE...", nargs=-1, required=True)
sensor_map_option = path_option(
    "--map",
    "MAP.yaml",
    "Says which column is what, and its unit and sign. Can be given several times; later names win. The package "
    "has locohub.",
    "maps",
    required=True,
    multiple=True,
)


@click.command("import-opensim")
@path_option("--kinematics", "Q.sto", "Angles from IK, RRA or CMC, or a file of states.")
@path_option("--reactions", "JR.sto", "Reactions of a JointReaction analysis.")
@path_option("--speeds", "U.sto", "Rates of the angles. [default: derived from the angles]")
@path_option(
    "--model", "M.osim", "Model, for the body weight, and for the sign of flexion if the angles do not show it."
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
@choice_option(
    "--angle-unit", ["auto", "deg", "rad"], "Unit of the angle. auto: from the header and the values.", "auto"
)
@choice_option("--angle-sign", ["auto", "1", "-1"], "Sign of the angle. -1: flexion is negative in the file.", "auto")
@click.option("--start", type=float, metavar="S", help="Leave out earlier samples [s].")
@click.option("--end", type=float, metavar="S", help="Leave out later samples [s].")
@number_option(
    "--rate", 0.0, 10_000.0, 200.0, "Interpolate angles and reactions to this rate. 0: each row keeps its stamp.", "HZ"
)
@path_option(
    "--setup",
    "FOLDER|FILE",
    "Run OpenSim first (extra opensim). Give the folder with the set-up files, or each file. They are copied and "
    "not changed.",
    multiple=True,
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
@choice_option("--side", ["right", "left", "both"], "Side of the knee. both: one bag for each.", None)
@output_option(
    "BAG", "rosbag2 folder to write. With --side both: BAG_right and BAG_left.", replace="Replace a bag of that name."
)
@anyway_option
def import_opensim(**options: Any) -> None:
    """Make a gait bag from results of OpenSim, or run OpenSim first.

    The command finds columns by their names, and units and signs from the header and the values. If something is not
    clear, it says which option decides. The reaction must act on the tibia and be expressed in its frame. A left knee
    is mirrored to a right one.
    """
    from knee_contact_ros.lab.opensim.command import import_opensim as import_all

    import_all(**options)


@click.command("import-csv")
@files_argument
@sensor_map_option
@output_option("BAG", "rosbag2 folder to write.", replace="Replace a bag of that name.")
@anyway_option
def import_csv(**options: Any) -> None:
    """Make a gait bag from the files of a laboratory.

    FILE is a text table (CSV) or an OpenSim file (.sto, .mot). If there are several, each channel is read from the file
    that has its columns. MAP.yaml says which column is what, and its unit. Values that no knee can have are refused in
    one line.
    """
    from knee_contact_ros.lab.sensors import import_csv as import_files

    import_files(**options)


@click.command()
@files_argument
@sensor_map_option
@output_option("OUT.yaml", "Parameter file to write.", ".yaml", replace="Replace OUT.yaml if it exists.")
@number_option(
    "--longest-lag",
    0.01,
    1.0,
    0.25,
    "Longest lag that is tried in both directions [s]. Use less than half a stride.",
    "S",
)
def align(**options: Any) -> None:
    """Find the offset and the lag of an angle sensor.

    It compares the angle of the map with its reference, in the files that import-csv reads. It writes
    knee.flexion_offset and pairing.angle_delay for --params, and warns of a wrong gain.
    """
    from knee_contact_ros.lab.align import align as align_files

    align_files(**options)
