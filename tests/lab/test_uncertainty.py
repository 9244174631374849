"""Standard deviations as they are given, a recording that is answered again, and intervals against closed forms."""

import math
import re

import numpy as np
import pytest

from knee_contact_ros import UsageError, uncertainty
from knee_contact_ros.bags.provenance import Change, read_provenance
from knee_contact_ros.lab.uncertainty import (
    Deviation,
    coverage_factor,
    deviations_of,
    read_uncertain_gait,
)
from knee_contact_ros.parameters.files import load_parameters
from tests.helpers.bags import raw_messages, write_rosbag2
from tests.helpers.offline import solve
from tests.offline.test_solve import make_bag

HEALTHY = {}
DISPLACED = {"drive": "displacement"}
LOAD, STIFFNESS, EXPONENT = 1000.0, 7.905694e7, 1.5
AT_REST = {
    "contact.law": "hertz",
    "fidelity.level": "quasi_static",
    "contact.stiffness": STIFFNESS,
}
DEPTH = (0.5 * LOAD / STIFFNESS) ** (1.0 / EXPONENT)
"""[m] of half the load, at rest"""
SHORT = 60
"""Ticks: plain Python computes them"""


def test_numbers_and_percents(tmp_path):
    path = tmp_path / "sd.yaml"
    path.write_text(
        "flexion_angle: 0.02\naxial_load: 5 %\ncontact:\n  stiffness: 10%\n  damping: 20\n"
    )
    given = deviations_of(path, load_parameters(HEALTHY))
    given += deviations_of(
        {"femur.mass": np.int64(2), "femur.radius": np.float32(0.03125)}, load_parameters(HEALTHY)
    )
    assert given == (
        Deviation("flexion_angle", 0.02, relative=False),
        Deviation("axial_load", 0.05, relative=True),
        Deviation("contact.stiffness", 0.1, relative=True),
        Deviation("contact.damping", 20.0, relative=False),
        Deviation("femur.mass", 2.0, relative=False),
        Deviation("femur.radius", 0.03125, relative=False),
    )
    assert [one.text for one in given] == [
        "0.02 rad",
        "5 %",
        "10 %",
        "20 N s/m",
        "2 kg",
        "0.03125 m",
    ]
    assert given[2].moved(200.0, 1.0) == pytest.approx(
        200.0 * math.exp(0.1), rel=1e-15
    )  # a percentage is a factor
    assert given[2].moved(given[2].moved(200.0, 1.0), -1.0) == pytest.approx(200.0, rel=1e-15)
    assert given[3].moved(np.array([0.0, 100.0]), -2.0).tolist() == [-40.0, 60.0]
    path.write_text("- 3\n")
    with pytest.raises(UsageError, match="names to standard deviations"):
        deviations_of(path, load_parameters(HEALTHY))


@pytest.mark.parametrize(
    ("params", "name", "size", "said"),
    [
        (
            HEALTHY,
            "load",
            3.0,
            "load is not allowed; with drive force and load.compartment fixed_share flexion_angle",
        ),
        (
            HEALTHY,
            "contact.stifness",
            "5 %",
            "contact.stifness is not allowed; did you mean contact.stiffness?",
        ),
        (HEALTHY, "fidelity.tolerance", 1e-6, "fidelity.tolerance is not allowed"),
        (
            HEALTHY,
            "contact.stiffness",
            "ten",
            "contact.stiffness: 'ten' is not allowed; a number > 0",
        ),
        (HEALTHY, "contact.stiffness", 0.2, "is only 2.5e-07 % of 7.90569e+07; write '20 %' for"),
        (
            HEALTHY,
            "contact.stiffness",
            "120 %",
            "'120 %' is not allowed; a number > 0 in SI units, or up to 100 %",
        ),
        (
            HEALTHY,
            "flexion_angle",
            2.0,
            "a number > 0 and up to 0.35 in SI units; is it in degrees?",
        ),
        (HEALTHY, "axial_load", 1e5, "a number > 0 and up to 737.068 in SI units, or up to 100 %"),
        (DISPLACED, "femoral_height", 0.5, "a number > 0 and up to 0.01 in SI units"),
        *(
            (HEALTHY, "contact.stiffness", size, f"contact.stiffness: {size!r} is not allowed")
            for size in (0.0, math.nan, 10**400, np.True_, None)
        ),
        (
            HEALTHY,
            "flexion_angle",
            "5 %",
            "flexion_angle: '5 %' is not allowed; a number > 0 in SI units",
        ),
        (DISPLACED, "axial_load", 10.0, "axial_load is not allowed; with drive displacement"),
    ],
)
def test_wrong_deviations_are_refused_in_a_line(params, name, size, said):
    with pytest.raises(UsageError, match=f"^uncertainty: .*{re.escape(said)}"):
        deviations_of({name: size}, load_parameters(params))


@pytest.fixture(scope="module")
def short_bag(right_bag, tmp_path_factory):
    return write_rosbag2(
        tmp_path_factory.mktemp("short") / "bag", raw_messages(right_bag)[: 2 * SHORT]
    )


def test_a_recording_whose_parameters_changed_is_refused_and_so_are_wrong_arguments(
    short_bag, tmp_path
):
    solve(short_bag, "mri_femur", tmp_path / "out.mcap")
    provenance = read_provenance(tmp_path / "out.mcap")
    with pytest.raises(UsageError, match="its parameters changed, or the model was reset"):
        read_uncertain_gait(
            short_bag, provenance._replace(changes=(Change(3, None),)), {"flexion_angle": 0.01}
        )
    for arguments, said in (
        (
            (short_bag, AT_REST),
            r"^uncertainty: no standard deviation is given; for example contact.stiffness: 10 %",
        ),
        ((None, None, {"contact.stiffness": "1 %"}), r"^no bag: give one"),
        ((short_bag, AT_REST, tmp_path / "nowhere.yaml"), r"nowhere\.yaml"),
    ):
        with pytest.raises(UsageError, match=said):
            uncertainty(*arguments)


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    rows = [(i * 10_000_000, 0.3, LOAD) for i in range(5)]
    return make_bag(tmp_path_factory.mktemp("resting") / "in.mcap", rows)


def of(bag, deviations, **values):
    return uncertainty(bag, {**AT_REST, **values}, deviations, compiled=False).medial


RADIUS = 1.0 / (1.0 / 0.034 - 1.0 / 0.095)


@pytest.mark.parametrize(
    ("name", "size", "force", "stiffness"),
    [
        ("axial_load", "1 %", 0.01, 0.0),
        ("axial_load", 10.0, 0.01, 0.0),
        ("medial_share", 0.005, 0.01, 0.0),
        ("contact.stiffness", "1 %", 0.0, 0.01),
        ("contact.stiffness", 0.01 * STIFFNESS, 0.0, 0.01),
        ("contact.femoral_radius", 1e-4, 0.0, 1e-4 * RADIUS / 2.0 / 0.034**2),
    ],
)
def test_the_depth_at_rest_goes_with_a_power(name, size, force, stiffness, resting):
    """δ = (F/K)^(1/n), so that dδ/δ = (dF/F - dK/K)/n; secants over ±1 % differ from that by some 1e-4, being cubic.

    Of materials, K ~ √R, 1/R = 1/r_F - 1/r_T: dK/K = dR/(2R) = R/(2 r_F²) dr_F.
    """
    found = of(
        resting,
        {name: size},
        **({"contact.stiffness_from": "material"} if "radius" in name else {}),
    )
    ((depths, forces),) = found.parts.values()
    assert depths == pytest.approx(
        (force - stiffness) / EXPONENT * found.rows["penetration_depth"], rel=3e-4
    )
    assert forces == pytest.approx(force * 0.5 * LOAD, abs=0.005 * LOAD * 3e-4)
    assert found.depth == pytest.approx(np.abs(depths), rel=1e-15)


def test_independent_inputs_add_up_in_squares_and_a_depth_is_not_below_0(resting, tmp_path):
    found = of(resting, {"axial_load": "3 %", "contact.stiffness": "4 %", "femur.radius": 1e-3})
    depths = np.array([depth for depth, _ in found.parts.values()])
    assert (depths[2] == 0.0).all()  # a circle on a level plane is as deep with any radius
    assert found.depth == pytest.approx(np.hypot(depths[0], depths[1]), rel=1e-14)
    assert found.depth == pytest.approx(0.05 / EXPONENT * DEPTH, rel=1e-3)  # secants of 4 %
    low, high = found.depth_interval(0.6826894921370859)  # one standard deviation
    assert high - low == pytest.approx(2.0 * found.depth, rel=1e-12)
    assert (found.depth_interval(0.99)[1] > found.depth_interval()[1]).all()
    light = make_bag(tmp_path / "in.mcap", [(i * 10_000_000, 0.3, 1.0) for i in range(3)])
    found = of(light, {"axial_load": 0.9, "contact.stiffness": "90 %"})
    assert (found.depth_interval(0.999)[0] == 0.0).all()
    assert (found.force_interval(0.999)[0] == 0.0).all()
    assert coverage_factor(0.95) == pytest.approx(
        1.959963984540054, rel=1e-12
    )  # tables of the normal distribution
    for level in (0.0, 1.0, -0.3, math.nan):
        with pytest.raises(
            UsageError, match=r"level: .* is not allowed; a probability between 0 and 1"
        ):
            found.depth_interval(level)


def test_at_the_end_of_a_range_one_side_is_taken(resting):
    ((depth, force),) = of(resting, {"load.share": 0.01}, **{"load.share": 1.0}).parts.values()
    assert force == pytest.approx(
        0.01 * LOAD, rel=1e-9
    )  # from 0.99 to 1 only; the depth is solved to 1e-12 of it
    assert (depth > 0.0).all()
    with pytest.raises(
        UsageError, match=r"load\.share: 0\.6 exceeds the allowed range in both directions"
    ):
        of(resting, {"load.share": 0.6}, **{"load.share": 0.6})


def test_compartments_have_their_own_loads_and_follow_unless_they_are_named(resting):
    both = {**AT_REST, "load.compartment": "both"}
    shared = uncertainty(resting, both, {"medial_share": 0.01}, compiled=False)
    assert shared.lateral is not None
    for one, sign in (
        (shared.medial, 1.0),
        (shared.lateral, -1.0),
    ):  # what one gets the other one loses
        ((_, force),) = one.parts.values()
        assert force == pytest.approx(sign * 0.01 * LOAD, rel=1e-9)
    medial, lateral = {"contact.stiffness": "10 %"}, {"lateral.contact.stiffness": "10 %"}
    ten = DEPTH * math.sinh(0.1 / EXPONENT)  # e^±0.1, to the power -1/n
    for deviations, alone in (
        (medial, ten),
        (lateral, 0.0),
        (medial | lateral, ten),
        (medial | lateral | {"lateral.femur.radius": 1e-3}, ten),
    ):
        found = uncertainty(resting, both, deviations, compiled=False)
        assert found.medial.depth == pytest.approx(alone, rel=1e-9, abs=1e-18)
        assert found.lateral.depth == pytest.approx(ten, rel=1e-9)
