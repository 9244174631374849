"""A layout for PlotJuggler 3: our messages in degrees, millimetres and newtons.

PlotJuggler knows a number as `/knee_contact/contact_point/x`, and a JointState's by the joint's name. Its transform
`Scale/Offset` converts.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.messages.topics import JOINT_STATES, KNEE_CONTACT
from knee_contact_ros.tools.layouts.fields import BLUE, LANES, PLOTS, RED, VIOLET, Colour, Plot

JOINT = "knee"
"""Default of the parameter `knee.joint_name`"""
SHOWN = {"rad": ("deg", 180.0 / math.pi), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
"""Unit of a field to the unit shown, and the factor between them"""
SMALL = {"error_estimate": ("um", 1e6)}
"""The same for single fields"""
LANE_COLOURS = (BLUE, VIOLET, RED)


def layout(namespace: str = "") -> str:
    """What is loaded as a layout file, XML."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    angle, force, depth, point, sliding, evaluations, error, force_error, reaction, wrench = (
        _plot(plot, namespace) for plot in PLOTS
    )
    _tab(window, "Contact", [angle, force, depth], [_states(namespace), point, sliding])
    _tab(window, "Load, error and cost", [_joint(namespace), reaction, wrench], [error, force_error, evaluations])
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="unicode") + "\n"


def path(topic: str, field: str, namespace: str = "") -> str:
    """PlotJuggler's name for a field: `/knee_contact/contact_point/x`."""
    return f"{absolute(topic, namespace)}/{field.replace('.', '/')}"


def _tab(window: ET.Element, name: str, *columns: list[ET.Element]) -> None:
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=name)
    ET.SubElement(tab, "Container").append(_split("|", [_split("-", column) for column in columns]))


def _split(orientation: str, parts: Sequence[ET.Element]) -> ET.Element:
    """Side by side (`|`) or one above the other (`-`), all of one size."""
    sizes = ";".join([f"{1.0 / len(parts):.4f}"] * len(parts))
    splitter = ET.Element("DockSplitter", orientation=orientation, count=str(len(parts)), sizes=sizes)
    splitter.extend(parts)
    return splitter


def _area(title: str, style: str = "Lines") -> tuple[ET.Element, ET.Element]:
    """A place with a title, and the plot in it."""
    area = ET.Element("DockArea", name=title)
    return area, ET.SubElement(area, "plot", mode="TimeSeries", style=style, line_width="1.5")


def _plot(plot: Plot, namespace: str) -> ET.Element:
    unit, factor = SMALL.get(plot.curves[0].field, SHOWN.get(plot.unit, (plot.unit, 1.0)))
    shown = plot._replace(unit=unit)
    area, content = _area(shown.with_unit(plot.title))
    for curve in plot.curves:
        source = path(curve.topic, curve.field, namespace)
        _curve(content, source, shown.with_unit(curve.name), curve.colour, factor)
    return area


def _states(namespace: str) -> ET.Element:
    area, content = _area("Contact, level, status", style="Steps")
    for lane, colour in zip(LANES, LANE_COLOURS, strict=True):
        _curve(content, path(KNEE_CONTACT, lane.field, namespace), lane.title, colour)
    return area


def _joint(namespace: str) -> ET.Element:
    unit, factor = SHOWN["rad"]
    area, content = _area(f"Joint position [{unit}]")
    _curve(content, path(JOINT_STATES, f"{JOINT}.position", namespace), f"{JOINT} [{unit}]", BLUE, factor)
    return area


def _curve(plot: ET.Element, source: str, name: str, colour: Colour, factor: float = 1.0) -> None:
    curve = ET.SubElement(plot, "curve", name=source, color=colour.code)
    transform = ET.SubElement(curve, "transform", name="Scale/Offset", alias=name)
    ET.SubElement(transform, "options", value_scale=repr(factor), value_offset="0", time_offset="0")
