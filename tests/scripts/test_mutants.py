"""The faults of `scripts.mutants` can be put into the package as it is, and the tests that should find them exist."""

import pytest

from scripts import mutants
from scripts.mutants import MUTANTS, Mutant, mutated, outcome_of
from tests import ROOT


@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.name for mutant in MUTANTS])
def test_a_fault_replaces_code_that_is_there(mutant):
    source = (ROOT / "knee_contact_ros" / mutant.file).read_text("utf-8")
    compile(mutated(mutant, source), mutant.file, "exec")
    assert all((ROOT / "tests" / one).exists() for one in mutant.tests.split())


def test_code_that_is_gone_is_named():
    with pytest.raises(ValueError, match=r"a fault: model/laws\.py has 'no such code' 0 times"):
        mutated(Mutant("a fault", "model/laws.py", "no such code", "", "model"), "some code")


@pytest.mark.parametrize(
    ("test", "found", "said"),
    [
        ("assert x.ONE == 1", True, "FAILED tests/test_x.py::test_it[a b]"),
        ("assert x.ONE == 3", False, "without the fault, too, FAILED"),
        ("while x.ONE == 2: pass", False, "no end after 3 s"),
    ],
)
def test_a_fault_is_found_by_a_test_that_passes_without_it(
    test, found, said, tmp_path, monkeypatch
):
    monkeypatch.setattr(mutants, "TIME_LIMIT", 60.0 if "while" not in test else 3.0)
    for name, text in (
        ("knee_contact_ros/x.py", "ONE = 1"),
        (
            "tests/test_x.py",
            "import pytest\nfrom knee_contact_ros import x\n"
            f"@pytest.mark.parametrize('_', ['a b'])\ndef test_it(_):\n    {test}\n",
        ),
    ):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text, encoding="utf-8")
    outcome = outcome_of(Mutant("it is 2", "x.py", "1", "2", "test_x.py"), tmp_path)
    assert (outcome.found, outcome.said.startswith(said)) == (found, True), outcome.said
