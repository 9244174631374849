"""The pages as a site: every link and anchor is right, and all of it works without a network."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.helpers.browser import requested

for module in ("sphinx", "myst_parser", "furo"):
    pytest.importorskip(
        module, reason="the site's generator is not installed (dependency group docs)"
    )

pytestmark = pytest.mark.xdist_group("site")  # one process, so that it is built once

NOT_OURS = ("build", "install", "log", "site")
PATH_OF_A_TEST = re.compile(r"`(tests/[\w/.]+)`")
FRONT = "README.html"


def build(source, site):
    """As `make docs` does."""
    options = [
        "--quiet",
        "--fail-on-warning",
        "--keep-going",
        "-c",
        ROOT / "docs",
        "-D",
        "root_doc=README",
    ]
    command = [
        sys.executable,
        "-m",
        "sphinx",
        *options,
        "-d",
        site.parent / "doctrees",
        source,
        site,
    ]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """All of it, from this tree."""
    folder = tmp_path_factory.mktemp("site") / "site"
    told = build(ROOT, folder)
    assert told.returncode == 0, told.stderr
    return folder


def test_every_page_is_on_it(site):
    pages = {page.relative_to(ROOT) for kind in ("*.md", "*.rst") for page in ROOT.rglob(kind)}
    ours = {page for page in pages if not page.parts[0].startswith((".", *NOT_OURS))}
    assert Path("README.md") in ours
    assert {page for page in ours if not (site / page.with_suffix(".html")).is_file()} == set()


@pytest.mark.parametrize(
    "page",
    [
        FRONT,
        "docs/how-to/see-it.html",
        "docs/reference/python.html",
        "docs/reference/commands.html",
    ],
)
def test_a_browser_asks_no_network_for_it(browser, site, page):
    browser.get_log("browser"), browser.get_log("performance")  # those of before
    browser.get((site / page).as_uri())
    assert browser.get_log("browser") == []
    asked = requested(browser)
    assert len(asked) > 3  # the page, its styles and scripts
    assert {address for address in asked if not address.startswith(site.as_uri())} == set()
    pictures = browser.execute_script("return [...document.images].map(i => i.naturalWidth)")
    assert all(width > 0 for width in pictures)


def test_a_broken_anchor_is_told(tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    (source / "README.md").write_text("# Front\n\n[a link](#nowhere)\n", encoding="utf-8")
    done = build(source, tmp_path / "site")
    assert done.returncode != 0
    assert "nowhere" in done.stderr


def test_the_quality_declaration_names_tests_that_are_there():
    named = PATH_OF_A_TEST.findall((ROOT / "QUALITY_DECLARATION.md").read_text(encoding="utf-8"))
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).exists()] == []
