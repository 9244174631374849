"""Layouts for PlotJuggler of our messages: in degrees, millimetres and newtons for version 3, in SI units for 4.

PlotJuggler 3 names a number `/knee_contact/contact_point/x`, 4 by topic and field; those of a JointState by the
joint's name. The transform `Scale/Offset` of 3 converts; 4 has scripts for that, which a layout cannot count on.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT
from knee_contact_ros.tools.layouts.fields import BLUE, LANES, PLOTS, RED, VIOLET, Colour, Plot

JOINT = "knee"
"""Default of the parameter `knee.joint_name`"""
SHOWN = {"rad": ("deg", 180.0 / math.pi), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
"""Displayed unit and factor to it, by the unit of a field"""
SMALL = {"error_estimate": ("um", 1e6)}
"""Displayed unit and factor to it for single fields"""
LANE_COLOURS = (BLUE, VIOLET, RED)


def layout(namespace: str = "") -> str:
    """Layout file for PlotJuggler 3, as XML text."""
    document = _Layout(namespace, converts=True).document({})
    ET.SubElement(document, "use_relative_time_offset", enabled="1")
    return _text(document)


def layout_4(namespace: str = "") -> str:
    """Layout file for PlotJuggler 4 (`.pj4.xml`), as XML text, which applies to any open recording."""
    attributes = {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"}
    return _text(_Layout(namespace, converts=False).document(attributes))


def path(topic: str, field: str, namespace: str = "") -> str:
    """PlotJuggler's name of a field: `/knee_contact/contact_point/x`."""
    return f"{absolute(topic, namespace)}/{field.replace('.', '/')}"


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="unicode") + "\n"


class _Layout(NamedTuple):
    """Builder of a layout."""

    namespace: str
    converts: bool
    """Whether curves have a transform to another unit, as in PlotJuggler 3"""

    def document(self, attributes: Mapping[str, str]) -> ET.Element:
        """XML document with all tabs; `attributes` are those of its root."""
        root = ET.Element("root", dict(attributes))
        window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
        plots = [self._plot(plot) for plot in PLOTS]
        angle, force, depth, point, sliding, evaluations, error, force_error, reaction, wrench = plots
        _tab(window, "Contact", [angle, force, depth], [self._states(), point, sliding])
        _tab(window, "Load, error and cost", [self._joint(), reaction, wrench], [error, force_error, evaluations])
        ET.SubElement(window, "currentTabIndex", index="0")
        return root

    def _plot(self, plot: Plot) -> ET.Element:
        small = SMALL.get(plot.curves[0].field) if self.converts else None
        unit, factor = small or self._shown(plot.unit)
        shown = plot._replace(unit=unit)
        area, content = _area(shown.with_unit(plot.title))
        for curve in plot.curves:
            self._curve(content, (curve.topic, curve.field), shown.with_unit(curve.name), curve.colour, factor)
        return area

    def _states(self) -> ET.Element:
        area, content = _area("Contact, level, status", style="Steps")
        for lane, colour in zip(LANES, LANE_COLOURS, strict=True):
            self._curve(content, (KNEE_CONTACT, lane.field), lane.title, colour)
        return area

    def _joint(self) -> ET.Element:
        unit, factor = self._shown("rad")
        area, content = _area(f"Joint position [{unit}]")
        self._curve(content, (JOINT_STATES, f"{JOINT}.position"), f"{JOINT} [{unit}]", BLUE, factor)
        return area

    def _shown(self, unit: str) -> tuple[str, float]:
        """Displayed unit for a unit of a field, and the factor to it."""
        return SHOWN.get(unit, (unit, 1.0)) if self.converts else (unit, 1.0)

    def _curve(self, plot: ET.Element, source: tuple[str, str], name: str, colour: Colour, factor: float = 1.0) -> None:
        """Add a curve of a topic and field to a plot; it gets the `name` where it is converted."""
        topic, field = source
        if not self.converts:
            names = {"topic": absolute(topic, self.namespace), "field": field.replace(".", "/")}
            ET.SubElement(plot, "curve", names, color=colour.code)
            return
        curve = ET.SubElement(plot, "curve", name=path(topic, field, self.namespace), color=colour.code)
        transform = ET.SubElement(curve, "transform", name="Scale/Offset", alias=name)
        ET.SubElement(transform, "options", value_scale=repr(factor), value_offset="0", time_offset="0")


def _tab(window: ET.Element, name: str, *columns: list[ET.Element]) -> None:
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=name)
    ET.SubElement(tab, "Container").append(_split("|", [_split("-", column) for column in columns]))


def _split(orientation: str, parts: Sequence[ET.Element]) -> ET.Element:
    """Arrange parts side by side (`|`) or one above the other (`-`), all of the same size."""
    sizes = ";".join([f"{1.0 / len(parts):.4f}"] * len(parts))
    splitter = ET.Element("DockSplitter", orientation=orientation, count=str(len(parts)), sizes=sizes)
    splitter.extend(parts)
    return splitter


def _area(title: str, style: str = "Lines") -> tuple[ET.Element, ET.Element]:
    """Make an area with a title, and the plot in it."""
    area = ET.Element("DockArea", name=title)
    return area, ET.SubElement(area, "plot", mode="TimeSeries", style=style, line_width="1.5")
