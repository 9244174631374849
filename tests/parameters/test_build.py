"""From names to models, in this process and another; surfaces and mechanisms: `tests/view/test_markers.py`."""

from __future__ import annotations

import copy
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Annotated

import numpy as np
import pytest
from pydantic import ValidationError

import knee_contact_ros
from knee_contact_ros.model.knee import BUDGET, KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw, Layer, Range
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters import schema
from knee_contact_ros.parameters.build import retuned
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import ContactParameters, with_constants_of_laws
from knee_contact_ros.system.errors import UsageError

TIME = np.arange(0.0, 0.1, 0.005)
ANGLE = 0.3 + 0.3 * np.sin(20.0 * TIME)
LOAD = 700.0 + 200.0 * np.sin(25.0 * TIME)


@pytest.mark.parametrize("law", CONTACT_LAWS)
@pytest.mark.parametrize("tibia", ["plane", "circle"])
@pytest.mark.parametrize("drive", ["force", "displacement"])
def test_every_law_works_with_both_drives(law: str, tibia: str, drive: str) -> None:
    forced = knee_contact_ros.load_model({"contact.law": law, "tibia.geometry": tibia, "fidelity.tolerance": 1e-9})
    series = forced.run(TIME, ANGLE, LOAD)
    if drive == "displacement":
        led = knee_contact_ros.load_model({"contact.law": law, "tibia.geometry": tibia, "drive": drive})
        followed = led.run(TIME, ANGLE, LOAD, series.femoral_height)
        # Rounding of heights of 34 mm
        assert followed.penetration_depth == pytest.approx(series.penetration_depth, abs=1e-16)
        for contact in followed:
            layer = [layer for layer in led.law.layers if layer.begin < contact.penetration_depth][-1]
            # Pressed from the start, which counts as no impact
            force = layer.force_at(contact.penetration_depth, contact.penetration_rate, 0.0)[0]
            # The very numbers that were published go into the very formula.
            assert contact.contact_force == max(force, 0.0)
        series = followed
    for field in ("contact_force", "penetration_depth", "penetration_rate", "femoral_height", "error_estimate"):
        assert np.isfinite(series[field]).all(), field
    assert np.all(series.contact_force >= 0.0)


def test_stiffness_from_the_material_is_hertz() -> None:
    names = {"contact.stiffness_from": "material", "contact.law": "two_layer_elastic", "contact.layer_depth": 0.01}
    law = knee_contact_ros.load_model(names).law
    cartilage, bone = 136.08 * 10**4.5, 98_408 * 10**4.5  # N/mm^1.5 by hand from E, nu, 34 mm and 95 mm
    # The numbers by hand have 5 digits.
    assert law.static_force(1e-3) == pytest.approx(cartilage * 1e-3**1.5, rel=1e-4)
    beyond = law.static_force(0.01) + bone * 1e-3**1.5
    assert law.static_force(0.011) == pytest.approx(beyond, rel=1e-4)


def test_numbers_reach_the_model_when_it_is_made_and_when_they_change() -> None:
    model = knee_contact_ros.load_model({"fidelity.force_tolerance": 2.5})
    assert (model.force_tolerance, model.knee.force_tolerance) == (2.5, 2.5)
    assert (model.knee.level, model.knee.budget, model.knee.allow_tension) == (LEVELS["dynamic"], BUDGET, False)
    fresh = knee_contact_ros.load_model({}).knee
    assert fresh.force_tolerance == 0.0
    changes = {
        "fidelity.force_tolerance": 0.1, "fidelity.tolerance": 1e-8, "fidelity.budget": 300, "femur.mass": 8.0,
        "fidelity.level": "quasi_static", "contact.allow_tension": True, "contact.stiffness": 5e7,
    }  # fmt: skip
    changed, made = retuned(model, load_parameters(changes)), knee_contact_ros.load_model(changes)
    assert changed.pair is model.pair
    for name in ("mass", "tolerance", "force_tolerance", "budget", "level", "allow_tension"):
        assert getattr(changed.knee, name) == getattr(made.knee, name) != getattr(fresh, name), name
    assert changed.law == made.law
    assert changed.patch == made.patch


def test_a_level_of_earlier_versions_is_dynamic_and_one_line_says_so(caplog: pytest.LogCaptureFixture) -> None:
    schema._instead_of_first_order.cache_clear()
    for _ in range(2):
        parameters = load_parameters({"fidelity.level": "first_order"})
    assert parameters.fidelity.level == "dynamic"
    (record,) = caplog.records
    assert record.getMessage() == (
        "fidelity.level: first_order no longer exists; dynamic is used instead, which is faster and more accurate"
    )


def test_a_law_of_ones_own_that_breaks_the_contract_is_refused_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    made = ContactLaw((Layer(stiffness=1e7), Layer(0.0, 0.0, 1e8)))
    monkeypatch.setitem(CONTACT_LAWS, "hertz", lambda *, stiffness, exponent: made)
    with pytest.raises(
        UsageError,
        match=r"parameter contact\.law: hertz: contact law: the first layer must begin at "
        "0 m and",
    ):
        knee_contact_ros.load_model({"contact.law": "hertz"})


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


def bits(knee: KneeModel) -> bytes:
    time = 0.002 * np.arange(6)
    return knee.run(time, 0.1 + time, 600.0 + 4e3 * time).tobytes()


@pytest.mark.parametrize("compiled", [None, False])
def test_a_loaded_model_works_in_another_process(compiled: bool | None) -> None:
    knee = knee_contact_ros.load_model(["osteoarthritis", "mri_femur"], compiled=compiled)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(bits, knee).result(120.0) == bits(knee)
    assert isinstance(copy.deepcopy(knee).run([0.0], [0.1], [700.0]), knee_contact_ros.Results)
