"""The examples in the docstrings of the Python interface run, and every part of the interface has one."""

import doctest
import importlib
import inspect

import pytest

from scripts.make_reference import PYTHON
from tests import ROOT

FINDER = doctest.DocTestFinder(recurse=False)


def interface():
    """Yield functions, classes and listed methods of docs/reference/python.md, by their names in the package."""
    for entries in PYTHON.values():
        for entry in entries:
            name, _, members = entry.partition(": ")
            module, _, last = f"knee_contact_ros.{name}".rpartition(".")
            item = getattr(importlib.import_module(module), last)
            yield name, item
            for member in members.split():
                method = inspect.getattr_static(item, member, None)
                if inspect.isfunction(method):
                    yield f"{name}.{member}", method


INTERFACE = dict(interface())


@pytest.mark.parametrize("name", INTERFACE)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_example_of_a_docstring_runs(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = [test for test in FINDER.find(INTERFACE[name], name, globs={}) if test.examples]
    assert found, (
        f"{name} has no example: add one to its docstring, as `Example:` with lines of >>>"
    )
    said: list[str] = []
    for test in found:
        doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert not said, "".join(said)
