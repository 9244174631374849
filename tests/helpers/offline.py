"""Bags that are given by their paths, opened and computed."""

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.offline import estimate_load as estimate_module
from knee_contact_ros.offline import solve as solve_module


def solve(bag, *arguments, **options):
    """Open a bag and solve it."""
    with Bag(bag) as opened:
        return solve_module.solve(opened, *arguments, **options)


def estimate_load(bag, *arguments, **options):
    """Open a bag and estimate its loads."""
    with Bag(bag) as opened:
        return estimate_module.estimate_load(opened, *arguments, **options)
