"""Patch, pressure, strain and loading rate against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros import load_model
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.types import ContactState, Status, blank_answers
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import load_parameters

TOLERANCE = 1e-12
"""Relative: a dozen roundings of 1.1e-16 each, of powers to 1.5"""
MODULUS, POISSON, FEMUR, TIBIA, THICKNESS = 24e6, 0.38, 0.034, 0.095, 4.4e-3
RADIUS = 1.0 / (1.0 / FEMUR - 1.0 / TIBIA)
MATERIAL = {
    "contact.youngs_modulus": MODULUS,
    "contact.poissons_ratio": POISSON,
    "contact.femoral_radius": FEMUR,
    "contact.tibial_radius": TIBIA,
    "contact.foundation_thickness": THICKNESS,
}


def knee(**values):
    return build_model(
        load_parameters({name.replace("__", "."): value for name, value in values.items()})
    )


def at_rest(model, loads):
    """Contacts under constant loads, a run for each."""
    return np.concatenate([model.run([0.0], [0.3], [load]) for load in loads])


@given(load=st.floats(1.0, 5000.0))
def test_hertz_pressure_is_that_of_the_textbook(load):
    model = knee(contact__law="hertz", contact__stiffness_from="material", **MATERIAL)
    (read,) = model.readouts(at_rest(model, [load]))
    plane = MODULUS / (2.0 * (1.0 - POISSON**2))  # E*
    force = float(model.run([0.0], [0.3], [load]).contact_force[0])
    # Johnson 1985, Eqs. 4.22 and 4.24: from the force alone, without the depth
    assert read["half_width"] == pytest.approx(
        (3.0 * force * RADIUS / (4.0 * plane)) ** (1.0 / 3.0), rel=1e-6
    )
    peak = (6.0 * force * plane**2 / (math.pi**3 * RADIUS**2)) ** (1.0 / 3.0)
    assert read["peak_pressure"] == pytest.approx(
        peak, rel=1e-6
    )  # the depth's tolerance of 1e-6 m is not needed: rest
    assert read["mean_pressure"] == pytest.approx(peak / 1.5, rel=1e-6)


@given(load=st.floats(1.0, 5000.0))
def test_foundation_pressure_is_that_of_its_springs(load):
    model = knee(contact__law="elastic_foundation", **MATERIAL)
    rows = at_rest(model, [load])
    (read,) = model.readouts(rows)
    modulus = MODULUS * (1.0 - POISSON) / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
    depth = float(rows["penetration_depth"][0])
    assert read["half_width"] == pytest.approx(math.sqrt(2.0 * RADIUS * depth), rel=TOLERANCE)
    assert read["peak_pressure"] == pytest.approx(modulus * depth / THICKNESS, rel=TOLERANCE)
    assert read["strain"] == pytest.approx(depth / THICKNESS, rel=TOLERANCE)
    # the pressures of all springs, added up over the patch, carry the load
    radii = np.linspace(0.0, float(read["half_width"]), 20_001)
    pressures = modulus / THICKNESS * (depth - radii**2 / (2.0 * RADIUS))
    carried = float(np.trapezoid(2.0 * math.pi * radii * pressures, radii))
    assert carried == pytest.approx(
        float(rows["contact_force"][0]), rel=1e-6
    )  # trapezoids: 1/n² is 2.5e-9, times 4


@pytest.mark.parametrize("law", CONTACT_LAWS)
def test_every_law_carries_its_force_at_rest_on_the_patch(law):
    model = knee(contact__law=law)
    rows = at_rest(model, [0.0, 1.0, 300.0, 1500.0, 3000.0])
    read = model.readouts(rows)
    area = math.pi * read["half_width"] ** 2
    forces = [model.law.static_force(depth) for depth in rows["penetration_depth"].tolist()]
    assert area * read["mean_pressure"] == pytest.approx(forces, rel=TOLERANCE)
    assert (read["peak_pressure"] >= read["mean_pressure"]).all()
    assert (np.diff(read["half_width"]) > 0.0).all()


def test_strain_of_two_layers_is_1_where_the_first_is_pressed_flat():
    model = knee(contact__law="two_layer_elastic", contact__layer_depth=5e-4)
    rows = at_rest(model, [20.0, 3000.0])
    assert rows["contact_state"].tolist() == [ContactState.CARTILAGE, ContactState.BONE]
    thin, flat = model.readouts(rows)["strain"].tolist()
    assert 0.0 < thin < 1.0
    assert flat == pytest.approx(1.0, rel=TOLERANCE)


def test_loading_rate_is_the_slope_of_the_contact_force():
    model = knee(contact__law="hertz")
    rows = blank_answers(5)
    rows["stamp"] = [0, 10_000_000, 30_000_000, 40_000_000, 30_000_000]
    rows["contact_force"] = [100.0, 110.0, 100.0, 130.0, 0.0]
    rows["status"][3] = Status.TIME_RESET
    rates = model.readouts(rows)["loading_rate"].tolist()
    assert rates[1:3] == pytest.approx([1000.0, -500.0], rel=TOLERANCE)
    assert np.isnan([rates[0], rates[3], rates[4]]).all()


def test_radii_of_no_knee_give_no_readouts():
    model = knee(contact__law="kelvin_voigt", contact__femoral_radius=0.1)
    with pytest.raises(
        ValueError, match=r"contact\.femoral_radius must be below contact\.tibial_radius"
    ):
        model.readouts(blank_answers(1))


@pytest.mark.parametrize("knee", ["healthy", "osteoarthritis", "mri_knee"])
@pytest.mark.parametrize("deviation", [20.0, 100.0])
def test_an_uncertain_load_is_carried_on_to_force_and_depth(knee, deviation):
    """Against the model under the load, and a standard deviation more and less; a bound where little presses."""
    model = load_model([knee, {"fidelity.level": "quasi_static"}], compiled=False)
    load = np.concatenate(
        (np.linspace(4.0 * deviation, 2000.0, 40), np.linspace(-50.0, deviation, 10))
    )
    time, angle = 0.01 * np.arange(50), np.full(50, 0.2)
    below, middle, above = (
        model.run(time, angle, load + off) for off in (-deviation, 0.0, deviation)
    )
    found = model.uncertainty(middle, deviation)
    for name in ("contact_force", "penetration_depth"):
        expected = 0.5 * (above[name] - below[name])
        jumps = (
            below.contact_state != above.contact_state
        )  # from layer to layer the stiffness changes
        seen = (load >= 4.0 * deviation) & ~jumps
        np.testing.assert_allclose(
            found[name][seen], expected[seen], rtol=0.06
        )  # 5 % beside a jump, 2 % elsewhere
        assert (found[name][40:] > 0.97 * (above[name] - middle[name])[40:]).all()
    stream = model.stream()
    ticks = [stream.tick(*row) for row in zip(time[:3], angle[:3], load[:3], strict=True)]
    one_by_one = model.uncertainty(np.array(ticks), np.array([deviation, np.nan, 0.0]))
    assert one_by_one.penetration_depth[0] == found.penetration_depth[0]
    assert np.isnan(one_by_one.contact_force[1])
    assert np.isnan(one_by_one.penetration_depth[1])
    assert one_by_one.penetration_depth[2] == 0.0
    with pytest.raises(ValueError, match=r"load_deviation must not be negative, got -1\.0"):
        model.uncertainty(middle, -1.0)
