"""A copy of the package, which tests may change."""

import shutil

from tests import ROOT

WITHOUT_LIBRARY = ("__pycache__", "*.so")
"""Names of files that a copy leaves out, which begins with no compiled model"""


def copy_of_the_package(folder, ignored=("__pycache__",)):
    """Return a folder with the package, for processes of its own; without its library with `WITHOUT_LIBRARY`."""
    folder.mkdir(exist_ok=True)
    package = folder / "knee_contact_ros"
    shutil.copytree(ROOT / "knee_contact_ros", package, ignore=shutil.ignore_patterns(*ignored))
    for shared in ("config", "bags"):
        (folder / shared).symlink_to(ROOT / shared)
    return package
