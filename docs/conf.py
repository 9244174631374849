"""Settings of Sphinx: `make docs` builds the site, and rosdoc2 takes the same settings.

The pages are the project's Markdown files where they lie, and are read on a code host as they are: the contents are
added here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from knee_contact_ros import __version__

project = "knee_contact_ros"
author = "The knee_contact_ros authors"
copyright = author  # noqa: A001  # as Sphinx calls it
release = version = __version__

extensions = ["myst_parser"]
rosdoc2_settings = {"allow_other_extensions": True}
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = [".*", "build", "install", "log", "site", "knee_contact_ros", "scripts", "studies", "tests"]

myst_heading_anchors = 4  # as code hosts give them

html_theme = "furo"
html_title = f"{project} {release}"
html_extra_path = ["site/index.html"]
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sphinx = False

CONTENTS = {
    "Begin": ["docs/README", "docs/tutorial", "docs/robot"],
    "Use": [
        "docs/installing", "docs/python", "docs/node", "docs/load", "docs/conventions", "docs/bags", "docs/recording",
        "docs/recovery", "docs/viewing", "docs/viewing-elsewhere", "docs/report", "docs/companion", "docs/security",
    ],
    "Subjects": [
        "docs/tutorial-own-subject", "docs/subjects", "docs/files", "docs/opensim", "docs/sensors",
        "docs/fit-profile", "docs/fit-share", "docs/uncertainty", "docs/cohorts", "docs/sensitivity",
        "docs/calibration", "bags/README",
    ],
    "Model": [
        "docs/model", "docs/choosing-fidelity", "docs/reproduction", "docs/osteoarthritis-study", "docs/validation",
        "docs/assistance", "docs/studies/README",
    ],
    "Reference": [
        "docs/reference/README", "docs/reference/parameters", "docs/reference/commands", "docs/reference/messages",
        "docs/reference/python", "docs/reference/glossary",
    ],
    "Project": ["CONTRIBUTING", "docs/from-source", "QUALITY_DECLARATION", "docs/decisions/README", "CHANGELOG"],
}  # fmt: skip


def contents() -> str:
    """What the site shows at its side."""
    return "".join(
        "\n".join(["\n```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```", ""])
        for caption, pages in CONTENTS.items()
    )


def all_beside() -> str:
    """The pages of a folder."""
    return "\n```{toctree}\n:glob:\n:maxdepth: 1\n\n*\n```\n"


ADDED: dict[str, Callable[[], str]] = {
    "README": contents,
    "docs/decisions/README": all_beside,
    "docs/studies/README": all_beside,
}


def complete(app: Any, page: str, source: list[str]) -> None:
    """Add to a page what it has on the site alone; rosdoc2 makes its own contents."""
    addition = ADDED.get(page)
    if addition and app.config.root_doc == "README":
        source[0] += addition()


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", complete)
