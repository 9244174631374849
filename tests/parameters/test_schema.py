"""Parameters that contact laws bring along."""

from __future__ import annotations

from typing import Annotated

import pytest
from pydantic import ValidationError

from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw, Range
from knee_contact_ros.parameters.schema import ContactParameters, with_constants_of_laws


def law_with_an_edge(*, stiffness: float, edge: Annotated[float, Range(0.0, 1.0, "[m] of it")] = 0.25) -> ContactLaw:
    """A law with a constant of its own."""
    return CONTACT_LAWS["hertz"](stiffness=stiffness, exponent=1.0 + edge)


def test_what_a_law_alone_asks_for_is_a_parameter() -> None:
    section = with_constants_of_laws({**CONTACT_LAWS, "edged": law_with_an_edge})
    assert set(section.model_fields) == {*ContactParameters.model_fields, "edge"}
    assert section.model_fields["edge"].description == "[m] of it"
    assert section().model_dump() == {**ContactParameters().model_dump(), "edge": 0.25}
    assert section(edge=1.0).model_dump()["edge"] == 1.0
    for bad in (-0.1, 1.1, "0.5", float("nan")):
        with pytest.raises(ValidationError, match="edge"):
            section(edge=bad)
