"""Blueprint for Rerun's own import of an MCAP recording: it plots fields of our messages as they are recorded.

Rerun turns JointState into curves by itself. Of other messages it keeps the fields, and a blueprint selects those that
are drawn. It can select a field but not calculate with it, so everything is in SI units.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.tools.layouts.fields import JOINTS, LANES, ON_THE_KNEE, PLOTS, STATES, Curve, Lane, Plot

APPLICATION = "knee_contact"
"""Application id of the blueprint in `config/rerun`"""
TIMELINE = "ros2_timestamp"
"""Rerun's name for the stamps in the headers of messages"""


def application_of(recording: Path) -> str:
    """Application id under which Rerun opens an MCAP file: its name without suffix, with underscores for dots."""
    return recording.stem.replace(".", "_")


def blueprint(namespace: str = "") -> rrb.Blueprint:
    """Make views of `/knee_contact` and related topics, of `/left/knee_contact` in the namespace `left`.

    On the left are the answers, on the right how they were computed, and under which load.
    """
    plots = [_plot(plot, namespace) for plot in PLOTS]
    inputs = [_lanes(namespace), *plots[ON_THE_KNEE:], _joints(namespace)]
    shares = [1.8, *[1.0] * len(inputs[1:])]
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*plots[:ON_THE_KNEE]), rrb.Vertical(*inputs, row_shares=shares)),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def save(path: Path, application: str = APPLICATION, namespace: str = "") -> None:
    """Write the blueprint as an `.rbl` file, which Rerun uses for recordings with that application id."""
    blueprint(namespace).save(application, path)


def _plot(plot: Plot, namespace: str) -> rrb.TimeSeriesView:
    overrides: dict[Any, list[Any]] = {}
    for curve in plot.curves:
        overrides.setdefault(absolute(curve.topic, namespace), []).append(_line(plot, curve))
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(overrides),
        name=plot.headline,
        overrides=overrides,
        **_axes(legend=False),
    )


def _line(plot: Plot, curve: Curve) -> Any:
    style = rr.SeriesLines(names=plot.with_unit(curve.name), colors=[curve.colour.rgb], widths=[curve.width])
    return style.visualizer(mappings=[_mapping("Scalars:scalars", curve.topic, curve.field)])


def _lanes(namespace: str) -> rrb.StateTimelineView:
    def lane(what: Lane) -> Any:
        values = list(what.words)
        style = rr.StateConfiguration(
            values=[str(value) for value in values],
            labels=[what.words[value] for value in values],
            colors=[what.colours[value].rgb for value in values],
        )
        return style.visualizer(mappings=[_mapping("StateChange:state", KNEE_CONTACT, what.field)])

    entity = absolute(KNEE_CONTACT, namespace)
    return rrb.StateTimelineView(
        origin="/",
        contents=[entity],
        name=STATES,
        overrides={entity: [lane(what) for what in LANES]},
        time_view=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
    )


def _joints(namespace: str) -> rrb.TimeSeriesView:
    """View of the joint angles as they were received: those of the namespace, and those that both knees share."""
    topics = {absolute(JOINT_STATES, namespace), absolute(JOINT_STATES)}
    return rrb.TimeSeriesView(
        origin="/", contents=sorted(f"{topic}/position" for topic in topics), name=JOINTS, **_axes(legend=True)
    )


def _axes(legend: bool) -> dict[str, Any]:
    """Common time axis and legend of a view."""
    return {
        "axis_x": rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        "plot_legend": rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
    }


def _mapping(target: str, topic: str, field: str) -> Any:
    """Map a field of a topic's messages to the component `target` of a visualizer."""
    return VisualizerComponentMapping(
        target=target,
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=MESSAGE_TYPES[topic].replace("/", ".") + ":message",
        selector=f".{field}",
    )
