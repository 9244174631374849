"""YAML of others: what is no YAML, or would take for ever, is refused in one line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from knee_contact_ros.bags.reader import read_metadata
from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import LARGEST, LARGEST_METADATA, MOST_NODES, BadYamlError, parse_yaml, read_yaml

DOUBLED = "\n".join(["a0: &a0 {x: 1}", *(f"a{i}: &a{i} {{p: *a{i - 1}, q: *a{i - 1}}}" for i in range(1, 30))])
"""Thirty lines that stand for a thousand million"""
BAD = {
    "an integer of 5000 digits": (f"contact: {{damping: {'9' * 5000}}}", "contact.damping: '9{79}"),
    "a hexadecimal number of 20000 bits": (f"contact: {{damping: 0x{'f' * 5000}}}", "'0xf{77}"),
    "brackets in brackets": ("[" * 20_000, "deeper than 50"),
    "lists in lists": ("- " * 20_000, "deeper than 50"),
    "a zero byte": ("contact: \0", "special characters"),
    "another encoding": ("contact: é".encode("latin-1"), "utf-8"),
    "escape codes": ("\x1b]0;mine\x07: 1", "special characters"),
    "escape codes, escaped": (r'"\e]0;mine\a": 1', r"unknown parameter \\x1b\]0;mine\\x07"),
    "half a character, escaped": (r'frame: "\ud800"', "half a character"),
    "a long name": (f"{'a' * 1000}: 1", r"unknown parameter a{80}\.\.\.;"),
    "a long value": (f"contact: {{law: {'a' * 5000}}}", r"'a{79}\.\.\. is not allowed"),
}  # fmt: skip

BEYOND = {
    "entries of another mapping": ("a: &a {k: v}\nb: {<<: *a}\n", "merge keys"),
    "a date that is none": ("contact: {damping: 2001-99-99}", "month must be"),
    "a mapping that holds itself": ("contact: &a {damping: *a}", "deeper than 50"),
    "aliases of aliases": (DOUBLED, f"more than {MOST_NODES} nodes"),
    "an integer without digits": ("contact: !!int ''", "index out of range"),
    "an object of Python": ("!!python/object/apply:os.system [true]", "constructor"),
}


@pytest.mark.parametrize("name", BEYOND)
def test_what_is_beyond_the_bounds_is_refused(name: str) -> None:
    content, words = BEYOND[name]
    with pytest.raises(BadYamlError, match=words):
        parse_yaml(str(content))


@pytest.mark.parametrize("name", BAD)
def test_bad_parameter_files_are_refused_in_one_line(
    name: str, tmp_path: Path, right_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, words = BAD[name]
    path = tmp_path / "mine.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["solve", str(right_bag), "--params", str(path), "--output", str(tmp_path / "out.mcap")]) == 2
    told = capsys.readouterr().err
    assert told.endswith("\n")
    assert told[:-1].isprintable()
    assert len(told) < 2000
    assert re.search(words, told)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, tmp_path / "a\0b"):
        with pytest.raises(OSError, match=r"regular file|directory|this name"):
            read_yaml(path)


def test_a_file_is_read_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    path.write_text(f"a: 1\n# {'x' * LARGEST}")
    with pytest.raises(OSError, match=f"longer than {LARGEST} bytes"):
        read_yaml(path)
    assert read_yaml(path, LARGEST + 100) == {"a": 1}


def test_metadata_are_read_to_a_longer_one(right_bag: Path, tmp_path: Path) -> None:
    text = (right_bag / "metadata.yaml").read_text(encoding="utf-8")
    for size, faults in ((LARGEST_METADATA, []), (LARGEST_METADATA + 1, ["metadata.yaml cannot be read"])):
        (tmp_path / "metadata.yaml").write_text(text.ljust(size, "#"), encoding="utf-8")
        assert read_metadata(tmp_path)[2] == faults


def test_aliases_are_read() -> None:
    assert parse_yaml("a: &b [1, {c: 2}]\nd: *b") == {"a": [1, {"c": 2}], "d": [1, {"c": 2}]}
    with pytest.raises(BadYamlError):
        parse_yaml("&a [*a]")
