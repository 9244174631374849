"""Make the layouts for Foxglove and PlotJuggler: `python -m scripts.make_layouts [--namespace left] --output config`.

One table says which fields of our messages are plotted, in SI units; `make_rerun_blueprint` reads it too. Foxglove and
Lichtblick, which continues its open version, convert by functions of other names, so everything stays in SI units
there. PlotJuggler 3 names a number `/knee_contact/contact_point/x` and converts by a transform, so it shows degrees and
millimetres; 4 goes by topic and field, and converts by scripts, which a layout cannot count on.
"""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from knee_contact_ros.model.types import FIELDS, ContactState, Fidelity, Status

COLOURS = {
    "blue": (110, 170, 235),
    "red": (235, 95, 80),
    "grey": (140, 150, 175),
    "yellow": (250, 200, 70),
    "green": (110, 200, 130),
    "sand": (205, 175, 120),
    "violet": (190, 140, 230),
}
"""Red, green and blue from 0 to 255"""
STATES = "Contact, level of the model, status"
JOINTS = "Joint positions [rad]"
"""Title of the plot of `joint_states`, whose curves are named after the joints"""
ON_THE_KNEE = 4 + sum(bool(field.plot) for field in FIELDS.values())
"""Number of the first plots that show what the knee does; the others show how that was computed"""


class Curve(NamedTuple):
    """Number in a message that is plotted over time."""

    field: str
    """Name of the field with dots: `contact_point.x`"""
    name: str
    colour: str
    width: float = 1.5
    """Width of the line [pixels]"""


class Plot(NamedTuple):
    """Plot of fields of one topic."""

    title: str
    unit: str
    """Unit of all curves; empty for a count"""
    curves: tuple[Curve, ...]
    topic: str = "knee_contact"

    def with_unit(self, name: str) -> str:
        """Text of a name with the unit: `load [N]`."""
        return f"{name} [{self.unit}]" if self.unit else name

    @property
    def headline(self) -> str:
        """Title with unit, names and colours of the curves: a legend would lie over them."""
        names = ", ".join(f"{curve.name} {curve.colour}" for curve in self.curves)
        return self.with_unit(f"{self.title}: {names}" if len(self.curves) > 1 else self.title)


OWN = [
    Plot(field.plot, field.unit, (Curve(name, name.replace("_", " "), "green"),))
    for name, field in FIELDS.items()
    if field.plot
]
"""Plots of the fields whose declaration gives a title"""
PLOTS = (
    Plot("Flexion angle", "rad", (Curve("flexion_angle", "flexion angle", "blue", 2.0),)),
    Plot(
        "Force",
        "N",
        (Curve("load", "load", "grey", 4.0), Curve("contact_force", "contact force", "red")),
    ),
    Plot(
        "Depth",
        "m",
        (
            Curve("penetration_depth", "penetration", "blue", 2.0),
            Curve("bone_depth", "in the second layer", "sand"),
            Curve("gap", "gap", "grey"),
        ),
    ),
    Plot(
        "Contact point",
        "m",
        (
            Curve("contact_point.x", "anterior", "yellow", 3.0),
            Curve("contact_point.y", "superior", "green"),
        ),
    ),
    *OWN,
    Plot("Evaluations per tick", "", (Curve("evaluations", "evaluations", "violet"),)),
    Plot("Error of the depth", "m", (Curve("error_estimate", "error estimate", "yellow"),)),
    Plot(
        "Error of the force", "N", (Curve("force_error_estimate", "force error estimate", "red"),)
    ),
    Plot(
        "Joint reaction",
        "N",
        (
            Curve("wrench.force.x", "anterior", "blue"),
            Curve("wrench.force.y", "superior", "red", 2.0),
            Curve("wrench.force.z", "right", "grey"),
        ),
        "joint_reaction_force",
    ),
    Plot(
        "Force on the tibia",
        "N",
        (
            Curve("wrench.force.x", "anterior", "blue"),
            Curve("wrench.force.y", "superior", "red", 2.0),
        ),
        "knee_contact/wrench",
    ),
)


class Lane(NamedTuple):
    """Lane of a field of `knee_contact` that stands for a state."""

    field: str
    title: str
    words: dict[int, str]
    """Name of the state for each number"""
    colours: dict[int, str]


def words_of(kind: type[ContactState | Fidelity]) -> dict[int, str]:
    """Names of the states of a kind."""
    return {state: state.name.lower().replace("_", " ") for state in kind}


STATUS = {
    value: " + ".join(
        str(bit.name).lower().replace("_", " ") for bit in Status if bit and value & bit
    )
    or "ok"
    for value in range(1 << len([bit for bit in Status if bit]))
}
"""Words for every combination of status bits"""
LANES = (
    Lane("contact_state", "contact", words_of(ContactState), {0: "grey", 1: "blue", 2: "sand"}),
    Lane("fidelity", "level", words_of(Fidelity), {0: "grey", 1: "yellow", 2: "violet"}),
    Lane("status", "status", STATUS, {value: "red" if value else "green" for value in STATUS}),
)


def checked(_context: click.Context, _parameter: click.Parameter, namespace: str) -> str:
    """Check the option `--namespace`."""
    if namespace and not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*/?", namespace, re.ASCII):
        raise click.BadParameter(f"{namespace!r}: it must be a name, such as left or robot/left")
    return namespace


def absolute(topic: str, namespace: str) -> str:
    """Absolute name of a topic in a namespace."""
    return f"/{namespace.strip('/')}/{topic}".replace("//", "/")


def code(colour: str) -> str:
    """Colour as `#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*COLOURS[colour])


# Foxglove.

LOGARITHMIC = ("error_estimate", "force_error_estimate")
"""Fields that are plotted as logarithms, as they are too small for the three decimals of Lichtblick's axes"""
AXES = {
    "xAxisVal": "timestamp",
    "isSynced": True,
    "showLegend": False,
    "legendDisplay": "none",
    "showPlotValuesInLegend": False,
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "sidebarDimension": 240,
}
Mosaic = Any
"""Arrangement of panels: the id of a panel, or two arrangements side by side or one above the other"""


def foxglove(namespace: str = "") -> dict[str, Any]:
    """Make the content of a layout file: a tab with plots, and one with messages and the node's diagnostics."""

    def path(topic: str, field: str) -> str:
        return f"{absolute(topic, namespace)}.{field}"

    def titled(title: str) -> dict[str, Any]:
        return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}

    def series(value: str, label: str, curve: Curve) -> dict[str, Any]:
        look = {"color": code(curve.colour), "showLine": True, "lineSize": curve.width / 2.0}
        return {
            "value": value,
            "label": label,
            "enabled": True,
            "timestampMethod": "headerStamp",
            **look,
        }

    panels: dict[str, dict[str, Any]] = {}
    for number, plot in enumerate(PLOTS):
        logarithm = plot.curves[0].field in LOGARITHMIC
        before, after = ("log10 of ", ".@log10") if logarithm else ("", "")
        lines = [
            series(
                path(plot.topic, curve.field) + after, before + plot.with_unit(curve.name), curve
            )
            for curve in reversed(plot.curves)
        ]  # the first is drawn in front
        panels[f"Plot!{number}"] = titled(before + plot.headline) | AXES | {"paths": lines}
    ids = list(panels)
    joint = Curve("position[0]", "first joint [rad]", "blue")
    joints = [series(path("joint_states", joint.field), joint.name, joint)]
    panels[f"Plot!{len(PLOTS)}"] = titled(JOINTS) | AXES | {"paths": joints}
    lanes = [
        {
            "value": path("knee_contact", lane.field),
            "label": lane.title,
            "timestampMethod": "headerStamp",
        }
        for lane in LANES
    ]
    panels["StateTransitions!states"] = titled(STATES) | {"isSynced": True, "paths": lanes}
    messages = {
        f"RawMessages!{name}": {
            "topicPath": absolute(topic, namespace),
            "diffEnabled": False,
            "diffMethod": "custom",
            "diffTopicPath": "",
        }
        for name, topic in (("answer", "knee_contact"), ("joints", "joint_states"))
    }
    messages["DiagnosticSummary!node"] = {
        "topicToRender": "/diagnostics",
        "minLevel": 0,
        "pinnedIds": [],
    }
    inputs = mosaic("column", [*ids[ON_THE_KNEE:], f"Plot!{len(PLOTS)}"])
    states_and_inputs = mosaic("column", ["StateTransitions!states", inputs], share=30.0)
    knee = mosaic("row", [mosaic("column", ids[:ON_THE_KNEE]), states_and_inputs])
    tabs = [
        {"title": "Knee", "layout": knee},
        {"title": "Messages", "layout": mosaic("row", list(messages))},
    ]
    return {
        "configById": {"Tab!knee": {"activeTabIdx": 0, "tabs": tabs}} | panels | messages,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!knee",
    }


def mosaic(direction: str, parts: Sequence[Mosaic], share: float | None = None) -> Mosaic:
    """Arrange parts in a `row` or `column`, all of the same size unless the first has a `share` [%]."""
    if len(parts) == 1:
        return parts[0]
    rest = mosaic(direction, parts[1:])
    share = share or round(100.0 / len(parts), 1)
    return {"direction": direction, "first": parts[0], "second": rest, "splitPercentage": share}


# PlotJuggler.

SHOWN = {"rad": ("deg", 180.0 / math.pi), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
"""Displayed unit and factor to it, by the unit of a field"""
SMALL = {"error_estimate": ("um", 1e6)}
"""Displayed unit and factor to it for single fields"""


def plotjuggler(namespace: str = "", version: int = 3) -> str:
    """Layout file for PlotJuggler 3, or for 4 (`.pj4.xml`), which applies to any open recording, as XML text."""
    converts = version == 3
    root = ET.Element(
        "root",
        {} if converts else {"format": "PlotJuggler", "pj4_version": "4", "binding": "generic"},
    )
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})

    def area(plot: Plot, style: str = "Lines") -> ET.Element:
        unit, factor = SMALL.get(plot.curves[0].field) or SHOWN.get(plot.unit) or (plot.unit, 1.0)
        shown, factor = (plot._replace(unit=unit), factor) if converts else (plot, 1.0)
        dock = ET.Element("DockArea", name=shown.with_unit(shown.title))
        content = ET.SubElement(dock, "plot", mode="TimeSeries", style=style, line_width="1.5")
        for each in plot.curves:
            topic = absolute(plot.topic, namespace)
            field = each.field.replace(".", "/")
            if not converts:
                ET.SubElement(content, "curve", topic=topic, field=field, color=code(each.colour))
                continue
            curve = ET.SubElement(
                content, "curve", name=f"{topic}/{field}", color=code(each.colour)
            )
            transform = ET.SubElement(
                curve, "transform", name="Scale/Offset", alias=shown.with_unit(each.name)
            )
            ET.SubElement(
                transform, "options", value_scale=repr(factor), value_offset="0", time_offset="0"
            )
        return dock

    angle, force, depth, point, *own, evaluations, error, force_error, reaction, wrench = map(
        area, PLOTS
    )
    colours = ("blue", "violet", "red")
    lanes = tuple(
        Curve(lane.field, lane.title, colour) for lane, colour in zip(LANES, colours, strict=True)
    )
    states = area(Plot("Contact, level, status", "", lanes), "Steps")
    joint = area(
        Plot("Joint position", "rad", (Curve("knee.position", "knee", "blue"),), "joint_states")
    )
    for name, *columns in (
        ("Contact", [angle, force, depth], [states, point, *own]),
        ("Load, error and cost", [joint, reaction, wrench], [error, force_error, evaluations]),
    ):
        tab = ET.SubElement(window, "Tab", containers="1", tab_name=str(name))
        ET.SubElement(tab, "Container").append(
            split("|", [split("-", list(column)) for column in columns])
        )
    ET.SubElement(window, "currentTabIndex", index="0")
    if converts:
        ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root)
    return (
        "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="unicode") + "\n"
    )


def split(orientation: str, parts: Sequence[ET.Element]) -> ET.Element:
    """Arrange parts side by side (`|`) or one above the other (`-`), all of the same size."""
    sizes = ";".join([f"{1.0 / len(parts):.4f}"] * len(parts))
    splitter = ET.Element(
        "DockSplitter", orientation=orientation, count=str(len(parts)), sizes=sizes
    )
    splitter.extend(parts)
    return splitter


def files(namespace: str = "") -> Iterator[tuple[str, str]]:
    """Names and contents of the files for a namespace."""
    name = "_".join([*namespace.strip("/").split("/"), "knee_contact"]).lstrip("_")
    yield f"foxglove/{name}.json", json.dumps(foxglove(namespace), indent=2) + "\n"
    yield f"plotjuggler/{name}.xml", plotjuggler(namespace)
    yield f"plotjuggler/{name}.pj4.xml", plotjuggler(namespace, version=4)


@click.command(help=__doc__)
@click.option("--namespace", default="", callback=checked, help="For /NAMESPACE/knee_contact.")
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="Folder for all.",
)
def main(namespace: str, output: Path) -> None:
    """Write the layouts into the folders `foxglove` and `plotjuggler` of the output folder."""
    for file, text in files(namespace):
        (output / file).parent.mkdir(parents=True, exist_ok=True)
        (output / file).write_text(text, encoding="utf-8")
        print(output / file)


if __name__ == "__main__":
    main()
