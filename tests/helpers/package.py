"""A copy of the package, which tests may change."""

import shutil

from tests import ROOT


def copy_of_the_package(folder):
    """Return a folder with the package and its library, for processes of its own."""
    folder.mkdir(exist_ok=True)
    package = folder / "knee_contact_ros"
    shutil.copytree(
        ROOT / "knee_contact_ros", package, ignore=shutil.ignore_patterns("__pycache__", "*.so")
    )
    for shared in ("config", "bags"):
        (folder / shared).symlink_to(ROOT / shared)
    return package
