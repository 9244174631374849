"""Options of the command line that several commands have, or that come in numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from knee_contact_ros.cli.output_option import Output
from knee_contact_ros.system import resources

DEFAULT_PARAMETERS = resources.DEFAULT_PARAMETERS
CLOCK = "--clock"
WITH_EVERY_MESSAGE = "0"
Function = TypeVar("Function", bound=Callable[..., Any])


def parameter_files_option(own: str, default: str) -> Callable[[Function], Function]:
    """The option `--params`; `own` says which files of the package there are."""
    return click.option(
        "--params",
        "parameter_files",
        multiple=True,
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Parameter file; can be given several times, the later one wins. A name that is not found here "
        f"is looked up among the package's own{own}. [default: {default}]",
    )


parameter_files = parameter_files_option(", as osteoarthritis", DEFAULT_PARAMETERS)
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

opensim_results_options = together(
    click.option("--kinematics", type=click.Path(path_type=Path), metavar="Q.sto", help="Of IK, RRA, CMC, or states."),
    click.option("--reactions", type=click.Path(path_type=Path), metavar="JR.sto", help="Of a JointReaction analysis."),
    click.option(
        "--speeds", type=click.Path(path_type=Path), metavar="U.sto", help="Rates of the angles; else they are derived."
    ),
    click.option(
        "--model",
        type=click.Path(path_type=Path),
        metavar="M.osim",
        help="Tells the sign of flexion where the angles do not, and the body weight.",
    ),
    click.option(
        "--ground",
        is_flag=False,
        flag_value="",
        metavar="[GRF.xml|GRF.mot]",
        help="External loads or ground reactions: also what the leg's sensors would have told, for estimate-load (hip, "
        "ankle, ground_reaction_force). Needs --model and the extra opensim; with --setup the file may be left out.",
    ),
    click.option(
        "--joint", metavar="NAME", help="Joint of the reactions. [default: the one with knee and side in its name]"
    ),
    click.option("--coordinate", metavar="NAME", help="Column or coordinate of the angle. [default: likewise]"),
    click.option(
        "--angle-unit",
        type=click.Choice(["auto", "deg", "rad"]),
        default="auto",
        show_default=True,
        help="auto: as header and values say.",
    ),
    click.option(
        "--angle-sign",
        type=click.Choice(["auto", "1", "-1"]),
        default="auto",
        show_default=True,
        help="-1: flexion is negative in the file.",
    ),
    click.option("--start", type=float, metavar="S", help="Leave out what is earlier [s]."),
    click.option("--end", type=float, metavar="S", help="Leave out what is later [s]."),
    click.option(
        "--rate",
        type=click.FloatRange(0.0, 10_000.0),
        default=200.0,
        show_default=True,
        metavar="HZ",
        help="Interpolate both; 0: every row keeps its stamp.",
    ),
)

sensor_map_option = click.option(
    "--map",
    "map_file",
    type=click.Path(path_type=Path),
    required=True,
    metavar="MAP.yaml",
    help="Which columns are what, in which units and signs.",
)

opensim_run_options = together(
    click.option(
        "--setup",
        "setups",
        multiple=True,
        type=click.Path(path_type=Path),
        metavar="FOLDER|FILE",
        help="Run OpenSim instead (extra opensim): the folder with the set-up files, or each "
        "of them. It is copied, and stays as it is.",
    ),
    click.option(
        "--steps",
        metavar="LIST",
        default="",
        help="For --setup: of scale,ik,rra,cmc,static; what is left out must be in the folder. static is quicker than "
        "cmc, and is set up from cmc's file if it has none. [default: all there are]",
    ),
    click.option(
        "--work",
        type=Output(folder=True),
        metavar="DIR",
        help="For --setup: a new folder that keeps logs and all results.",
    ),
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


def found(files: tuple[Path, ...]) -> list[Path]:
    """Parameter files as given, or from the package's config folder."""
    return [found_file(name) for name in files or (Path(DEFAULT_PARAMETERS),)]


def found_file(name: Path) -> Path:
    """A parameter file as given, or from the package's config folder."""
    return resources.parameter_file(str(name))
