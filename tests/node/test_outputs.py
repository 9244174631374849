"""What parameters ask of the outputs, in SI units and bytes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.bags.recorder import ABSOLUTE_NAMES, Limits, Settings
from knee_contact_ros.node.outputs import sections_of_outputs, sink_of
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.output import Knee
from knee_contact_ros.streams.topics import KNEE_CONTACT
from tests.helpers.needs import needs_viewer


def described(**parameters: Any) -> Knee:
    """A knee that outputs are described from."""
    read = load_parameters({name.replace("__", "."): value for name, value in parameters.items()})
    return Knee(read, {KNEE_CONTACT: ContactStream(read, compiled=False).model}, ABSOLUTE_NAMES, {"version": "1"})


def test_every_output_is_described_by_the_module_that_its_section_names() -> None:
    assert sections_of_outputs(Parameters) == ["record", "rerun"]
    assert [sink_of(section, described()) for section in sections_of_outputs(Parameters)] == [None, None]


OFF = dict.fromkeys(("sync_period", "max_size", "max_duration", "min_free"), 0.0)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"flush_period": 0.5, "sync_period": 2.0, "max_size": 1.5, "max_duration": 3.0, "min_free": 7.0},
         Settings(0.5, Limits(1_500_000, 3_000_000_000), 7_000_000, 2.0)),
        ({"flush_period": 0.5} | OFF, Settings(0.5, Limits(math.inf, math.inf), 0.0, 0.0)),
    ],
)  # fmt: skip
def test_megabytes_and_seconds_become_bytes_and_nanoseconds(
    tmp_path: Path, asked: dict[str, float], expected: Settings
) -> None:
    """What is 0 is off: without a limit."""
    path = str(tmp_path / "out.mcap")
    sink = sink_of("record", described(record__path=path, **{f"record__{key}": value for key, value in asked.items()}))
    assert sink
    assert sink.name == path
    assert sink.arguments[1:4] == ({"version": "1"}, ABSOLUTE_NAMES, expected)


@needs_viewer
def test_a_scene_is_a_file_or_served(tmp_path: Path) -> None:
    to_file = sink_of("rerun", described(rerun__mode="file", rerun__path=str(tmp_path / "knee.rrd")))
    served = sink_of("rerun", described(rerun__mode="serve", rerun__port=9999))
    assert to_file
    assert served
    assert (to_file.kind, to_file.name) == ("Rerun recording", str(tmp_path / "knee.rrd"))
    assert (served.kind, served.name) == ("Rerun scene on port 9999", "")
    assert to_file.niceness > 0
