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
exclude_patterns = [
    ".*",
    "build",
    "install",
    "log",
    "site",
    "knee_contact_ros",
    "scripts",
    "studies",
    "tests",
]

myst_heading_anchors = 4  # as code hosts give them

html_theme = "furo"
html_title = f"{project} {release}"
html_extra_path = ["site/index.html"]
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sphinx = False

CONTENTS = {
    "Tutorials": [
        f"docs/tutorials/{page}"
        for page in ("first-knee", "your-robot", "your-subject", "notebook")
    ],
    "How-to": [
        f"docs/how-to/{page}"
        for page in (
            "install",
            "run-beside-a-controller",
            "security",
            "record-and-replay",
            "see-it",
            "report",
            "methods",
            "import-data",
            "surfaces-and-shares",
            "python",
            "many-knees",
            "uncertainty-and-calibration",
        )
    ],
    "Reference": [
        f"docs/reference/{page}"
        for page in (
            "README",
            "topics",
            "files",
            "parameters",
            "commands",
            "messages",
            "python",
            "faults",
            "glossary",
        )
    ],
    "Explanation": [
        f"docs/explanation/{page}"
        for page in ("numbers", "model", "load", "accuracy", "validation")
    ],
    "Project": [
        "docs/README",
        "CONTRIBUTING",
        "QUALITY_DECLARATION",
        "SECURITY",
        "docs/decisions/README",
        "docs/studies/README",
        "bags/README",
        "examples/README",
        "examples/microcontroller/README",
        "examples/ros2_control/README",
        "CHANGELOG",
    ],
}


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
