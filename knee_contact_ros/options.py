"""Options of the command line that several commands have, or that come in numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

DEFAULT_PARAMETERS = "healthy.yaml"
CLOCK = "--clock"
WITH_EVERY_MESSAGE = "0"
Function = TypeVar("Function", bound=Callable[..., Any])

parameter_files = click.option(
    "--params",
    "parameter_files",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Parameter file; can be given several times, the later one wins. A name that is not found here "
    f"is looked up among the package's own. [default: {DEFAULT_PARAMETERS}]",
)
parameter_values = click.option(
    "-p",
    "parameter_values",
    multiple=True,
    metavar="NAME:=VALUE",
    help="A parameter, as -p knee.joint_name:=knee_r; wins over the files. Can be given several times.",
)


def together(*options: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Several options as one decorator, in the order of the help text."""

    def decorate(function: Function) -> Function:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


names_in_bag_options = together(
    click.option(
        "--remap",
        "remaps",
        multiple=True,
        metavar="FROM:=TO",
        help="Take an input from another topic of the bag, as --remap joint_states:=/exo/joint_states. Can be given "
        "several times.",
    ),
    click.option(
        "--namespace",
        default="",
        metavar="NAME",
        help="Take the inputs from /NAME/... of the bag, as --namespace left.",
    ),
)
timing_options = together(
    click.option(
        "--rate",
        type=click.FloatRange(0.01, 100.0),
        default=1.0,
        show_default=True,
        help="Seconds of the bag per second.",
    ),
    click.option("--loop", is_flag=True, help="Start over at the end."),
    click.option(
        CLOCK,
        type=click.FloatRange(0.0, 10_000.0),
        metavar="[HZ]",
        help="Publish /clock, at HZ; without a number, with every message.",
    ),
    click.option(
        "--start-offset",
        type=click.FloatRange(0.0, 1e9),
        default=0.0,
        metavar="SECONDS",
        help="Begin so long after the bag's first message.",
    ),
    click.option(
        "--duration",
        type=click.FloatRange(0.0, 1e9, min_open=True),
        metavar="SECONDS",
        help="Publish only so long a part of the bag.",
    ),
    click.option(
        "--delay",
        type=click.FloatRange(0.0, 1e6),
        default=0.0,
        metavar="SECONDS",
        help="Wait so long before the first message.",
    ),
    click.option("--start-paused", is_flag=True, help="Wait for a key."),
    click.option(
        "--wait",
        type=click.FloatRange(0.0, 3600.0),
        default=10.0,
        show_default=True,
        help="How long to wait for subscribers [s] before publishing all the same.",
    ),
)

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
        type=click.Path(path_type=Path, dir_okay=False),
        required=True,
        metavar="OUT.csv",
        help="Profile to write; OUT.png and OUT.yaml come beside it.",
    ),
    click.option(
        "--bone",
        type=click.Path(path_type=Path),
        metavar="MESH",
        help="The bone under the cartilage: tells its thickness, contact.layer_depth.",
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


class OptionalClockRate(click.Command):
    """A command whose option `--clock` may come without its number, also before the argument BAG."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give a plain `--clock` the number that stands for it."""
        following = [*args, ""][1:]
        filled = [
            f"{CLOCK}={WITH_EVERY_MESSAGE}" if argument == CLOCK and not is_number(after) else argument
            for argument, after in zip(args, following, strict=True)
        ]
        return super().parse_args(ctx, filled)


def is_number(text: str) -> bool:
    """Whether an argument is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
