"""Types of options, and options that several commands have."""

from __future__ import annotations

import math
import stat
from collections.abc import Callable, Sequence
from functools import reduce, update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click

from ..system import files
from ..system.errors import UsageError
from ..system.files import DEFAULT_PARAMETERS
from ..system.output_files import check_output
from ..system.terminal import JSON, VERBOSE

if TYPE_CHECKING:
    from ..bags.bag import Bag
    from ..bags.names import Names

Function = TypeVar("Function", bound=Callable[..., Any])


def input_path(text: str) -> Path:
    """Return the path of an input file or folder; it need not exist, as the command says what it should be.

    Raises:
        UsageError: it is a pipe or a device, which might never end, or a link to itself.
    """
    path = Path(text)
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return path
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise UsageError(f"{path}: it is not a regular file and not a folder")
    return path


FILE = input_path
"""Type of an option or an argument that names an input file or folder"""


class Output(click.Path):
    """Type of an option or an argument that names an output file or folder.

    It refuses a wrong output before any work. The folder must exist, so that a misspelt one is not made. The suffix
    must be that of the format.
    """

    def __init__(self, *suffixes: str, folder: bool = False) -> None:
        """Allow names that end with one of `suffixes` (any name if there are none); `folder` says that it is one."""
        super().__init__(path_type=Path, file_okay=not folder)
        self._suffixes = suffixes

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Path:
        """Convert the argument to a path.

        Raises:
            UsageError: the output's folder does not exist, or the name has another suffix.
        """
        label = param.opts[0] if isinstance(param, click.Option) else "output"
        return check_output(Path(str(super().convert(value, param, ctx))), label, *self._suffixes)


def path_option(
    name: str, metavar: str, text: str, *own: str, **more: Any
) -> Callable[[Function], Function]:
    """Make an option that names an input file or folder; `text` is its help, `own` and `more` are Click's."""
    return click.option(name, *own, type=FILE, metavar=metavar, help=text, **more)


def output_option(
    metavar: str, text: str, *suffixes: str, replace: str = ""
) -> Callable[[Function], Function]:
    """Make the option `--output`, whose name must end with one of `suffixes`, if there are any.

    With the help text `replace` the option `--overwrite` follows.
    """
    output = click.option(
        "--output", type=Output(*suffixes), required=True, metavar=metavar, help=text
    )
    return combine_options(output, overwrite_option(replace)) if replace else output


def folder_option(default: str, text: str) -> Callable[[Function], Function]:
    """Make the option `--output` for a folder of results."""
    kind = Output(folder=True)
    return click.option(
        "--output", type=kind, default=default, show_default=True, metavar="DIR", help=text
    )


def overwrite_option(text: str) -> Callable[[Function], Function]:
    """Make the option `--overwrite`."""
    return click.option("--overwrite", is_flag=True, help=text)


def choice_option(
    name: str, values: Sequence[str], text: str, default: str | None
) -> Callable[[Function], Function]:
    """Make an option with a choice of values; it must be given if the default is None, and may be left out if empty."""
    own: dict[str, Any] = (
        {"default": default, "show_default": True} if default else {"required": default is None}
    )
    return click.option(name, type=click.Choice(values), help=text, **own)


class FiniteRange(click.FloatRange):
    """Type of an option with a number from a range, without NaN and infinity, which Click's has."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert the argument to a number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


def number_option(
    name: str,
    low: float,
    high: float | None,
    default: float | None,
    text: str,
    metavar: str | None = None,
    *,
    min_open: bool = False,
    max_open: bool = False,
    **more: Any,
) -> Callable[[Function], Function]:
    """Make an option with a number from `low` to `high`, an integer if `low` is; `more` are Click's arguments."""
    kind: Any = click.IntRange if isinstance(low, int) else FiniteRange
    allowed = kind(low, high, min_open=min_open, max_open=max_open)
    return click.option(
        name, type=allowed, default=default, show_default=True, metavar=metavar, help=text, **more
    )


def to_metres(_context: click.Context, _option: click.Parameter, millimetres: float) -> float:
    """Convert the number of an option; it is Click's `callback`."""
    return 1e-3 * millimetres


class ParameterOptions(NamedTuple):
    """Parameters as the options `--params` and `-p` give them."""

    parameter_files: tuple[Path, ...]
    """Names of parameter files"""
    parameter_values: tuple[str, ...] = ()
    """Values as NAME:=VALUE"""

    def files(self, default: str | None = DEFAULT_PARAMETERS) -> list[Path]:
        """Find the parameter files, as given or in the package's config folder; the `default` if there are none."""
        names = self.parameter_files or ([default] if default else [])
        return [files.parameter_file(str(name)) for name in names]

    def values(self) -> dict[str, Any]:
        """Read the values, by the names of the parameters.

        Raises:
            UsageError: one of them is not a value; see `parameters_of`.
        """
        from ..system.ros_files import parameters_of

        return parameters_of(self.parameter_values)


class BagNames(NamedTuple):
    """Names in a bag as the options `--remap` and `--namespace` give them."""

    remaps: tuple[str, ...]
    namespace: str

    def found_in(self, bag: Bag, *inputs: str) -> BagNames:
        """Return these names, with the only namespace of the `inputs` in a bag where no option says anything."""
        from ..bags.names import only_namespace

        if self.remaps or self.namespace:
            return self
        return self._replace(namespace=only_namespace(bag.topics, *([inputs] if inputs else [])))

    def names(self, *inputs: str) -> Names:
        """Return the names of the `inputs` in the bag, by default those of the contact node.

        Raises:
            UsageError: a rule is malformed; see `names_in_bag`.
        """
        from ..bags.names import names_in_bag

        return names_in_bag(*self, *([inputs] if inputs else []))


def combine_options(*options: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Combine several options into one decorator; the help text lists them in this order."""
    return lambda function: reduce(
        lambda decorated, option: option(decorated), reversed(options), function
    )


def group_options(
    name: str, kind: Any, *options: Callable[[Function], Function]
) -> Callable[[Function], Function]:
    """Combine several options into one decorator; the command gets their values as one argument, a tuple of a `kind`.

    The names of the options are those of its fields.
    """
    decorate: Any = combine_options(*options)

    def decorated(function: Function) -> Any:
        def command(**values: Any) -> None:
            one = kind(*(values.pop(field) for field in kind._fields))
            function(**values, **{name: one})

        update_wrapper(command, function)
        return decorate(command)

    return decorated


def parameter_files_option(
    own: str = ", for example osteoarthritis", default: str = DEFAULT_PARAMETERS
) -> Callable[[Function], Function]:
    """Make the option `--params`; the help text names the package's `own` files and the `default`."""
    return click.option(
        "--params",
        "parameter_files",
        multiple=True,
        type=FILE,
        metavar="FILE",
        help="Parameter file. Can be given several times; later files win. If there is no such file, the package's "
        f"own is used{own}. [default: {default}]",
    )


parameter_values_option = click.option(
    "-p",
    "parameter_values",
    multiple=True,
    metavar="NAME:=VALUE",
    help="Set a parameter, for example -p knee.joint_name:=knee_r. It overrides the files. Can be given several times.",
)
"""Option `-p`"""


def parameter_options(*texts: str) -> Callable[[Function], Function]:
    """Make the options `--params` (`texts`: see `parameter_files_option`) and `-p`; a command gets them as `given`."""
    return group_options(
        "given", ParameterOptions, parameter_files_option(*texts), parameter_values_option
    )


def _kept_option(name: str, key: str, text: str) -> Callable[[Function], Function]:
    """Make a flag that is kept in Click's context by its key; see `is_set`."""

    def keep(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
        context.meta[key] = wanted

    return click.option(name, is_flag=True, expose_value=False, callback=keep, help=text)


json_option = _kept_option(
    "--json", JSON, "Print the results as a JSON object, in SI units, instead of a table."
)
verbose_option = _kept_option(
    "--verbose", VERBOSE, "Print also levels of fidelity and the cost of a tick."
)


def names_in_bag_options(
    of_namespace: str = "Read the inputs from /NAME/... in the bag, and the parameters that a node in that namespace "
    "reads.",
) -> Callable[[Function], Function]:
    """Make the options of names in a bag, which a command gets as `in_bag`; the help text of `--namespace` is given."""
    return group_options(
        "in_bag",
        BagNames,
        click.option(
            "--remap",
            "remaps",
            multiple=True,
            metavar="FROM:=TO",
            help="Read an input from another topic of the bag, for example --remap joint_states:=/exo/joint_states. "
            "Can be given several times.",
        ),
        click.option("--namespace", default="", metavar="NAME", help=of_namespace),
    )
