"""Commands of the laboratory: import-*, align, fit-profile, calibrate; sweep, sensitivity, trade; report."""

from pathlib import Path
from typing import Any

import click

from ..system.errors import IncompleteError, UsageError
from ..system.files import DEFAULT_PARAMETERS, require
from ..system.output_files import check_not_input, check_writable
from ..system.progress import progress
from ..system.terminal import say, warn
from .options import (
    FILE,
    BagNames,
    FiniteRange,
    Output,
    ParameterOptions,
    choice_option,
    combine_options,
    folder_option,
    json_option,
    names_in_bag_options,
    number_option,
    output_option,
    overwrite_option,
    parameter_options,
    parameter_values_option,
    path_option,
    to_metres,
)

anyway_option = click.option(
    "--anyway",
    is_flag=True,
    help="Write the bag although a value is probably a mistake. You get a warning instead.",
)
events_option = click.option(
    "--events",
    default="",
    metavar="FILE|TIMES",
    help="Gait events of the leg: a table with time [s], event and side, a C3D file, or times as 0.12,0.78,1.24 of "
    "heel strike, toe-off, heel strike. [default: those of a C3D FILE, or found from angle and load]",
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
    "--model",
    "M.osim",
    "Model, for the body weight, and for the sign of flexion if the angles do not show it.",
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
    "--net",
    is_flag=True,
    help="The reactions are those of inverse dynamics, without muscle forces. The bag gets net_load for "
    "estimate-load --params load/net_load.",
)
@click.option(
    "--joint",
    metavar="NAME",
    help="Joint of the reactions. [default: the one with knee and side in its name]",
)
@click.option(
    "--coordinate",
    metavar="NAME",
    help="Column or coordinate of the angle. [default: the one with knee and side in its name]",
)
@number_option(
    "--body-weight",
    0.0,
    1e5,
    None,
    "Body weight [N]. [default: that of the model]",
    "N",
    min_open=True,
)
@choice_option(
    "--angle-unit",
    ["auto", "deg", "rad"],
    "Unit of the angle. auto: from the header and the values.",
    "auto",
)
@choice_option(
    "--angle-sign",
    ["auto", "1", "-1"],
    "Sign of the angle. -1: flexion is negative in the file.",
    "auto",
)
@click.option("--start", type=FiniteRange(), metavar="S", help="Leave out earlier samples [s].")
@click.option("--end", type=FiniteRange(), metavar="S", help="Leave out later samples [s].")
@number_option(
    "--rate",
    0.0,
    10_000.0,
    200.0,
    "Interpolate angles and reactions to this rate. 0: each row keeps its stamp.",
    "HZ",
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
    "--work",
    type=Output(folder=True),
    metavar="DIR",
    help="New folder in which --setup keeps logs and all results.",
)
@choice_option(
    "--side", ["right", "left", "both"], "Side of the knee. both: one bag for each.", None
)
@output_option(
    "BAG",
    "rosbag2 folder to write. With --side both: BAG_right and BAG_left.",
    replace="Replace a bag of that name.",
)
@events_option
@anyway_option
def import_opensim(**options: Any) -> None:
    """Make a gait bag from OpenSim's results, or run it first.

    The command finds columns by their names, and units and signs from the header and the values. If something is not
    clear, it says which option decides. The reaction must act on the tibia and be expressed in its frame. A left knee
    is mirrored to a right one.
    """
    from ..lab.opensim import run_import_opensim

    run_import_opensim(**options)


@click.command("import-csv")
@files_argument
@sensor_map_option
@events_option
@output_option("BAG", "rosbag2 folder to write.", replace="Replace a bag of that name.")
@anyway_option
def import_csv(**options: Any) -> None:
    """Make a gait bag from the files of a laboratory.

    FILE is a text table (CSV) or an OpenSim file (.sto, .mot). If there are several, each channel is read from the file
    that has its columns. MAP.yaml says which column is what, and its unit. Values that no knee can have are refused in
    one line.
    """
    from ..lab.sensors import run_import_csv

    run_import_csv(**options)


@click.command()
@files_argument
@sensor_map_option
@output_option(
    "OUT.yaml", "Parameter file to write.", ".yaml", replace="Replace OUT.yaml if it exists."
)
@number_option(
    "--longest-lag",
    0.01,
    1.0,
    0.25,
    "Longest lag that is tried in both directions [s]. Use less than half a stride.",
    "S",
)
@json_option
def align(**options: Any) -> None:
    """Find the offset and the lag of an angle sensor.

    It compares the angle of the map with its reference, in the files that import-csv reads. It writes
    knee.flexion_offset and pairing.angle_delay for --params, and warns of a wrong gain.
    """
    from ..lab.align import align as align_files

    align_files(**options)


@click.command("fit-profile")
@click.argument("mesh", type=FILE, metavar="MESH")
@click.option(
    "--slice",
    required=True,
    metavar="MM|auto",
    help="Position of the slice along z, the medio-lateral axis [mm]. auto: through the contact centre of the "
    "compartment.",
)
@output_option(
    "OUT.csv",
    "Profile to write. A picture OUT.png and a parameter file OUT.yaml are written too.",
    ".csv",
)
@path_option("--bone", "MESH", "Mesh of the bone, to measure the thickness of the cartilage.")
@choice_option("--side", ["femur", "tibia"], "Bone that the cartilage covers.", "femur")
@choice_option(
    "--compartment",
    ["medial", "lateral"],
    "For --slice auto: medial is z < 0, lateral z > 0; of a surface with both, beside the middle between the condyles.",
    "medial",
)
@choice_option(
    "--leg",
    ["right", "left"],
    "Leg of the knee. A left one is mirrored to a right one, unless --axes are given.",
    "right",
)
@choice_option(
    "--unit",
    ["m", "mm", "cm"],
    "Unit of the meshes. [default: m; label maps and 3D Slicer: mm]",
    "",
)
@click.option(
    "--axes",
    metavar="X,Y,Z",
    help="Axes of the file that point anterior, superior and lateral, for example --axes=-y,z,x. [default: those of "
    "the leg if the file states its space (label maps, SPACE=RAS); otherwise x,y,z]",
)
@click.option(
    "--origin",
    metavar="X,Y",
    help="Origin of the profile [mm in the mesh, after --axes]. mesh: that of the mesh; surface: on the tibia at x = "
    "0. [default: mesh; tibia: surface]",
)
@number_option(
    "--tolerance",
    0.001,
    2.0,
    0.05,
    "Largest RMS distance [mm] that smoothing may add to the roughness of the mesh.",
    callback=to_metres,
)
@number_option(
    "--slab",
    0.0,
    10.0,
    2.0,
    "Half width [mm] of the slab around the slice whose points are used, to average noise.",
    callback=to_metres,
)
@click.option("--label", type=int, metavar="N", help="Label of the cartilage in a label map.")
@click.option(
    "--bone-label", type=int, metavar="N", help="Label of the bone in a label map given as --bone."
)
@overwrite_option("Replace OUT.csv, OUT.png and OUT.yaml if they exist.")
def fit_profile(mesh: Path, side: str, compartment: str, leg: str, **others: Any) -> None:
    """Make a profile from a mesh of cartilage.

    It cuts MESH, smooths the articular side of the slice, and writes the profile for femur.profile or tibia.profile, a
    picture and a parameter file. MESH is an STL, PLY, OBJ, VTP or VTK file, points as text, or a label map (NIfTI,
    NRRD, MHA). It needs the extra mesh.
    """
    from ..lab.profiles import LABEL_WIDTH, ProfileOptions, run_fit_profile

    others |= {"femur": side == "femur", "medial": compartment == "medial", "left": leg == "left"}
    options = ProfileOptions(mesh, **others)
    for line in run_fit_profile(options):
        say(line, hang=LABEL_WIDTH)


@click.command()
@click.argument("data", type=FILE, nargs=-1, required=True, metavar="TABLE.csv|BAG...")
@parameter_options("", f"{DEFAULT_PARAMETERS}; for a BAG the defaults of the load node")
@click.option(
    "--free",
    multiple=True,
    required=True,
    metavar="NAME[=LOW:HIGH]",
    help="Parameter to fit, for example contact.stiffness or person.tone, within its range or a narrower one. Once "
    "for each.",
)
@click.option(
    "--sigma",
    multiple=True,
    metavar="COLUMN=SD",
    help="Standard deviation of the noise of a column, in its unit. [default: that of the residuals] Once per column.",
)
@choice_option(
    "--loss",
    ["linear", "soft_l1", "huber"],
    "linear: least squares; with the others outliers count less.",
    "linear",
)
@number_option(
    "--level", 0.0, 1.0, 0.95, "Probability of the intervals.", min_open=True, max_open=True
)
@click.option(
    "--no-intervals",
    "without",
    is_flag=True,
    help="Skip the intervals, which take nine tenths of the time.",
)
@number_option(
    "--starts", 1, 1000, 4, "Number of starting points of the search, to find other minima."
)
@output_option(
    "OUT.yaml", "Parameter file to write.", ".yaml", replace="Replace OUT.yaml if it exists."
)
@names_in_bag_options()
@json_option
def calibrate(
    data: tuple[Path, ...], given: ParameterOptions, without: bool, in_bag: BagNames, **rest: Any
) -> None:
    """Fit parameters to measurements.

    Give TABLE.csv to fit parameters of the contact. It has the columns time [s], flexion_angle [rad], load [N], and one
    or more measured columns: penetration_depth [m], contact_force [N], gap [m]. Instead of load it may have axial_load,
    which is multiplied by load.share, or femoral_height [m] with drive displacement.

    Give a BAG to fit a person's constants of the load node: person.moment_arm_scale, person.co_contraction,
    person.tone. It has the sensors that estimate-load reads, and the measured /joint_reaction_force. With several bags
    of a person, each one is also left out in turn, to show how much the fit helps.

    A BAG of a walk (better five strides), with or without a stand, needs no /joint_reaction_force for knee.offset and
    pairing.angle_delay, and with them person.mass: they are found by how other people walk. What is within what people
    differ by is kept as given.

    It prints each value with its profile-likelihood interval and says which parameters trade off. It writes a parameter
    file; give it to --params after the other files. Intervals need the extra calibrate.
    """
    from ..lab.calibrate import bags_in, run_calibrate

    files = given.files(None if bags_in(list(data)) else DEFAULT_PARAMETERS)
    run_calibrate(
        data, files, given.values(), with_intervals=not without, **in_bag._asdict(), **rest
    )


figures_option = choice_option(
    "--figures",
    ["png", "svg", "pdf"],
    "Format of the files of the figures.",
    "png",
)
study_options = combine_options(
    click.argument("study", type=FILE, metavar="STUDY.yaml"),
    click.option(
        "--output",
        required=True,
        metavar="DIR",
        help="Folder of the results, a path or an fsspec address. Cases that it holds are not computed again.",
    ),
    number_option(
        "--workers", 1, 1024, None, "Number of processes. [default: one for each processor]"
    ),
    click.option(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="Use this Dask scheduler instead, for example tcp://host:8786.",
    ),
)


@click.command()
@study_options
def sweep(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Compute many knees.

    It combines all bags, parameter files and values of a study, and writes a row of outcomes for each case, as a
    Parquet dataset. Run it again to continue a study that was stopped, or that has grown.
    """
    require("sweep", "pyarrow", "distributed", "fsspec")
    from ..lab.study import run_study
    from ..lab.study_file import Study, read_study

    run = run_study(read_study(study, Study), output, workers or 0, scheduler)
    say(f"table: {output} (pandas.read_parquet)")
    if run.missing:
        raise IncompleteError(run.missing)


@click.command()
@study_options
@figures_option
def sensitivity(
    study: Path, output: str, workers: int | None, scheduler: str, figures: str
) -> None:
    """Find out which parameters matter.

    It writes the indices of Sobol or Morris, with intervals, for depth, pressure, bone contact and force, as a table
    (indices.csv) and pictures. A study is written as for sweep, with `sensitivity` (method, n, ranges) instead of
    `sample`.
    """
    require("sweep", "pyarrow", "distributed", "fsspec", "SALib", "matplotlib")
    from ..lab.sensitivity_study import run_sensitivity

    run_sensitivity(study, output, workers or 0, scheduler, figures)


@click.command()
@click.argument("bag", type=FILE)
@parameter_options()
@names_in_bag_options()
@number_option(
    "--worth",
    0.0,
    None,
    None,
    "Error of the depth that your measured data cause anyway. [default: that of a 1 % change of the load]",
    "METRES",
    min_open=True,
)
@click.option(
    "--picture",
    type=Output(".png"),
    default="knee_contact_trade.png",
    show_default=True,
    metavar="FILE.png",
    help="Picture to write. An earlier one is replaced.",
)
@json_option
def trade(
    bag: Path, given: ParameterOptions, in_bag: BagNames, worth: float | None, picture: Path
) -> None:
    """Show what accuracy costs on your own bag and knee.

    It computes BAG at every fidelity.level, with tolerances from 1e-3 to 1e-9 m. It prints and draws the largest errors
    compared with the tightest tolerance, the cost of a tick and the share of flagged ticks, and recommends a setting.
    If BAG is a recording of this package, its own parameters are used unless you give --params.
    """
    from ..bags.bag import Bag
    from ..bags.folder import files_of, others_beside
    from ..lab.trade import draw_trade, measure, show_trade
    from ..offline.bag_parameters import basis_of, resolved_parameters, weight_doubt
    from ..offline.notebooks import answers_of

    require("trade", "matplotlib")
    check_writable(picture)
    check_not_input(picture, files_of(bag))
    with Bag(bag) as opened:
        in_bag = in_bag.found_in(opened)
        files = given.parameter_files or None
        basis = basis_of(opened, files, given.values(), None, in_bag.namespace)
        results, summary = answers_of(opened, basis, in_bag.names())
        if summary.ticks < 2:
            raise UsageError(
                f"bag {bag}: only one tick could be computed, but errors need at least two"
            )
        doubts = weight_doubt(opened, resolved_parameters(basis))
    warn([*others_beside(bag), *doubts, *summary.warnings])
    with progress("Measuring") as advance:
        found = measure(results, worth, advance)
    draw_trade(found, picture)
    show_trade(found, picture)
    if missing := summary.missing_parts(bag):
        raise IncompleteError(missing)


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILE, metavar="FILE...")
@folder_option(
    "knee_contact_report",
    "Folder for the page, its figures and data. Those of an earlier report are replaced.",
)
@parameter_options()
@click.option(
    "--compare",
    "compare",
    multiple=True,
    type=FILE,
    metavar="FILE",
    help="Compute each FILE again with this parameter file on top of its own parameters, and show both side by side, "
    "for example --compare osteoarthritis.yaml. Can be given several times; later files win.",
)
@click.option(
    "--uncertainty",
    type=FILE,
    metavar="FILE",
    help="YAML file with standard deviations, for example 'contact.stiffness: 20 %'. The report shows their effect on "
    "depth and force.",
)
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="TEXT",
    help="Name of a FILE. Once for each, in their order.",
)
@figures_option
@names_in_bag_options()
def report(
    files: tuple[Path, ...],
    output: Path,
    given: ParameterOptions,
    in_bag: BagNames,
    figures: str,
    **options: Any,
) -> None:
    """Write a report: figures and tables that need no viewer.

    It writes one page (report.html, which needs no other file), figures and data (CSV). A FILE is a recording of
    this package, a bag with the inputs, which is computed with --params, or a subject file that names its bag. Several
    files stand side by side. It needs the extra report.
    """
    require("report", "matplotlib", "jinja2", "pandas")
    from ..bags.folder import others_beside
    from ..lab.report import run_report
    from ..lab.report.runs import ReportOptions
    from ..parameters.files import values_set_in

    values = given.values()
    sources: list[Path | dict[str, Any]] = [*given.files(), *([values] if values else [])]
    if in_bag.namespace:
        sets = [values_set_in(path, namespace=in_bag.namespace) for path in given.files()]
        sources = [{name: value for each in [*sets, values] for name, value in each.items()}]
    compare = ParameterOptions(options.pop("compare")).files(None)
    for path in run_report(
        ReportOptions(
            files,
            parameters=sources,
            parameters_given=any(given),
            compare=compare,
            names=in_bag.names(),
            kind=figures,
            **options,
        ),
        output,
    ):
        say(str(path))
    warn(
        sentence
        for path in files
        if path.suffix not in (".yaml", ".yml")
        for sentence in others_beside(path)
    )


@click.command()
@click.argument("files", type=FILE, nargs=-1, required=True, metavar="KNEE.yaml [...]")
@parameter_values_option
@click.option(
    "--output", type=Output(folder=True), required=True, metavar="DIR", help="Folder to write."
)
@click.option(
    "--target",
    type=click.Choice(["x86-64", "aarch64", "cortex-m7"]),
    default="x86-64",
    show_default=True,
    help="Processor to export for.",
)
@click.option("--name", default="", help="Name of the knee in C. [default: that of the last file]")
def export(
    files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    output: Path,
    target: str,
    name: str,
) -> None:
    """Write a knee as C, for a controller or a microcontroller.

    KNEE.yaml is a parameter file of yours or of the package, for example healthy; later ones win. DIR gets a header, an
    object with the model, the knee's constants, a test that your processor computes it rightly, and a README with the
    commands. A tick takes some microseconds, allocates nothing, and needs only libm.
    """
    from ..lab.export import export
    from ..parameters.files import load_parameters
    from ..system.terminal import say

    given = ParameterOptions(files, parameter_values)
    parameters = load_parameters([*given.files(), given.values()])
    name = name or files[-1].stem.replace("-", "_")
    for file in export(parameters, name, output, target):
        say(str(file))
