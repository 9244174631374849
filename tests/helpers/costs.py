"""The numbers of `tests/costs.yaml`."""

from ruamel.yaml import YAML

from tests import ROOT

COSTS = YAML(typ="safe").load(ROOT / "tests" / "costs.yaml")
