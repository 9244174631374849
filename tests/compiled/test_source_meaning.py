"""What counts as a change of what a module does."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from knee_contact_ros.compiled.source_meaning import source_meaning

SOURCE = '''
"""A module."""
SLOPE = 3.0
"""[N/m]"""

def force(depth, /, rate=0, *, damp=None):
    """Of a depth."""
    try:
        if rate in {"none", "some"}:
            return -0.0
    except ValueError:
        pass
    return SLOPE * depth
'''


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("SLOPE = 3.0", "SLOPE = 3"),
        ("-0.0", "0.0"),
        ("depth, /,", "depth,"),
        ("rate=0", "rate=False"),
        ("*, damp", "damp"),
        ('{"none", "some"}', '{"none", "more"}'),
        ("ValueError", "KeyError"),
        ("SLOPE * depth", "depth * SLOPE"),
        ("        pass", "        return 1.0"),
    ],
)
def test_what_a_module_does_is_its_meaning(one: str, other: str) -> None:
    assert SOURCE.count(one)
    assert source_meaning(SOURCE.replace(one, other).encode()) != source_meaning(SOURCE.encode())


@pytest.mark.parametrize(
    ("one", "other"),
    [("[N/m]", "[N/mm]"), ("Of a depth.", "Else."), ("SLOPE = 3.0", "# why\n\nSLOPE = (3.0)"), ("A module.", "")],
)
def test_words_are_not(one: str, other: str) -> None:
    assert SOURCE.count(one)
    assert source_meaning(SOURCE.replace(one, other).encode()) == source_meaning(SOURCE.encode())


def test_a_file_that_is_no_python_means_its_bytes() -> None:
    assert source_meaning(b"one two") != source_meaning(b"one  two")
    assert source_meaning(b"\0") != source_meaning(b"\0\0")


def test_a_meaning_is_the_same_in_every_process() -> None:
    """Although the order in a set is not."""
    code = f"from knee_contact_ros.compiled.source_meaning import source_meaning as m; print(m({SOURCE.encode()!r}))"
    found = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(found) == 1
