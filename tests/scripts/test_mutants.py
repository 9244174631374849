"""The faults of `scripts.mutants` can be put into the package as it is, and the tests that should find them exist."""

import pytest

from scripts.mutants import MUTANTS, Mutant, mutated
from tests import ROOT


@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.name for mutant in MUTANTS])
def test_a_fault_replaces_code_that_is_there(mutant):
    source = (ROOT / "knee_contact_ros" / mutant.file).read_text("utf-8")
    compile(mutated(mutant, source), mutant.file, "exec")
    assert all((ROOT / "tests" / one).exists() for one in mutant.tests.split())


def test_code_that_is_gone_is_named():
    with pytest.raises(ValueError, match=r"a fault: model/laws\.py has 'no such code' 0 times"):
        mutated(Mutant("a fault", "model/laws.py", "no such code", "", "model"), "some code")
