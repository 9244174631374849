"""One version, wherever it stands."""

import pytest
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package

from knee_contact_ros import __version__
from tests import ROOT


def test_package_xml_pyproject_and_citation_have_the_version_of_the_module():
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == __version__
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert parse_package(ROOT / "package.xml").version == __version__


def test_the_changelog_is_one_for_ros_and_begins_with_the_version():
    changelog = get_changelog_from_path(ROOT / "CHANGELOG.rst", "knee_contact_ros")
    versions = [version for version, _, _ in changelog.foreach_version(reverse=True)]
    assert versions[0] == __version__
    assert all(changelog.get_content_of_version(version) for version in versions)
