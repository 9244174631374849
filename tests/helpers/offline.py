"""Bags that are given by their paths, opened and computed."""

from pathlib import Path

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.offline import estimate_load as estimate_module
from knee_contact_ros.offline import solve as solve_module
from knee_contact_ros.parameters.files import load_parameters


def solve(bag, basis, *arguments, **options):
    """Open a bag and solve it with parameters, or what they are loaded from, or a provenance."""
    if isinstance(basis, str | Path | list | dict):
        basis = load_parameters(basis)
    with Bag(bag) as opened:
        return solve_module.solve(opened, basis, *arguments, **options)


def estimate_load(bag, *arguments, **options):
    """Open a bag and estimate its loads."""
    with Bag(bag) as opened:
        return estimate_module.estimate_load(opened, *arguments, **options)
