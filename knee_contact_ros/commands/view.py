"""`knee-contact view`: recordings in Rerun, as they would have been seen live."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from urllib.parse import quote

import click

from ..bags.answers import answer_blocks, answer_topics
from ..bags.bag import Bag
from ..bags.folder import others_beside
from ..bags.provenance import PARAMETERS_CHANGED, Change, read_provenance
from ..model.knee import KneeModel
from ..model.types import Rows
from ..offline.held_answers import doubt_of
from ..offline.solve import solve
from ..parameters.build import build_model
from ..parameters.curves import curve_texts
from ..parameters.files import load_parameters
from ..parameters.schema import Parameters
from ..streams.compartments import compartment_of_topic
from ..streams.output import RESET
from ..streams.topics import (
    KNEE,
    LATERAL,
    MEDIAL,
    compartment_name,
    is_lateral,
    knee_name,
)
from ..system.errors import IncompleteError, UsageError
from ..system.files import check_distinct
from ..system.output_files import check_name_free, check_not_input
from ..system.processes import LOCALHOST, check_port_free, interrupted_by_sigterm
from ..system.progress import OnProgress, progress
from ..system.terminal import say, warn
from ..view.anatomy import KneeOutlines, outlines_of_compartments
from ..view.output import (
    RerunFile,
    connect_command,
    require_display,
    run_viewer,
    server_address,
    viewer_command,
)
from ..view.scene import PictureChoice, Scene
from .options import ParameterOptions

_SERVED = ("rerun+", "http://")
"""Beginnings of the address of a scene that a node or `--serve` serves"""
_ALTERNATIVES = "use --save OUT.rrd or --serve"
_MAX_NAME_LENGTH = 80
"""Most characters of a knee's name"""


class DrawnKnee(NamedTuple):
    """A knee whose answers are in a recording."""

    recording: Bag
    topic: str
    """Absolute name of the topic of its answers"""
    model: KneeModel
    """Model with its surfaces and their motion"""
    drawing: KneeOutlines
    """Outlines of the knee"""
    changes: tuple[Change, ...]
    """Resets and changed parameters of the node during the recording"""


@interrupted_by_sigterm()
def run_view(
    sources: Sequence[str],
    given: ParameterOptions,
    save: Path | None,
    overwrite: bool,
    serve: bool,
    port: int,
) -> None:
    """Show recordings, gait bags, a Rerun file or scenes that nodes serve, in a window.

    Args:
        sources: Names of files, or addresses.
        given: Parameters of files that do not hold their own.
        save: Rerun file to write instead.
        overwrite: Whether it may exist.
        serve: Whether to serve the scene to browsers and viewers on this machine instead.
        port: Port at which viewers are served; browsers are served at the next one.

    Raises:
        UsageError: a source or an option cannot be used.
        IncompleteError: the viewer failed; or a bag was damaged, and what can be read was shown.
    """
    warn(sentence for source in sources for sentence in others_beside(Path(source)))
    parameters = load_parameters([*given.files(), given.values()])
    addresses = [source for source in sources if source.startswith(_SERVED)]
    if addresses and (len(addresses) < len(sources) or save or serve):
        raise UsageError(
            f"{addresses[0]}: a served scene can only be viewed, and not together with files"
        )
    _check_before_work(save, overwrite, (port, port + 1) if serve else ())
    if addresses:
        run_viewer(connect_command(addresses))
        return
    if sources[0].endswith(".rrd"):
        drawn = Path(sources[0])
        if len(sources) > 1 or save:
            raise UsageError(
                f"{drawn} is a Rerun file: it can only be viewed or served, and only alone"
            )
        if not drawn.is_file():
            raise UsageError(f"no Rerun file at {drawn}")
        _present(drawn, port if serve else None)
        return
    with TemporaryDirectory(prefix="knee_contact_view_") as folder, ExitStack() as opened:
        path = save or Path(folder, "knee_contact.rrd")
        check_distinct(list(map(Path, sources)))
        bags = [opened.enter_context(Bag(Path(source))) for source in sources]
        for bag in bags:
            check_not_input(path, bag.paths)
        recordings, missing = _with_answers(bags, parameters, Path(folder), opened)
        _draw([*recorded_knees(recordings, parameters)], path, overwrite)
        if save:
            say(f"Rerun file   {save}")
        else:
            _present(path, port if serve else None)
    if any(missing):
        raise IncompleteError("; ".join(filter(None, missing)))


def _check_before_work(save: Path | None, overwrite: bool, ports: Sequence[int]) -> None:
    """Check options before any work.

    Raises:
        UsageError: the file to write exists, one of the `ports` that will be served is taken, or there is no screen.
    """
    if save and ports:
        raise UsageError("--save and --serve cannot be given together")
    if save and not overwrite:
        check_name_free(save)
    for port in ports:
        check_port_free(port, "--port")
    if not save and not ports:
        require_display(_ALTERNATIVES)


def recorded_knees(recordings: Mapping[Bag, str], parameters: Parameters) -> Iterator[DrawnKnee]:
    """Yield all knees in several recordings, each with a name of its own.

    The values of `recordings` are names, used where topics do not name the knee; `parameters` are those of recordings
    that do not hold theirs.

    Raises:
        UsageError: a recording cannot be used.
    """
    answered = {path: answer_topics(path) for path in recordings}
    alone = (
        len({(path, knee_name(topic)) for path, topics in answered.items() for topic in topics})
        == 1
    )
    names = []
    for path, topics in answered.items():
        for topic in topics:
            name = knee_name(topic)
            name = name.replace("/", "_") if name != KNEE or alone else recordings[path]
            if is_lateral(topic) or f"{topic}/{LATERAL}" in topics:
                name = compartment_name(name, LATERAL if is_lateral(topic) else MEDIAL)
            names.append(
                "".join(letter if letter.isprintable() else "_" for letter in name)[
                    :_MAX_NAME_LENGTH
                ]
            )
    distinct = iter(_distinct(names))
    for path, topics in answered.items():
        yield from _knees(path, topics, [next(distinct) for _ in topics], parameters)


def _distinct(names: Sequence[str]) -> list[str]:
    """Make names distinct: those that occur several times get a number."""
    return [
        f"{name}_{names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def _knees(
    bag: Bag, topics: Sequence[str], names: Sequence[str], parameters: Parameters
) -> Iterator[DrawnKnee]:
    """Build the knees of a recording from the parameters in it, or from `parameters` if it holds none."""
    provenance = read_provenance(bag)
    if provenance is None:
        say(f"{bag} does not hold its parameters: drawn with those of --params", err=True)
    parameters = provenance.parameters if provenance else parameters
    texts = provenance.file_contents() if provenance else curve_texts(parameters, {})
    models = [
        build_model(own, curves=curves)
        for own, curves in (compartment_of_topic(one, parameters, texts) for one in topics)
    ]
    if provenance is None:
        warn(filter(None, map(partial(doubt_of, bag), topics, models)))
    drawings = outlines_of_compartments(models, names, parameters.body_weight)
    for topic, model, drawing in zip(topics, models, drawings, strict=True):
        yield DrawnKnee(bag, topic, model, drawing, provenance.changes if provenance else ())


def _with_answers(
    bags: Sequence[Bag], parameters: Parameters, work: Path, opened: ExitStack
) -> tuple[dict[Bag, str], list[str]]:
    """Return recordings with answers, and a name for each; a bag without answers is computed into the folder `work`.

    `opened` closes such recordings.

    Also return sentences on what is missing in these bags, and warn of what is implausible.
    """
    names = _distinct([path.name.split(".")[0] for path in (bag.path.resolve() for bag in bags)])
    recordings = {}
    missing = list[str]()
    for bag, name in zip(bags, names, strict=True):
        answered = bag
        if not answer_topics(bag):
            output = work / f"{name}.mcap"
            with progress(f"Solving {name}") as advance:
                summary = solve(bag, parameters, output, advance)
            answered = opened.enter_context(Bag(output))
            warn(summary.warnings)
            missing.append(summary.missing_parts(bag.path))
        recordings[answered] = name
    return recordings, missing


def _draw(knees: Sequence[DrawnKnee], path: Path, overwrite: bool) -> None:
    """Write the scene of several knees to a Rerun file, which appears under its name when it is complete."""
    file = RerunFile(path, [knee.drawing for knee in knees], overwrite=overwrite)
    try:
        for knee in knees:
            scene = Scene(
                file.recording,
                knee.drawing,
                among=[each.drawing.knee for each in knees],
                gait_events=knee.recording.gait_events,
            )
            with progress(f"Drawing {knee.drawing.knee}") as advance:
                for changes, answers in _answers_of(knee, advance):
                    for change in changes:
                        values = {
                            name: json.dumps(value)
                            for name, value in (change.values or {}).items()
                        }
                        scene.note(RESET if change.values is None else PARAMETERS_CHANGED, values)
                    scene.show(answers)
            scene.finish()
        file.close()
    except BaseException:
        file.discard()
        raise


def _answers_of(knee: DrawnKnee, advance: OnProgress) -> Iterator[tuple[Sequence[Change], Rows]]:
    """Yield blocks of answers, each with the changes of the node right before it; for `advance` see `answer_blocks`.

    Answers that are drawn get femoral x and normal, which messages do not hold.
    """
    pictures = PictureChoice()
    done = 0
    for block in answer_blocks(knee.recording, knee.topic, advance):
        for i in pictures.choose(block["stamp"]).tolist():
            angle = float(block["flexion_angle"][i])
            height = float(block["femoral_height"][i])
            x, _ = knee.model.pair.mechanism.translation(angle)
            closest = knee.model.pair.closest(angle, height)
            block["femoral_x"][i] = x
            block["normal_x"][i] = closest.normal_x
            block["normal_y"][i] = closest.normal_y
        places = [change.tick - done for change in knee.changes]
        for begin, end in pairwise(
            sorted({0, len(block), *(place for place in places if 0 < place < len(block))})
        ):
            yield (
                [one for one, place in zip(knee.changes, places, strict=True) if place == begin],
                block[begin:end],
            )
        done += len(block)


def _present(path: Path, port: int | None) -> None:
    """Show a Rerun file in a window, or let Rerun serve it to browsers and viewers on this machine until Ctrl-C."""
    if port is None:
        run_viewer(viewer_command(str(path)))
        return
    scene = server_address(port)
    web = port + 1
    command = viewer_command("--serve-web", "--web-viewer-port", str(web), str(path), port=port)
    with suppress(KeyboardInterrupt):
        click.echo(f"In a browser   http://{LOCALHOST}:{web}?url={quote(scene, safe='')}")
        click.echo(f"In a viewer    knee-contact view {scene}")
        click.echo("Ctrl-C ends it.")
        run_viewer(command)
