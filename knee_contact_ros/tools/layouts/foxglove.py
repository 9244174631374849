"""Layout for Foxglove, and for Lichtblick, which continues its open version, of our messages as they are recorded.

Everything is in SI units: the functions that could convert have other names in the two (`.@degrees`, `.@rad2deg`),
and Lichtblick has none that multiplies.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT
from knee_contact_ros.tools.layouts.fields import BLUE, JOINTS, LANES, ON_THE_KNEE, PLOTS, STATES, Curve, Plot

DIAGNOSTICS = "/diagnostics"
"""Topic of diagnostics, which a running node has, and recordings do not"""
STAMPS = "headerStamp"
"""Foxglove's name for the stamps in the headers of messages"""
LOGARITHMIC = ("error_estimate", "force_error_estimate")
"""Fields that are plotted as logarithms, as they are too small for the three decimals of Lichtblick's axes"""

Panels = dict[str, dict[str, Any]]
"""Configurations of panels by their ids, such as `Plot!force`"""
Mosaic = Any
"""Arrangement of panels: the id of a panel, or two arrangements side by side or one above the other"""


def layout(namespace: str = "") -> dict[str, Any]:
    """Make the content of a layout file: a tab with plots, and one with messages and the node's diagnostics."""
    plots = {f"Plot!{number}": _plot(plot, namespace) for number, plot in enumerate(PLOTS)}
    joints = {f"Plot!{len(PLOTS)}": _joints(namespace)}
    states = {"StateTransitions!states": _states(namespace)}
    messages = {
        "RawMessages!answer": _raw(absolute(KNEE_CONTACT, namespace)),
        "RawMessages!joints": _raw(absolute(JOINT_STATES, namespace)),
        "DiagnosticSummary!node": {"topicToRender": DIAGNOSTICS, "minLevel": 0, "pinnedIds": []},
    }
    ids = list(plots)
    answers, inputs = _split("column", ids[:ON_THE_KNEE]), _split("column", [*ids[ON_THE_KNEE:], *joints])
    knee = _split("row", [answers, _split("column", [*states, inputs], share=30.0)])
    tabs = [{"title": "Knee", "layout": knee}, {"title": "Messages", "layout": _split("row", list(messages))}]
    tab: Panels = {"Tab!knee": {"activeTabIdx": 0, "tabs": tabs}}
    return {
        "configById": tab | plots | joints | states | messages,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!knee",
    }


def path(topic: str, field: str, namespace: str = "") -> str:
    """Foxglove's name of a field: `/knee_contact.contact_point.x`."""
    return f"{absolute(topic, namespace)}.{field}"


def _split(direction: str, parts: Sequence[Mosaic], share: float | None = None) -> Mosaic:
    """Arrange parts in a `row` or `column`, all of the same size unless the first has a `share` [%]."""
    if len(parts) == 1:
        return parts[0]
    rest = _split(direction, parts[1:])
    share = share or round(100.0 / len(parts), 1)
    return {"direction": direction, "first": parts[0], "second": rest, "splitPercentage": share}


def _raw(topic: str) -> dict[str, Any]:
    return {"topicPath": topic, "diffEnabled": False, "diffMethod": "custom", "diffTopicPath": ""}


def _plot(plot: Plot, namespace: str) -> dict[str, Any]:
    """Configuration of a plot; its curves are in reverse order, as the first is drawn in front."""
    logarithm = any(curve.field in LOGARITHMIC for curve in plot.curves)
    before, after = ("log10 of ", ".@log10") if logarithm else ("", "")
    return _axes(before + plot.headline) | {
        "paths": [
            _series(path(curve.topic, curve.field, namespace) + after, before + plot.with_unit(curve.name), curve)
            for curve in reversed(plot.curves)
        ]
    }


def _joints(namespace: str) -> dict[str, Any]:
    first = Curve(JOINT_STATES, "position[0]", "first joint [rad]", BLUE)
    return _axes(JOINTS) | {"paths": [_series(path(first.topic, first.field, namespace), first.name, first)]}


def _series(value: str, label: str, curve: Curve) -> dict[str, Any]:
    look = {"color": curve.colour.code, "showLine": True, "lineSize": curve.width / 2.0}
    return {"value": value, "label": label, "enabled": True, "timestampMethod": STAMPS, **look}


def _axes(headline: str) -> dict[str, Any]:
    return _titled(headline) | {
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": False,
        "legendDisplay": "none",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }


def _titled(title: str) -> dict[str, Any]:
    """Title of a panel, under the key of each of the two viewers."""
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}


def _states(namespace: str) -> dict[str, Any]:
    return _titled(STATES) | {
        "isSynced": True,
        "paths": [
            {"value": path(KNEE_CONTACT, lane.field, namespace), "label": lane.title, "timestampMethod": STAMPS}
            for lane in LANES
        ],
    }
