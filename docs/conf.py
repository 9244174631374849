"""Settings of Sphinx: `make docs` builds the site, and rosdoc2 takes the same settings.

The pages are the project's Markdown files where they lie, and are read on a code host as they are: the contents, and
the table of parameters, are added here.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import Any

from knee_contact_ros import __version__

project = "knee_contact_ros"
author = "The knee_contact_ros authors"
copyright = author  # noqa: A001  # as Sphinx calls it
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_click",
]
rosdoc2_settings = {"allow_other_extensions": True}
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = [".*", "build", "install", "log", "site", "knee_contact_ros", "scripts", "studies", "tests"]

napoleon_numpy_docstring = False
myst_heading_anchors = 4  # as code hosts give them
default_role = "py:obj"  # `name` in a docstring
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"Real": "float", "Small": "int", "Count": "int", "Nanoseconds": "int"}
python_maximum_signature_line_length = 100
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"{project} {release}"
html_extra_path = ["site/index.html"]
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sphinx = False

CONTENTS = {
    "Begin": ["docs/README", "docs/tutorial"],
    "Use": [
        "docs/installing", "docs/python", "docs/node", "docs/load", "docs/conventions", "docs/bags", "docs/recording",
        "docs/recovery", "docs/viewing", "docs/viewing-elsewhere", "docs/report", "docs/companion", "docs/security",
    ],
    "Subjects": [
        "docs/tutorial-own-subject", "docs/subjects", "docs/opensim", "docs/sensors", "docs/fit-profile",
        "docs/fit-share", "docs/uncertainty", "docs/cohorts", "docs/sensitivity", "docs/calibration", "bags/README",
    ],
    "Model": [
        "docs/model", "docs/choosing-fidelity", "docs/reproduction", "docs/osteoarthritis-study", "docs/validation",
        "docs/load-validation", "docs/assistance", "docs/studies/README",
    ],
    "API": ["docs/api/README", "docs/api/python", "docs/api/message", "docs/api/parameters", "docs/api/commands"],
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


def parameters() -> str:
    """Every parameter of both nodes with its default and limits, from where they are declared."""
    from knee_contact_ros.parameters.files import known_parameters
    from knee_contact_ros.parameters.schema import LoadParameters, Parameters

    def allowed(limits: Any) -> str:
        numbers = f"{limits.least:g} to {limits.most:g}" if isfinite(limits.least) else ""
        return "; ".join(filter(None, (numbers, limits.words)))

    tables = []
    for schema in (Parameters, LoadParameters):
        tables += [f"\n## {schema.node}\n\n| parameter | default | meaning, and what is allowed |", "|---|---|---|"]
        for name, (default, meaning, limits) in known_parameters(schema).items():
            texts = dict.fromkeys(filter(None, (meaning, allowed(limits))))
            tables.append(f"| `{name}` | `{default!r}` | {'<br>'.join(texts)} |")
    return "\n".join([*tables, ""])


ADDED: dict[str, Callable[[], str]] = {
    "README": contents,
    "docs/decisions/README": all_beside,
    "docs/studies/README": all_beside,
    "docs/api/parameters": parameters,
}


def complete(app: Any, page: str, source: list[str]) -> None:
    """Add to a page what it has on the site alone; rosdoc2 makes its own contents."""
    addition = ADDED.get(page)
    if addition and (addition is parameters or app.config.root_doc == "README"):
        source[0] += addition()


def undivided(_app: Any, what: str, _name: str, _item: Any, _options: Any, lines: list[str]) -> None:
    """A colon in an attribute's first line is one of a sentence; napoleon would take what is before it for a type."""
    if lines and what in ("attribute", "data", "property"):
        lines[0] = f": {lines[0]}"  # with no type


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", complete)
    app.connect("autodoc-process-docstring", undivided, priority=400)  # before napoleon's
