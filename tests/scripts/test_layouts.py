"""The layouts for Foxglove and PlotJuggler: every path is a number in a recording of ours, and nothing hangs loose.

The real applications are not here; `docs/decisions/scene-report-viewers.md` says what was tried with them by hand.
"""

import json
import re
import xml.etree.ElementTree as ET

import pytest
from mcap.reader import make_reader

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.model.types import UNUSABLE, ContactState, Fidelity, Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES, RECORDED, types_of
from scripts.make_layouts import LANES, PLOTS, files
from tests.helpers.offline import solve

MADE = dict(files())
SERIES = sum(len(plot.curves) for plot in PLOTS) + len(LANES) + 1
"""With one for the joint"""


@pytest.fixture(scope="module")
def recording(right_bag, tmp_path_factory):
    """Gait, solved."""
    path = tmp_path_factory.mktemp("layouts") / "gait.mcap"
    solve(right_bag, load_parameters(["healthy"]), path)
    return path


@pytest.fixture(scope="module")
def messages(recording):
    """A message of each topic that is plotted."""
    types = types_of(RECORDED)
    return {message.topic: message.message for message in read_bag(recording, types)}


def is_number(message, field):
    """Whether a field with dots in its name is one; `position[0]` is an element of a sequence."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", field):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return isinstance(message, int | float)


@pytest.mark.parametrize("name", MADE)
def test_the_shipped_layouts_are_what_the_script_makes(config, name):
    assert (config / name).read_text() == MADE[name], (
        "make it again: python -m scripts.make_layouts"
    )


def test_foxglove_every_path_is_a_number_of_the_recording(messages):
    text = MADE["foxglove/knee_contact.json"]
    panels = json.loads(text)["configById"]
    assert {text.count(f'"{panel}"') for panel in panels} == {2}  # its settings, and its place
    raw = [panel["topicPath"] for name, panel in panels.items() if name.startswith("RawMessages!")]
    assert set(raw) <= set(messages)
    series = [series for panel in panels.values() for series in panel.get("paths", [])]
    assert len(series) == SERIES
    for value in (item["value"] for item in series):
        topic, _, field = value.removesuffix(".@log10").partition(".")
        assert is_number(messages[topic], field), value


def test_a_recording_names_the_states_as_foxglove_reads_them(recording):
    """A field's values have the names of the constants of its type that stand right before it."""
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    (definition,) = (
        each.data.decode()
        for each in summary.schemas.values()
        if each.name == MESSAGE_TYPES[KNEE_CONTACT]
    )
    named: dict[str, dict[int, str]] = {}
    constants: dict[int, str] = {}
    for line in definition.partition("=" * 80)[0].splitlines():
        if constant := re.match(r"uint8 (\w+)=(\d+)", line):
            constants[int(constant[2])] = constant[1]
        elif field := re.match(r"uint8 (\w+)", line):
            named[field[1]], constants = constants, {}
    assert named == {
        "contact_state": {state.value: state.name for state in ContactState},
        "fidelity": {level.value: level.name for level in Fidelity},
        "status": {0: "OK"}
        | {bit.value: bit.name for bit in Status}
        | {UNUSABLE.value: "UNUSABLE"},
    }
    assert "# [m] >= 0; 0 when apart" in definition  # and the units


def test_plotjuggler_every_curve_is_a_number_of_the_recording(messages):
    old, new = (
        ET.fromstring(MADE[f"plotjuggler/knee_contact.{kind}"])  # noqa: S314
        for kind in ("xml", "pj4.xml")
    )
    curves = [curve.attrib["name"] for curve in old.iter("curve")]
    assert len(curves) == SERIES
    assert [
        f"{curve.attrib['topic']}/{curve.attrib['field']}" for curve in new.iter("curve")
    ] == curves
    for curve in curves:
        topic = max((topic for topic in messages if curve.startswith(f"{topic}/")), key=len)
        field = curve.removeprefix(f"{topic}/").replace("/", ".")
        assert (
            field == "knee.position"
            if topic == "/joint_states"
            else is_number(messages[topic], field)
        )
