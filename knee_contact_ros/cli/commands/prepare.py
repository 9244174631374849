"""Commands that make what the others take: import-opensim, fit-profile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.cli.options import (
    opensim_results_options,
    opensim_run_options,
)
from knee_contact_ros.cli.output_option import Output
from knee_contact_ros.cli.profile_options import fit_profile_options


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
