"""The page of a sensitivity analysis: one HTML file that needs no other file."""

from __future__ import annotations

import base64
from collections.abc import Sequence

from knee_contact_ros import __version__
from knee_contact_ros.tools.sensitivity import words
from knee_contact_ros.tools.sensitivity.figures import Figure
from knee_contact_ros.tools.sensitivity.gather import Combination
from knee_contact_ros.tools.sensitivity.study_file import SensitivityStudy

TEMPLATE = "sensitivity.html.jinja"
METHODS = {"sobol": "Sobol indices", "morris": "Morris screening"}


def page(study: SensitivityStudy, combinations: Sequence[Combination], figures: Sequence[Sequence[Figure]]) -> str:
    """Make the page as HTML text; `figures` are those of each outcome, in the order of the study's outcomes."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__ or "", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    design = study.design
    return environment.get_template(TEMPLATE).render(
        title=f"What matters for the knee: {METHODS[design.method]}",
        lead=lead(study, combinations),
        version=__version__,
        design=design,
        remarks=words.remarks(design, combinations),
        matters=words.what_matters(design, combinations),
        ranges=words.ranges_table(design),
        fixed=[f"{name} = {value}" for name, value in study.cases.values.items()],
        outcomes=[
            {
                "title": words.display_of(name).title,
                "figures": own,
                "places": [
                    {
                        "label": combination.label,
                        "reason": combination.analysed[place].reason,
                        "indices": words.all_indices(design, combination.analysed[place]),
                        "together": words.together(combination.analysed[place]),
                    }
                    for combination in combinations
                ],
            }
            for place, (name, own) in enumerate(zip(study.outcomes, figures, strict=True))
        ],
        combinations=combinations,
    )


def lead(study: SensitivityStudy, combinations: Sequence[Combination]) -> str:
    """Describe the analysis in a sentence, for the head of the page."""
    design, many = study.design, len(combinations)
    groups = "trajectories" if design.method == "morris" else "base samples"
    return (
        f"{len(design.names)} parameters varied together at {design.number} points ({design.n} {groups}, seed "
        f"{design.seed}), in {many} combination{'s' * (many != 1)} of gait, knee and grid: "
        f"{study.cases.number} knees computed."
    )
