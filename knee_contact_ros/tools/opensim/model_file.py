"""Read OpenSim's XML documents, and mass and range of a coordinate from model files (.osim, of any version)."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.system.errors import UsageError

NOTHING = {"", "Unassigned", "unassigned"}
"""Texts of properties that are not set"""


class ModelFacts(NamedTuple):
    """Mass and range of a coordinate of a model."""

    mass: float
    """Mass of all bodies [kg]"""
    bounds: tuple[float, float] | None
    """Range of the coordinate [rad]; None: it has none"""


def read_xml(path: Path, root: str | None = None) -> ET.Element:
    """Root of an OpenSim document, which must have a child `root` if that is given.

    Raises:
        UsageError: the file cannot be read, or is no such document.
    """
    try:
        document = ET.parse(path).getroot()  # noqa: S314  (a user's own file; expat bounds what entities grow to)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except ET.ParseError as error:
        raise UsageError(f"{path} is no OpenSim document: {error}") from None
    if root is not None and document.find(root) is None:
        raise UsageError(f"{path} is no OpenSim {root.lower()} file")
    return document


def text_in(element: ET.Element, tag: str) -> str:
    """Text of a property of an element without blanks around it; empty if it is not there."""
    return (element.findtext(tag) or "").strip()


def read_model(path: Path, coordinate: str | None) -> ModelFacts:
    """Read the mass of a model, and the range of a coordinate.

    Raises:
        UsageError: the file is no model, or has no such coordinate.
    """
    root = read_xml(path, "Model")
    mass = sum(float(body.findtext("mass", "0")) for body in root.iter("Body"))
    found = next((c for c in root.iter("Coordinate") if c.get("name") == coordinate), None)
    if found is None:
        raise UsageError(f"{path} (--model) has no coordinate {coordinate}; is it the model of these results?")
    numbers = [float(number) for number in found.findtext("range", "").split()]
    return ModelFacts(mass, (numbers[0], numbers[1]) if len(numbers) == 2 else None)
