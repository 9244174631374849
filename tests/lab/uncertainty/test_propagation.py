"""Intervals against closed forms and against samples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros import UsageError
from knee_contact_ros.lab.uncertainty import Propagated, factor
from tests.offline.test_solve import make_bag

LOAD, STIFFNESS, EXPONENT = 1000.0, 7.905694e7, 1.5
AT_REST = {"contact.law": "hertz", "fidelity.level": "quasi_static", "contact.stiffness": STIFFNESS}
DEPTH = (0.5 * LOAD / STIFFNESS) ** (1.0 / EXPONENT)
"""[m] of half the load, at rest"""


@pytest.fixture(scope="module")
def resting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = [(i * 10_000_000, 0.3, LOAD) for i in range(5)]
    return make_bag(tmp_path_factory.mktemp("resting") / "in.mcap", rows)


def of(bag: Path, deviations: dict[str, Any], **values: Any) -> Propagated:
    return knee_contact_ros.uncertainty(bag, {**AT_REST, **values}, deviations, compiled=False).medial


@pytest.mark.parametrize(
    ("name", "given", "size", "power"),
    [
        ("axial_load", "1 %", 0.01, 1.0 / EXPONENT),
        ("axial_load", 10.0, 0.01, 1.0 / EXPONENT),
        ("medial_share", 0.005, 0.01, 1.0 / EXPONENT),
        ("load.share", 0.005, 0.01, 1.0 / EXPONENT),
        ("contact.stiffness", "1 %", 0.01, -1.0 / EXPONENT),
        ("contact.stiffness", 0.01 * STIFFNESS, 0.01, -1.0 / EXPONENT),
    ],
)
def test_the_depth_at_rest_goes_with_a_power(name: str, given: Any, size: float, power: float, resting: Path) -> None:
    """δ = (F/K)^(1/n), so that dδ/δ = ±1/n dF/F; secants over ±1 % differ from that by some 1e-4, being cubic."""
    found = of(resting, {name: given})
    ((depth, force),) = found.parts.values()
    assert depth == pytest.approx(power * size * DEPTH, rel=3e-4)
    assert force == pytest.approx(0.5 * LOAD * size if power > 0.0 else 0.0, abs=0.5 * LOAD * size * 3e-4)
    assert found.depth == pytest.approx(np.abs(depth), rel=1e-15)


def test_a_radius_in_a_stiffness_of_materials(resting: Path) -> None:
    """K ~ √R, 1/R = 1/r_F - 1/r_T: dK/K = dR/(2R) = R/(2 r_F²) dr_F."""
    found = of(resting, {"contact.femoral_radius": 1e-4}, **{"contact.stiffness_from": "material"})
    ((depth, _),) = found.parts.values()
    relative = 1.0 / (1.0 / 0.034 - 1.0 / 0.095)
    slope = -relative / (2.0 * 0.034**2) / EXPONENT
    assert depth == pytest.approx(slope * 1e-4 * found.rows["penetration_depth"], rel=1e-4)  # secants, likewise


def test_independent_inputs_add_up_in_squares(resting: Path) -> None:
    found = of(resting, {"axial_load": "3 %", "contact.stiffness": "4 %", "femur.radius": 1e-3})
    depths = np.array([depth for depth, _ in found.parts.values()])
    assert (depths[2] == 0.0).all()  # a circle on a level plane is as deep with any radius
    assert found.depth == pytest.approx(np.hypot(depths[0], depths[1]), rel=1e-14)
    assert found.depth == pytest.approx(0.05 / EXPONENT * DEPTH, rel=1e-3)  # secants of 4 %
    low, high = found.depth_interval(0.6826894921370859)  # one standard deviation
    assert high - low == pytest.approx(2.0 * found.depth, rel=1e-12)
    assert (found.depth_interval(0.99)[1] > found.depth_interval()[1]).all()


def test_a_depth_is_not_below_0(tmp_path: Path) -> None:
    rows = [(i * 10_000_000, 0.3, 1.0) for i in range(3)]
    found = of(make_bag(tmp_path / "in.mcap", rows), {"axial_load": 0.9, "contact.stiffness": "90 %"})
    assert (found.depth_interval(0.999)[0] == 0.0).all()
    assert (found.force_interval(0.999)[0] == 0.0).all()


def test_at_the_end_of_a_range_one_side_is_taken(resting: Path) -> None:
    found = of(resting, {"load.share": 0.01}, **{"load.share": 1.0})
    ((depth, force),) = found.parts.values()
    assert force == pytest.approx(0.01 * LOAD, rel=1e-9)  # from 0.99 to 1 only; the depth is solved to 1e-12 of it
    assert (depth > 0.0).all()
    with pytest.raises(UsageError, match=r"load\.share: 2 leaves the range of what it is of both ways"):
        of(resting, {"load.share": 2.0}, **{"load.share": 1.0})


def test_an_input_of_no_knee_is_told(resting: Path) -> None:
    with pytest.raises(UsageError, match=r"flexion_angle: 100 rad leaves the range of what it is of both ways"):
        of(resting, {"flexion_angle": 100.0})


@pytest.mark.parametrize("level", [0.0, 1.0, -0.3, math.nan])
def test_a_level_is_a_probability(level: float) -> None:
    with pytest.raises(UsageError, match=r"level: .* is not allowed; a probability between 0 and 1"):
        factor(level)
    assert factor(0.95) == pytest.approx(1.959963984540054, rel=1e-12)  # tables of the normal distribution


GAIT = {"flexion_angle": 0.035, "axial_load": "3 %", "medial_share": 0.02, "contact.stiffness": "5 %",
        "contact.damping": "20 %"}  # fmt: skip
SAMPLES = 120
SPREAD = 4.0 / math.sqrt(2.0 * (SAMPLES - 1))
"""Four standard errors of a standard deviation, relative"""


def test_samples_of_gait_agree_with_the_straight_lines(right_bag: Path) -> None:
    """On all of the gait, in contact throughout: where deviations are small, straight lines hold."""
    found = knee_contact_ros.uncertainty(right_bag, "healthy", GAIT, compiled=True)
    (check,) = found.sampled(SAMPLES, seed=3)
    for linear, drawn in ((found.medial.depth, check.depth), (found.medial.force, check.force)):
        # A share of 20 damping and 5 % of stiffness bend by 1 %: beside four standard errors
        assert drawn == pytest.approx(linear, rel=SPREAD + 0.02)
    for inside in (check.depth_inside, check.force_inside):
        # 95 %, of 120 samples: ±4 standard errors of the binomial distribution at any tick
        assert inside.min() > 0.95 - 4.0 * math.sqrt(0.05 * 0.95 / SAMPLES)
    at = int(found.medial.rows["load"].argmax())
    assert found.medial.depth[at] > 100.0 * found.medial.rows["error_estimate"][at]
    assert found.lateral is None
    assert found.sampled(2, seed=3)[0].depth.shape == check.depth.shape
    with pytest.raises(UsageError, match="samples: 1 is not allowed"):
        found.sampled(1)


def test_both_compartments_have_their_own(resting: Path) -> None:
    found = knee_contact_ros.uncertainty(
        resting, {**AT_REST, "load.compartment": "both", "load.share": 0.6}, {"medial_share": 0.01}, compiled=False
    )
    assert found.lateral is not None
    (medial,), (lateral,) = ([force for _, force in one.parts.values()] for one in (found.medial, found.lateral))
    # what one gets the other one loses
    assert medial == pytest.approx(0.01 * LOAD, rel=1e-9)
    assert lateral == pytest.approx(-0.01 * LOAD, rel=1e-9)


def test_a_lateral_parameter_follows_the_medial_one_unless_it_is_named(resting: Path) -> None:
    both = {**AT_REST, "load.compartment": "both"}
    medial, lateral = {"contact.stiffness": "10 %"}, {"lateral.contact.stiffness": "10 %"}
    found = [
        knee_contact_ros.uncertainty(resting, both, given, compiled=False)
        for given in (medial, lateral, {**medial, **lateral}, {**medial, **lateral, "lateral.femur.radius": 0.001})
    ]
    ten = DEPTH * math.sinh(0.1 / EXPONENT)  # e^±0.1, to the power -1/n
    for one, alone in zip(found, (ten, 0.0, ten, ten), strict=True):
        assert one.lateral is not None
        assert one.medial.depth == pytest.approx(alone, rel=1e-9, abs=1e-18)
        assert one.lateral.depth == pytest.approx(ten, rel=1e-9)


def test_deviations_may_be_a_file_and_what_is_wrong_is_told(resting: Path, tmp_path: Path) -> None:
    path = tmp_path / "sd.yaml"
    path.write_text("contact.stiffness: 1 %\n")
    ours = knee_contact_ros.uncertainty(resting, AT_REST, path, compiled=False).medial
    assert ours.depth.tolist() == of(resting, {"contact.stiffness": "1 %"}).depth.tolist()
    with pytest.raises(UsageError, match=r"^uncertainty: no standard deviation is given"):
        knee_contact_ros.uncertainty(resting, AT_REST)
    with pytest.raises(UsageError, match=r"^no bag: give one"):
        knee_contact_ros.uncertainty(deviations={"contact.stiffness": "1 %"})
    with pytest.raises(UsageError, match=r"nowhere\.yaml"):
        knee_contact_ros.uncertainty(resting, AT_REST, tmp_path / "nowhere.yaml")
