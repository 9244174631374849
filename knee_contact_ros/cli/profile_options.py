"""The options of `knee-contact fit-profile`."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.cli.options import together
from knee_contact_ros.cli.output_option import Output

fit_profile_options = together(
    click.option(
        "--slice",
        required=True,
        metavar="MM|auto",
        help="Place of the slice along z, the medio-lateral axis [mm]; "
        "auto: through the contact centre of the compartment.",
    ),
    click.option(
        "--output",
        type=Output(".csv"),
        required=True,
        metavar="OUT.csv",
        help="Profile to write; OUT.png and OUT.yaml come beside it.",
    ),
    click.option(
        "--bone",
        type=click.Path(path_type=Path),
        metavar="MESH",
        help="The bone under the cartilage: tells its thickness.",
    ),
    click.option(
        "--side", type=click.Choice(["femur", "tibia"]), default="femur", show_default=True, help="Which bone."
    ),
    click.option(
        "--compartment",
        type=click.Choice(["medial", "lateral"]),
        default="medial",
        show_default=True,
        help="For --slice auto: medial is z < 0, lateral z > 0.",
    ),
    click.option("--unit", type=click.Choice(["m", "mm"]), help="Of the files. [default: m; label maps: mm]"),
    click.option(
        "--axes",
        metavar="X,Y,Z",
        help="The file's axes that point anterior, superior and lateral, as "
        "--axes=-y,z,x. [default: x,y,z; label maps: y,z,x, a right knee in the scanner's axes]",
    ),
    click.option(
        "--origin",
        metavar="X,Y",
        help="Of the profile [mm of the mesh, after --axes]; mesh: the mesh's own; "
        "surface: on the tibia at x = 0. [default: mesh; tibia: surface]",
    ),
    click.option(
        "--tolerance",
        type=click.FloatRange(0.001, 2.0),
        default=0.05,
        show_default=True,
        help="RMS [mm] by which smoothing may take the profile off the slice, beyond the mesh's roughness.",
    ),
    click.option(
        "--slab",
        type=click.FloatRange(0.0, 10.0),
        default=2.0,
        show_default=True,
        help="How far [mm] on either side of the slice the mesh is looked at, against its noise.",
    ),
    click.option("--label", type=int, metavar="N", help="Of a label map: which is the cartilage."),
    click.option("--bone-label", type=int, metavar="N", help="Of a label map given as --bone: which is the bone."),
    click.option("--overwrite", is_flag=True, help="Replace OUT.csv, OUT.png and OUT.yaml if they exist."),
)
