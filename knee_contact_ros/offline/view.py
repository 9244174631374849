"""`knee-contact view`: recordings in Rerun, as they would have been seen live."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import NamedTuple
from urllib.parse import quote

import click

from knee_contact_ros.bags.bag_files import refuse_input
from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, RESET, Change
from knee_contact_ros.bags.recorded_answers import answer_topics
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.output_files import refuse_existing
from knee_contact_ros.system.ports import LOCALHOST, refuse_taken
from knee_contact_ros.system.processes import interrupted_by_sigterm, kept
from knee_contact_ros.system.resources import refuse_twice
from knee_contact_ros.system.terminal import progress, say
from knee_contact_ros.view.cursor import put_on_peak
from knee_contact_ros.view.file_server import served
from knee_contact_ros.view.outlets import RerunFile
from knee_contact_ros.view.recorded import RecordedKnee, answers_of, distinct, recorded_knees
from knee_contact_ros.view.scene import Scene
from knee_contact_ros.view.window import (
    ANY_PORT,
    connect_command,
    ending,
    executable,
    hidden,
    refuse_blind,
    uncoloured,
)

SERVED = ("rerun+", "http://")
"""How the address of a scene begins that a node serves, or `--serve`"""
INSTEAD = "say --save OUT.rrd or --serve"
PATIENCE = 5.0
"""How long [s] a viewer may take to end"""
DRAWN = ".rrd"
"""How the name of a Rerun file ends"""


class ViewOptions(NamedTuple):
    """How to see them; on a screen of this machine if nothing else is said."""

    save: Path | None = None
    """`.rrd` file to write"""
    overwrite: bool = False
    serve: bool = False
    """To browsers and viewers on this machine"""
    port: int = 9876
    """Where; browsers on the next one"""


@interrupted_by_sigterm()
def run_view(sources: Sequence[str], parameters: Parameters, way: ViewOptions) -> None:
    """Show recordings, gait bags, Rerun files or what nodes serve.

    `parameters` are those of files that do not tell theirs.

    Raises:
        UsageError: a source or a way cannot be used.
        IncompleteError: the viewer failed.
    """
    addresses = [source for source in sources if source.startswith(SERVED)]
    if addresses:
        if len(addresses) < len(sources) or way.save or way.serve:
            raise UsageError(f"{addresses[0]}: what is served can only be looked at, and not together with files")
        refuse_blind(INSTEAD)
        look(connect_command(addresses))
        return
    check(way)
    if sources[0].endswith(DRAWN):
        present(drawn_already(sources, way), way)
        return
    with TemporaryDirectory(prefix="knee_contact_view_") as folder:
        work = Path(folder)
        path = way.save or work / "knee_contact.rrd"
        refuse_twice(list(map(Path, sources)))
        for source in sources:
            refuse_input(Path(source), path)
        knees = recorded_knees(with_answers([Path(source) for source in sources], parameters, work), parameters)
        draw(knees, path, way.overwrite)
        for knee in knees:
            if not knee.known:
                say(f"{knee.recording} does not tell its parameters: drawn with those of --params", err=True)
        if way.save:
            say(f"Rerun file   {way.save}")
        else:
            present(path, way)


def present(path: Path, way: ViewOptions) -> None:
    """Show a Rerun file."""
    if way.serve:
        serve(path, way.port)
    else:
        look_at(path)


def look_at(path: Path) -> None:
    """Show a Rerun file in a window, at its largest load, until that is closed.

    Raises:
        UsageError: as `look`.
    """
    place = hidden()
    put_on_peak(path, place.url)
    look([str(executable()), *place.options, str(path)])


def drawn_already(sources: Sequence[str], way: ViewOptions) -> Path:
    """The Rerun file that is the only source."""
    path = Path(sources[0])
    if len(sources) > 1 or way.save:
        raise UsageError(f"{path} is a Rerun file: it can be looked at or served, alone")
    if not path.is_file():
        raise UsageError(f"no Rerun file at {path}")
    return path


def check(way: ViewOptions) -> None:
    """Tell before any work that it would be in vain.

    Raises:
        UsageError: the file exists, a port is taken, or there is no screen.
    """
    if way.save and way.serve:
        raise UsageError("--save and --serve: one of them")
    if way.save and not way.overwrite:
        refuse_existing(way.save)
    if way.serve:
        for port in (way.port, way.port + 1):
            refuse_taken(port, "--port")
    if not way.save and not way.serve:
        refuse_blind(INSTEAD)


def with_answers(paths: Sequence[Path], parameters: Parameters, work: Path) -> dict[Path, str]:
    """Recordings with answers and their names: those given, or the given bag computed into the folder `work`."""
    names = distinct([path.name.split(".")[0] for path in map(Path.resolve, paths)])
    found = {}
    for path, name in zip(paths, names, strict=True):
        answered = path
        if not answer_topics(path):
            answered = work / f"{name}.mcap"
            with progress(f"Solving {name}") as advance:
                solve(path, parameters, answered, advance)
        found[answered] = name
    return found


def draw(knees: Sequence[RecordedKnee], path: Path, overwrite: bool = False) -> None:
    """Write the scene of some knees to a file, which is there when it is complete."""
    outlet = RerunFile(path, [knee.drawing for knee in knees], overwrite=overwrite)
    try:
        for number, knee in enumerate(knees):
            scene = Scene(outlet.recording, knee.drawing, number=number if len(knees) > 1 else None)
            with progress(f"Drawing {knee.drawing.knee}") as advance:
                for changes, shown in answers_of(knee, advance):
                    for change in changes:
                        scene.note(*note_of(change))
                    scene.show(shown)
            scene.finish()
        outlet.close()
    except BaseException:
        outlet.discard()
        raise


def note_of(change: Change) -> tuple[str, dict[str, str]]:
    """Name and values of the note that told of a change."""
    if change.values is None:
        return RESET, {}
    return PARAMETERS_CHANGED, {name: json.dumps(value) for name, value in change.values.items()}


def serve(path: Path, port: int) -> None:
    """Show a file to browsers and viewers on this machine until Ctrl-C.

    Rerun serves the page only, which holds nothing of the file: while it serves a file it keeps a whole processor busy,
    and answers whoever asks.
    """
    web = port + 1
    with suppress(KeyboardInterrupt), served(path, port, page=web) as scene:
        click.echo(f"In a browser   http://{LOCALHOST}:{web}?url={quote(scene, safe='')}")
        click.echo(f"In a viewer    knee-contact view {scene}")
        click.echo("Ctrl-C ends it.")
        look([str(executable()), "--bind", LOCALHOST, *ANY_PORT, "--serve-web", "--web-viewer-port", str(web), scene])


def look(command: Sequence[str]) -> None:
    """Run a viewer until it ends.

    Raises:
        IncompleteError: it failed.
    """
    with TemporaryFile() as log:
        with kept(command, log, PATIENCE, env=uncoloured()) as process:
            code = process.wait()
        if code:
            raise IncompleteError(f"the Rerun viewer {ending(code, log)}")
