"""Commands that make what the others take: import-opensim, import-csv, align, fit-profile, fit-share, calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.cli.calibrate_options import calibrate_options, calibrate_parameter_files
from knee_contact_ros.cli.options import (
    found,
    found_file,
    names_in_bag_options,
    opensim_results_options,
    opensim_run_options,
    parameter_values,
    sensor_map_option,
)
from knee_contact_ros.cli.output_option import Output
from knee_contact_ros.cli.profile_options import fit_profile_options
from knee_contact_ros.cli.share_options import fit_share_options


@click.command("import-opensim")
@opensim_results_options
@opensim_run_options
@click.option("--side", type=click.Choice(["right", "left", "both"]), required=True, help="both: a bag for each.")
@click.option(
    "--output",
    type=Output(),
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
    from knee_contact_ros.tools.opensim.run import import_opensim as import_all

    import_all(side, options, output, overwrite)


@click.command("import-csv")
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE...", nargs=-1, required=True)
@sensor_map_option
@click.option("--output", type=Output(), required=True, metavar="BAG", help="rosbag2 folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace a bag of that name.")
@click.option("--anyway", is_flag=True, help="Write it although something is likely a mistake; that is then a warning.")
def import_csv(files: tuple[Path, ...], map_file: Path, output: Path, overwrite: bool, anyway: bool) -> None:
    """Make a gait bag of a laboratory's own files.

    FILE is a text table (CSV) or an OpenSim file (.sto, .mot); of several, each channel is taken from the one that has
    its columns. MAP.yaml says which columns are what, in which units. What cannot be a knee's is refused in one line.
    """
    from knee_contact_ros.tools.sensors.imported import import_csv as import_files

    import_files(files, map_file, output, overwrite=overwrite, anyway=anyway)


@click.command()
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE...", nargs=-1, required=True)
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
def align(files: tuple[Path, ...], map_file: Path, output: Path, overwrite: bool, longest_lag: float) -> None:
    """Find out what an angle sensor is off by.

    Offset and lag of the map's angle against its reference, from the files that import-csv takes, as
    knee.flexion_offset and pairing.angle_delay for --params. A gain that is wrong is told.
    """
    from knee_contact_ros.tools.sensors.aligned import align as align_files

    align_files(files, map_file, output, longest_lag, overwrite=overwrite)


@click.command("fit-profile")
@click.argument("mesh", type=click.Path(path_type=Path), metavar="MESH")
@fit_profile_options
def fit_profile(mesh: Path, side: str, compartment: str, tolerance: float, slab: float, **others: Any) -> None:
    """From a mesh of cartilage to a profile.

    Cuts MESH (STL, PLY, OBJ, VTP; points as text; a NIfTI label map), smooths the articular side of the slice, and
    writes it as femur.profile and tibia.profile take it, with a picture and a parameter file beside it. Needs
    the extra mesh.
    """
    from knee_contact_ros.system.terminal import say
    from knee_contact_ros.tools.profiles.run import LABEL, FitOptions, run_fit_profile

    asked = FitOptions(
        mesh,
        femur=side == "femur",
        medial=compartment == "medial",
        tolerance=1e-3 * tolerance,
        slab=1e-3 * slab,
        **others,
    )
    for line in run_fit_profile(asked):
        say(line, hang=LABEL)


@click.command("fit-share")
@fit_share_options
def fit_share(
    trials: tuple[str, ...], time: str, axial: str, medial: str, flexion: str, angle_unit: str, **rest: Any
) -> None:
    """From what an instrumented knee measured to the medial share.

    Fits the medial share of the axial load over flexion and load to trials of walking, prints its RMS errors in
    every trial when fitted to all, and when fitted to the others, and writes it as load.share_file takes it.
    """
    from knee_contact_ros.cli.share_table import show_errors
    from knee_contact_ros.tools.shares.run import FitOptions, run_fit_share
    from knee_contact_ros.tools.shares.trials import Wanted

    wanted = Wanted(time, axial, medial, flexion, degrees=angle_unit == "deg")
    files = [[Path(name.strip()) for name in trial.split(",")] for trial in trials]
    show_errors(run_fit_share(FitOptions(files, wanted, **rest)), rest["output"])


@click.command()
@click.argument("data", type=click.Path(path_type=Path), metavar="TABLE.csv|BAG")
@calibrate_parameter_files
@parameter_values
@calibrate_options
@names_in_bag_options
def calibrate(
    data: Path, parameter_files: tuple[Path, ...], parameter_values: tuple[str, ...], without: bool, **rest: Any
) -> None:
    """Fit parameters to what was measured.

    TABLE.csv has the columns time [s], flexion_angle [rad], load [N] (or axial_load, of which load.share is borne; with
    drive displacement femoral_height [m]) and one or more measured ones: penetration_depth [m], contact_force [N],
    gap [m]. Fitted are parameters of the contact.

    BAG has what sensors of a leg tell, as for estimate-load, and beside it the measured /joint_reaction_force. Fitted
    are the person's constants of the load node: person.moment_arm_scale, person.co_contraction, person.tone.

    Prints each value with its interval by profile likelihood, says where parameters trade off, and writes them as a
    parameter file for --params, to be given after the others.
    """
    from knee_contact_ros.cli.calibration_table import show_calibration
    from knee_contact_ros.system.ros_arguments import parameters_of
    from knee_contact_ros.tools.calibration.in_memory import is_bag
    from knee_contact_ros.tools.calibration.run import CalibrateOptions, run_calibrate

    files = [found_file(name) for name in parameter_files] if is_bag(data) else found(parameter_files)
    asked = CalibrateOptions(data, files, parameters_of(parameter_values), with_intervals=not without, **rest)
    show_calibration(run_calibrate(asked), rest["output"])
