"""What parameters ask of the outputs, in SI units and bytes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.bags.recorder import ABSOLUTE_NAMES, Limits, Settings
from knee_contact_ros.node.outputs import sink_of
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.output import Knee
from knee_contact_ros.streams.topics import KNEE_CONTACT


def described(**parameters: Any) -> Knee:
    """A knee that outputs are described from."""
    read = load_parameters({name.replace("__", "."): value for name, value in parameters.items()})
    return Knee(read, {KNEE_CONTACT: ContactStream(read, compiled=False).model}, ABSOLUTE_NAMES, {"version": "1"})


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
