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
from knee_contact_ros.view import window
from knee_contact_ros.view.cursor import put_on_peak
from knee_contact_ros.view.file_server import served
from knee_contact_ros.view.outlets import RerunFile
from knee_contact_ros.view.recorded import RecordedKnee, answers_of, distinct, recorded_knees
from knee_contact_ros.view.scene import Scene

SERVED = ("rerun+", "http://")
"""Beginnings of the address of a scene that a node or `--serve` serves"""
ALTERNATIVES = "say --save OUT.rrd or --serve"
PATIENCE = 5.0
"""Time [s] that a viewer may take to end"""
RERUN_SUFFIX = ".rrd"
"""Suffix of a Rerun file"""


class ViewOptions(NamedTuple):
    """Options of viewing: by default in a window on a screen of this machine."""

    save: Path | None = None
    """Rerun file (.rrd) to write instead"""
    overwrite: bool = False
    serve: bool = False
    """Whether to serve the scene to browsers and viewers on this machine instead"""
    port: int = 9876
    """Port at which viewers are served; browsers are served at the next one"""


@interrupted_by_sigterm()
def run_view(sources: Sequence[str], parameters: Parameters, options: ViewOptions) -> None:
    """Show recordings, gait bags, a Rerun file or scenes that nodes serve.

    Files that do not hold their parameters are drawn with `parameters`.

    Raises:
        UsageError: a source or an option cannot be used.
        IncompleteError: the viewer failed.
    """
    addresses = [source for source in sources if source.startswith(SERVED)]
    if addresses:
        if len(addresses) < len(sources) or options.save or options.serve:
            raise UsageError(f"{addresses[0]}: what is served can only be looked at, and not together with files")
        window.refuse_blind(ALTERNATIVES)
        look(window.connect_command(addresses))
        return
    check(options)
    if sources[0].endswith(RERUN_SUFFIX):
        present(drawn_already(sources, options), options)
        return
    with TemporaryDirectory(prefix="knee_contact_view_") as folder:
        work = Path(folder)
        path = options.save or work / "knee_contact.rrd"
        refuse_twice(list(map(Path, sources)))
        for source in sources:
            refuse_input(Path(source), path)
        knees = recorded_knees(with_answers([Path(source) for source in sources], parameters, work), parameters)
        draw(knees, path, options.overwrite)
        for knee in knees:
            if not knee.known:
                say(f"{knee.recording} does not tell its parameters: drawn with those of --params", err=True)
        if options.save:
            say(f"Rerun file   {options.save}")
        else:
            present(path, options)


def present(path: Path, options: ViewOptions) -> None:
    """Serve a Rerun file, or show it in a window."""
    if options.serve:
        serve(path, options.port)
    else:
        look_at(path)


def look_at(path: Path) -> None:
    """Show a Rerun file in a window, at its largest load, until the window is closed.

    Raises:
        UsageError: Rerun is not installed.
        IncompleteError: the viewer failed.
    """
    place = window.hidden()
    put_on_peak(path, place.url)
    look([str(window.executable()), *place.options, str(path)])


def drawn_already(sources: Sequence[str], options: ViewOptions) -> Path:
    """Return the Rerun file that is the only source.

    Raises:
        UsageError: there are other sources, or the file does not exist.
    """
    path = Path(sources[0])
    if len(sources) > 1 or options.save:
        raise UsageError(f"{path} is a Rerun file: it can be looked at or served, alone")
    if not path.is_file():
        raise UsageError(f"no Rerun file at {path}")
    return path


def check(options: ViewOptions) -> None:
    """Refuse options before any work that would be in vain.

    Raises:
        UsageError: the file to write exists, a port is taken, or there is no screen.
    """
    if options.save and options.serve:
        raise UsageError("--save and --serve: one of them")
    if options.save and not options.overwrite:
        refuse_existing(options.save)
    if options.serve:
        for port in (options.port, options.port + 1):
            refuse_taken(port, "--port")
    if not options.save and not options.serve:
        window.refuse_blind(ALTERNATIVES)


def with_answers(paths: Sequence[Path], parameters: Parameters, work: Path) -> dict[Path, str]:
    """Return recordings with answers, and a name for each; a bag without answers is computed into the folder `work`."""
    names = distinct([path.name.split(".")[0] for path in map(Path.resolve, paths)])
    recordings = {}
    for path, name in zip(paths, names, strict=True):
        answered = path
        if not answer_topics(path):
            answered = work / f"{name}.mcap"
            with progress(f"Solving {name}") as advance:
                solve(path, parameters, answered, advance)
        recordings[answered] = name
    return recordings


def draw(knees: Sequence[RecordedKnee], path: Path, overwrite: bool = False) -> None:
    """Write the scene of several knees to a Rerun file, which appears under its name when it is complete."""
    outlet = RerunFile(path, [knee.drawing for knee in knees], overwrite=overwrite)
    try:
        for number, knee in enumerate(knees):
            scene = Scene(outlet.recording, knee.drawing, number=number if len(knees) > 1 else None)
            with progress(f"Drawing {knee.drawing.knee}") as advance:
                for changes, answers in answers_of(knee, advance):
                    for change in changes:
                        scene.note(*note_of(change))
                    scene.show(answers)
            scene.finish()
        outlet.close()
    except BaseException:
        outlet.discard()
        raise


def note_of(change: Change) -> tuple[str, dict[str, str]]:
    """Return the name and the values of the note with which the node reported a change."""
    if change.values is None:
        return RESET, {}
    return PARAMETERS_CHANGED, {name: json.dumps(value) for name, value in change.values.items()}


def serve(path: Path, port: int) -> None:
    """Serve a Rerun file to browsers and viewers on this machine until Ctrl-C.

    Rerun itself serves only the page, which holds nothing of the file: while it serves a file it keeps a whole
    processor busy, and it answers everybody.
    """
    web = port + 1
    with suppress(KeyboardInterrupt), served(path, port, page=web) as scene:
        click.echo(f"In a browser   http://{LOCALHOST}:{web}?url={quote(scene, safe='')}")
        click.echo(f"In a viewer    knee-contact view {scene}")
        click.echo("Ctrl-C ends it.")
        look(
            [
                str(window.executable()),
                "--bind",
                LOCALHOST,
                *window.ANY_PORT,
                "--serve-web",
                "--web-viewer-port",
                str(web),
                scene,
            ]
        )


def look(command: Sequence[str]) -> None:
    """Run the command of a viewer until it ends.

    Raises:
        IncompleteError: the viewer failed.
    """
    with TemporaryFile() as log:
        with kept(command, log, PATIENCE, env=window.uncoloured()) as process:
            code = process.wait()
        if code:
            raise IncompleteError(f"the Rerun viewer {window.ending(code, log)}")
