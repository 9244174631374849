"""A blueprint for Rerun's own import of an MCAP recording: it plots fields of our messages as they were recorded.

Rerun knows JointState and turns it into curves. Of other messages it keeps the fields, and a blueprint says which of
them are drawn. It can pick a field but not calculate with it, so everything is in SI units.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.messages.topics import JOINT_STATES, KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.tools.layouts.fields import JOINTS, LANES, ON_THE_KNEE, PLOTS, STATES, Curve, Lane, Plot

if TYPE_CHECKING:
    import rerun.blueprint as rrb

APPLICATION = "knee_contact"
"""Application id of the blueprint that is shipped"""
TIMELINE = "ros2_timestamp"
"""Rerun's name for the stamps in the messages' headers"""


def application_of(recording: Path) -> str:
    """The application id under which Rerun opens an MCAP file: its name without suffix, and without dots."""
    return recording.stem.replace(".", "_")


def component(topic: str) -> str:
    """Rerun's name for the messages of one of our topics."""
    return MESSAGE_TYPES[topic].replace("/", ".") + ":message"


def selector(field: str) -> str:
    """Rerun's name for a field of a message."""
    return f".{field}"


def blueprint(namespace: str = "") -> rrb.Blueprint:
    """Views of `/knee_contact` and what belongs to it; of `/left/knee_contact` in the namespace `left`.

    On the left the answers, on the right how they came about, and under which load.
    """
    import rerun.blueprint as rrb

    plots = [_plot(plot, namespace) for plot in PLOTS]
    states, joints = _lanes(namespace), _joints(namespace)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*plots[:ON_THE_KNEE]),
            rrb.Vertical(
                states, *plots[ON_THE_KNEE:], joints, row_shares=[1.8, *[1.0] * len(plots[ON_THE_KNEE - 1 :])]
            ),
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def save(path: Path, application: str = APPLICATION, namespace: str = "") -> None:
    """Write the blueprint as an `.rbl` file, which Rerun uses for recordings of that application id."""
    blueprint(namespace).save(application, path)


def _plot(plot: Plot, namespace: str) -> rrb.TimeSeriesView:
    import rerun.blueprint as rrb

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
    import rerun as rr

    style = rr.SeriesLines(names=plot.with_unit(curve.name), colors=[curve.colour.rgb], widths=[curve.width])
    return style.visualizer(mappings=[_mapping("Scalars:scalars", curve.topic, curve.field)])


def _lanes(namespace: str) -> rrb.StateTimelineView:
    import rerun as rr
    import rerun.blueprint as rrb

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
    """The angles as they came: those of the namespace and those that both knees share."""
    import rerun.blueprint as rrb

    topics = {absolute(JOINT_STATES, namespace), absolute(JOINT_STATES)}
    return rrb.TimeSeriesView(
        origin="/", contents=sorted(f"{topic}/position" for topic in topics), name=JOINTS, **_axes(legend=True)
    )


def _axes(legend: bool) -> dict[str, Any]:
    """One time axis for all."""
    import rerun.blueprint as rrb

    return {
        "axis_x": rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        "plot_legend": rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
    }


def _mapping(target: str, topic: str, field: str) -> Any:
    """A visualizer's `target` is filled from a field of a topic's messages."""
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

    return VisualizerComponentMapping(
        target=target,
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=component(topic),
        selector=selector(field),
    )
