"""Commands that fit: fit-profile, fit-share, calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.commands.options import (
    DEFAULT_PARAMETERS,
    FILE,
    Output,
    find_parameters,
    names_in_bag_options,
    parameter_files_option,
    parameter_values,
)


@click.command("fit-profile")
@click.argument("mesh", type=FILE, metavar="MESH")
@click.option(
    "--slice",
    required=True,
    metavar="MM|auto",
    help="Place of the slice along z, the medio-lateral axis [mm]; "
    "auto: through the contact centre of the compartment.",
)
@click.option(
    "--output",
    type=Output(".csv"),
    required=True,
    metavar="OUT.csv",
    help="Profile to write; OUT.png and OUT.yaml come beside it.",
)
@click.option("--bone", type=FILE, metavar="MESH", help="The bone under the cartilage: tells its thickness.")
@click.option("--side", type=click.Choice(["femur", "tibia"]), default="femur", show_default=True, help="Which bone.")
@click.option(
    "--compartment",
    type=click.Choice(["medial", "lateral"]),
    default="medial",
    show_default=True,
    help="For --slice auto: medial is z < 0, lateral z > 0.",
)
@click.option(
    "--unit", type=click.Choice(["m", "mm", "cm"]), help="Of the files. [default: m; label maps, 3D Slicer: mm]"
)
@click.option(
    "--axes",
    metavar="X,Y,Z",
    help="The file's axes that point anterior, superior and lateral, as "
    "--axes=-y,z,x. [default: a right knee's where the file says its space (label maps, SPACE=RAS); else x,y,z]",
)
@click.option(
    "--origin",
    metavar="X,Y",
    help="Of the profile [mm of the mesh, after --axes]; mesh: the mesh's own; "
    "surface: on the tibia at x = 0. [default: mesh; tibia: surface]",
)
@click.option(
    "--tolerance",
    type=click.FloatRange(0.001, 2.0),
    default=0.05,
    show_default=True,
    help="RMS [mm] by which smoothing may take the profile off the slice, beyond the mesh's roughness.",
)
@click.option(
    "--slab",
    type=click.FloatRange(0.0, 10.0),
    default=2.0,
    show_default=True,
    help="How far [mm] on either side of the slice the mesh is looked at, against its noise.",
)
@click.option("--label", type=int, metavar="N", help="Of a label map: which is the cartilage.")
@click.option("--bone-label", type=int, metavar="N", help="Of a label map given as --bone: which is the bone.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.csv, OUT.png and OUT.yaml if they exist.")
def fit_profile(mesh: Path, side: str, compartment: str, tolerance: float, slab: float, **others: Any) -> None:
    """From a mesh of cartilage to a profile.

    Cuts MESH (STL, PLY, OBJ, VTP, VTK; points as text; a label map: NIfTI, NRRD, MHA), smooths the articular side of
    the slice, and writes it as femur.profile and tibia.profile take it, with a picture and a parameter file beside it.
    Needs the extra mesh.
    """
    from knee_contact_ros.lab.profiles import LABEL, run_fit_profile
    from knee_contact_ros.system.terminal import say

    femur, medial = side == "femur", compartment == "medial"
    for line in run_fit_profile(
        mesh, femur=femur, medial=medial, tolerance=1e-3 * tolerance, slab=1e-3 * slab, **others
    ):
        say(line, hang=LABEL)


@click.command("fit-share")
@click.option(
    "--trial",
    "trials",
    multiple=True,
    required=True,
    metavar="FILE.csv[,FILE.csv...]",
    help="A trial: a CSV file, or several with one clock, of which the first one says the samples. Once per trial.",
)
@click.option("--time", default="time_s", show_default=True, metavar="COLUMN", help="Time [s], in every file.")
@click.option("--axial", required=True, metavar="SUM", help="Axial compression [N], as 'pm + am + pl + al'.")
@click.option("--medial", required=True, metavar="SUM", help="The medial part of it [N], as '0.98 am + 0.97 pm'.")
@click.option("--flexion", required=True, metavar="SUM", help="Flexion angle, as --flexion=-knee_angle.")
@click.option("--angle-unit", type=click.Choice(["deg", "rad"]), default="rad", show_default=True, help="Of --flexion.")
@click.option(
    "--body-weight",
    type=click.FloatRange(10.0, 5000.0),
    multiple=True,
    required=True,
    metavar="N",
    help="Body weight [N]; once, or once per trial.",
)
@click.option(
    "--moment", default="", metavar="SUM", help="Frontal moment torque.x [N m]: fits the compartments' spacing."
)
@click.option(
    "--form",
    type=click.Choice(["auto", "curve", "table"]),
    default="auto",
    show_default=True,
    help="A curve over the load, a table over flexion and load, or what is better on trials that are left out.",
)
@click.option(
    "--smoothing",
    type=click.FloatRange(1e-8, 1e3),
    metavar="BW^2",
    help="What a step of 1 between neighbours in the table costs, beside the mean square of the error; by default what "
    "is best on trials that are left out.",
)
@click.option("--source", default="", help="Whose data these are: goes into the file.")
@click.option("--output", type=Output(".csv"), required=True, metavar="OUT.csv", help="Table to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.csv if it exists.")
def fit_share(
    trials: tuple[str, ...], time: str, axial: str, medial: str, flexion: str, moment: str, angle_unit: str, **rest: Any
) -> None:
    """From what an instrumented knee measured to the medial share.

    Fits the medial share of the axial load to trials of walking: a curve over the load with two constants, and a table
    over flexion and load. Prints their RMS errors in every trial when fitted to the others, and writes the curve, or
    the table if it is clearly better there, as load.share_file takes it.
    """
    from knee_contact_ros.lab.shares import Wanted, run_fit_share

    wanted = Wanted(time, axial, medial, flexion, degrees=angle_unit == "deg", moment=moment)
    run_fit_share([[Path(name.strip()) for name in trial.split(",")] for trial in trials], wanted, **rest)


@click.command()
@click.argument("data", type=FILE, nargs=-1, required=True, metavar="TABLE.csv|BAG...")
@parameter_files_option("", f"{DEFAULT_PARAMETERS}; with a BAG the load node's defaults")
@parameter_values
@click.option(
    "--free",
    multiple=True,
    required=True,
    metavar="NAME[=LOW:HIGH]",
    help="Parameter to fit, as contact.stiffness or person.tone, in its range or a narrower one; once for each.",
)
@click.option(
    "--sigma",
    multiple=True,
    metavar="COLUMN=SD",
    help="Standard deviation of a column's noise, in its unit; else that of what is left of it. Once per column.",
)
@click.option(
    "--loss",
    type=click.Choice(["linear", "soft_l1", "huber"]),
    default="linear",
    show_default=True,
    help="linear: least squares; by the others, outliers count less.",
)
@click.option(
    "--level",
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Probability of the intervals.",
)
@click.option("--no-intervals", "without", is_flag=True, help="Fit only: a tenth of the time.")
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=4,
    show_default=True,
    help="From how many places to search, so that another minimum is seen.",
)
@click.option("--output", type=Output(".yaml"), required=True, metavar="OUT.yaml", help="Parameter file to write.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.yaml if it exists.")
@names_in_bag_options()
def calibrate(
    data: tuple[Path, ...],
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    without: bool,
    **rest: Any,
) -> None:
    """Fit parameters to what was measured.

    TABLE.csv has the columns time [s], flexion_angle [rad], load [N] (or axial_load, of which load.share is borne; with
    drive displacement femoral_height [m]) and one or more measured ones: penetration_depth [m], contact_force [N],
    gap [m]. Fitted are parameters of the contact.

    BAG has what sensors of a leg tell, as for estimate-load, and beside it the measured /joint_reaction_force. Fitted
    are the person's constants of the load node: person.moment_arm_scale, person.co_contraction, person.tone. Of several
    bags of a person each is also left out in turn, which says what the person gains.

    Prints each value with its interval by profile likelihood, says where parameters trade off, and writes them as a
    parameter file for --params, to be given after the others.
    """
    from knee_contact_ros.lab.calibrate import bags_in, run_calibrate
    from knee_contact_ros.parameters.ros_files import parameters_of

    files = find_parameters(parameter_files, None if bags_in(list(data)) else DEFAULT_PARAMETERS)
    run_calibrate(data, files, parameters_of(parameter_values), with_intervals=not without, **rest)
