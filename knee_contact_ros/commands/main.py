"""The command `knee-contact`.

Bad input ends it with code 2 and one line, work that is done in part (a full disk, a damaged bag) with 1, Ctrl-C with
130. Commands that need a whole recording, such as `table`, refuse a damaged one with 2.
"""

import os
import sys
from io import TextIOWrapper
from pathlib import Path

import click

from .. import __version__
from ..system.errors import IncompleteError, UsageError, printable
from . import lab, live, offline

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it: 128 and the number of SIGINT"""

GROUPS = {
    "See it": (live.demo, live.watch, offline.view, lab.report, offline.table),
    "Compute": (
        live.node,
        live.load,
        live.replay,
        offline.solve,
        offline.estimate_load,
        offline.recover,
    ),
    "Bring your own data": (
        lab.import_opensim,
        lab.import_csv,
        lab.align,
        lab.fit_profile,
        lab.calibrate,
    ),
    "Take it elsewhere": (lab.export, offline.cite),
    "Study": (lab.sweep, lab.sensitivity, lab.trade),
    "Report a fault": (offline.about,),
}
"""Commands by what they are for, as the help shows them"""


class GroupedCommands(click.Group):
    """Group whose help lists the commands by `GROUPS`."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write a section for each group."""
        for heading, group in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [(str(command.name), command.get_short_help_str(60)) for command in group]
                )


@click.group(
    cls=GroupedCommands,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, package_name="knee_contact_ros", message="%(prog)s %(version)s")
@click.pass_context
def knee_contact(context: click.Context) -> None:
    """Live tibiofemoral contact from streamed gait. A research tool, not a medical device."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


for commands in GROUPS.values():
    for command in commands:
        knee_contact.add_command(command)


def main(arguments: list[str] | None = None) -> int:
    """Run the command with `arguments`, by default those of the process; return its exit code."""
    open_standard_streams()
    try:
        knee_contact.main(arguments, prog_name="knee-contact", standalone_mode=False)
    except (UsageError, IncompleteError) as error:
        return fail(str(error), code=2 if isinstance(error, UsageError) else 1)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "knee-contact"
        return fail(f"{error.format_message().rstrip('.')}; see {command} --help")
    except BrokenPipeError:
        # The reader of our output has gone. What is still in the buffer is dropped, and not complained of at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return fail(f"{error.filename or 'writing'}: {error.strerror or error}", code=1)
    except (click.Abort, KeyboardInterrupt) as error:
        # Click takes an EOFError for an abort, as at a prompt. No command asks anything: here it is a mistake of ours.
        if isinstance(error.__context__, EOFError):
            raise error.__context__ from None
        click.echo("knee-contact: interrupted", err=True)
        return INTERRUPTED
    return 0


def open_standard_streams() -> None:
    """Open the null device for standard streams that are closed.

    Otherwise the next opened file would get descriptor 0, 1 or 2, and be read or written by mistake. Characters that
    the output does not have, as on a console of Windows, are escapes.
    """
    descriptor = os.open(os.devnull, os.O_RDWR)
    while descriptor <= 2:
        descriptor = os.open(os.devnull, os.O_RDWR)
    os.close(descriptor)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.encoding.lower() != "utf-8":
        sys.stdout.reconfigure(errors="backslashreplace")


def fail(text: str, code: int = 2) -> int:
    """Print an error in one line; return the exit code."""
    click.echo(f"knee-contact: {printable(' '.join(text.split()))}", err=True)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
