"""Make the blueprint with which Rerun plots a recording of ours that it has opened by itself.

    python -m scripts.make_rerun_blueprint --output config/rerun/knee_contact.rbl
    python -m scripts.make_rerun_blueprint --recording REC.mcap [--namespace left] | rerun REC.mcap -

Rerun uses a blueprint for the recordings of one application id; an MCAP file's application id is its name. It turns
JointState into curves by itself. Of other messages it keeps the fields; a blueprint selects those that are drawn. It
can select a field but not calculate with it, so everything is in SI units.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from knee_contact_ros.streams.topics import MESSAGE_TYPES
from scripts.make_layouts import (
    COLOURS,
    JOINTS,
    LANES,
    ON_THE_KNEE,
    PLOTS,
    STATES,
    absolute,
    checked,
)

APPLICATION = "knee_contact"
"""Application id of the blueprint in `config/rerun`"""
TIMELINE = "ros2_timestamp"
"""Rerun's name for the stamps in the headers of messages"""


def application_of(recording: Path) -> str:
    """Application id under which Rerun opens an MCAP file: its name without suffix, with underscores for dots."""
    return recording.stem.replace(".", "_")


def blueprint(namespace: str = "") -> rrb.Blueprint:
    """Make views of the answers (left), and of how and under which load they were computed (right)."""

    def view(name: str, contents: list[str], legend: bool, **options: Any) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/",
            contents=contents,
            name=name,
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
            **options,
        )

    plots = []
    for plot in PLOTS:
        lines = [
            rr.SeriesLines(
                names=plot.with_unit(curve.name),
                colors=[COLOURS[curve.colour]],
                widths=[curve.width],
            ).visualizer(mappings=[source("Scalars:scalars", plot.topic, curve.field)])
            for curve in plot.curves
        ]
        entity = absolute(plot.topic, namespace)
        plots.append(view(plot.headline, [entity], legend=False, overrides={entity: lines}))
    joints = {
        absolute("joint_states", namespace),
        "/joint_states",
    }  # of the namespace, and those that both knees share
    inputs = [
        lanes(namespace),
        *plots[ON_THE_KNEE:],
        view(JOINTS, sorted(f"{each}/position" for each in joints), True),
    ]
    shares = [1.8, *[1.0] * len(inputs[1:])]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*plots[:ON_THE_KNEE]), rrb.Vertical(*inputs, row_shares=shares)
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def lanes(namespace: str) -> rrb.StateTimelineView:
    """View of the states."""
    drawn = []
    for lane in LANES:
        style = rr.StateConfiguration(
            values=[str(int(value)) for value in lane.words],
            labels=list(lane.words.values()),
            colors=[COLOURS[lane.colours[value]] for value in lane.words],
        )
        drawn.append(
            style.visualizer(mappings=[source("StateChange:state", "knee_contact", lane.field)])
        )
    entity = absolute("knee_contact", namespace)
    return rrb.StateTimelineView(
        origin="/",
        contents=[entity],
        name=STATES,
        overrides={entity: drawn},
        time_view=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
    )


def source(target: str, topic: str, field: str) -> Any:
    """Map a field of a topic's messages to the component `target` of a visualizer."""
    return VisualizerComponentMapping(
        target=target,
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=MESSAGE_TYPES[topic].replace("/", ".") + ":message",
        selector=f".{field}",
    )


@click.command(help=__doc__)
@click.option(
    "--recording",
    type=click.Path(exists=True, path_type=Path),
    help="For this MCAP file, opened directly.",
)
@click.option(
    "--application-id",
    default=APPLICATION,
    show_default=True,
    help="For recordings of this application id.",
)
@click.option("--namespace", default="", callback=checked, help="For /NAMESPACE/knee_contact.")
@click.option(
    "--output", type=click.Path(path_type=Path, dir_okay=False), help="[default: standard output]"
)
def main(recording: Path | None, application_id: str, namespace: str, output: Path | None) -> None:
    """Make the blueprint."""
    if output is None and sys.stdout.isatty():
        raise click.UsageError(
            "a blueprint is no text: say --output FILE.rbl, or pipe it into `rerun REC.mcap -`"
        )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "blueprint.rbl"
        blueprint(namespace).save(application_of(recording) if recording else application_id, path)
        (output.write_bytes if output else sys.stdout.buffer.write)(path.read_bytes())


if __name__ == "__main__":
    main()
