"""YAML of others: what is no YAML, or would take for ever, is refused in one line."""

import pytest

from knee_contact_ros.system.files import (
    MAX_FILE_SIZE,
    MAX_NODES,
    BadYamlError,
    parse_yaml,
    read_yaml,
)

DOUBLED = "\n".join(
    ["a0: &a0 {x: 1}", *(f"a{i}: &a{i} {{p: *a{i - 1}, q: *a{i - 1}}}" for i in range(1, 30))]
)
"""Thirty lines that stand for a thousand million"""

BEYOND = {
    "entries of another mapping": ("a: &a {k: v}\nb: {<<: *a}\n", "merge keys"),
    "a date that is none": ("contact: {damping: 2001-99-99}", "month must be"),
    "a mapping that holds itself": ("contact: &a {damping: *a}", "deeper than 50"),
    "aliases of aliases": (DOUBLED, f"more than {MAX_NODES} nodes"),
    "an integer without digits": ("contact: !!int ''", "index out of range"),
    "an object of Python": ("!!python/object/apply:os.system [true]", "constructor"),
}


@pytest.mark.parametrize("name", BEYOND)
def test_yaml_beyond_the_bounds_is_refused(name):
    content, words = BEYOND[name]
    with pytest.raises(BadYamlError, match=words):
        parse_yaml(str(content))


def test_a_file_is_read_to_a_limit(tmp_path):
    path = tmp_path / "long.yaml"
    path.write_text(f"a: 1\n# {'x' * MAX_FILE_SIZE}")
    with pytest.raises(OSError, match=f"longer than {MAX_FILE_SIZE} bytes"):
        read_yaml(path)
    assert read_yaml(path, MAX_FILE_SIZE + 100) == {"a": 1}


def test_aliases_are_read():
    assert parse_yaml("a: &b [1, {c: 2}]\nd: *b") == {"a": [1, {"c": 2}], "d": [1, {"c": 2}]}
    with pytest.raises(BadYamlError):
        parse_yaml("&a [*a]")
