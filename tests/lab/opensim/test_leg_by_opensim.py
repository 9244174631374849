"""From motion capture to the load node's moments, by OpenSim on its gait2354 example; they say so where these lack."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.lab.opensim import child
from knee_contact_ros.lab.opensim.pipeline import Setup, dynamics_setup, read_setup, run_python
from knee_contact_ros.lab.tables import read_storage
from knee_contact_ros.offline.estimate_load import LoadSummary, estimate_load
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.topics import NANOSECONDS
from tests.helpers.needs import needs_opensim
from tests.lab.opensim.test_leg import TOPICS
from tests.lab.opensim.test_opensim_pipeline import command
from tests.offline.test_solve import silent

pytestmark = needs_opensim

KINEMATICS, REACTIONS = "reference_CMC_Kinematics_q.sto", "reference_JointReaction_ReactionLoads.sto"
LOADS = "subject01_walk1_grf.xml"
SUBJECT = {"person.mass": 72.6, "person.height": 1.8}
BEGUN = 0.6
"""[s] from which the estimator has seen angles for long enough"""
KNEE, ANKLE = 7.5, 2.0
"""[N m] RMS that the load node's moments may be off OpenSim's: a leg in a plane, with tabled masses, whose hip does not
accelerate, against one in space with the subject's. It was 6.6 and 5.4 (right, left) at the knee, of 26 and 20 N m RMS,
and 1.4 and 1.4 at the ankle, of 57 and 42."""


@pytest.fixture
def scaled(example: Path) -> Path:
    """The example with the subject's model, subject01_simbody.osim."""
    assert run_python(child.__name__, ("ScaleTool", "subject01_Setup_Scale.xml"), example, example / "log") == 0
    return example


def arguments(folder: Path, ground: Path, output: Path) -> list[str]:
    names = {"kinematics": folder / KINEMATICS, "reactions": folder / REACTIONS}
    names |= {"model": folder / "subject01_simbody.osim", "ground": ground, "output": output}
    return ["import-opensim", *(f"--{name}={path}" for name, path in names.items()), "--side", "both"]


def moments(folder: Path) -> Path:
    """Net joint moments by OpenSim's inverse dynamics."""
    base = read_setup(folder / "subject01_Setup_CMC.xml")
    assert isinstance(base, Setup)
    setup = dynamics_setup(base, folder / "dynamics.xml", KINEMATICS, (0.53, 2.46))
    assert run_python(child.__name__, ("InverseDynamicsTool", setup.path.name), folder, folder / "log") == 0
    return folder / setup.results() / "moments.sto"


def estimated(bag: Path, config: Path, output: Path) -> tuple[LoadSummary, dict[int, Estimate]]:
    """What there is to say of a bag's estimates, and these by their stamps [ns]."""
    parameters = load_parameters([config / "load" / "inverse_dynamics.yaml", SUBJECT], LoadParameters)
    estimates: dict[int, Estimate] = {}
    return estimate_load(bag, parameters, output, silent, keep=estimates.__setitem__), estimates


def test_the_load_node_finds_opensims_net_moments(scaled: Path, config: Path, tmp_path: Path) -> None:
    assert main(arguments(scaled, scaled / LOADS, tmp_path / "walk")) == 0
    by_opensim = read_storage(moments(scaled))
    for side in ("right", "left"):
        summary, estimates = estimated(tmp_path / f"walk_{side}", config, tmp_path / f"{side}.mcap")
        assert (summary.level, len(estimates), summary.refused.total()) == ("ankle_moment", 387, 0)
        stamps = np.array(list(estimates))
        late = stamps > BEGUN * NANOSECONDS
        for joint, sign, allowed in (("knee", 1.0, KNEE), ("ankle", -1.0, ANKLE)):
            wanted = sign * np.interp(
                stamps, by_opensim.stamps, by_opensim.column(f"{joint}_angle_{side[0]}_moment")
            )  # fmt: skip
            told = np.array([getattr(estimate, f"{joint}_moment") for estimate in estimates.values()])
            assert np.sqrt(np.mean((told - wanted)[late] ** 2)) < allowed


def test_its_load_takes_the_place_of_opensims(scaled: Path, config: Path, tmp_path: Path) -> None:
    assert main(arguments(scaled, scaled / LOADS, tmp_path / "walk")) == 0
    _, estimates = estimated(tmp_path / "walk_right", config, tmp_path / "out.mcap")
    reactions = read_storage(scaled / REACTIONS)
    reference = -reactions.column("knee_r_on_tibia_r_in_tibia_r_fy")
    by_opensim = np.interp(np.array(list(estimates)), reactions.stamps, reference)
    ours = np.array([estimate.axial_force for estimate in estimates.values()])
    for bag, wanted in ((tmp_path / "walk_right", by_opensim), (tmp_path / "out.mcap", ours)):
        told = [-m.message.wrench.force.y for m in read_bag(bag, TOPICS) if m.topic == "/joint_reaction_force"]
        assert told == pytest.approx(wanted, rel=1e-12)


def test_names_of_columns_tell_the_same_as_external_loads(scaled: Path, tmp_path: Path) -> None:
    for name, ground in (("a", LOADS), ("b", "subject01_walk1_grf.mot")):
        assert main(arguments(scaled, scaled / ground, tmp_path / name)) == 0
    for side in ("right", "left"):
        first, second = ([str(m.message) for m in read_bag(tmp_path / f"{n}_{side}", TOPICS)] for n in "ab")
        assert first == second


def test_the_other_foots_plate_is_refused(scaled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loads = scaled / LOADS
    text = loads.read_text()
    loads.write_text(text.replace("calcn_r", "x").replace("calcn_l", "calcn_r").replace(" x ", " calcn_l "))
    assert main(arguments(scaled, loads, tmp_path / "walk")) == 2
    assert "away from the ankle while the foot stands" in capsys.readouterr().err


def test_a_run_has_its_own_external_loads(example: Path, tmp_path: Path) -> None:
    bag = tmp_path / "walk"
    assert main(command(example, bag, "--steps", "scale,ik,static", "--ground")) == 0
    wrenches = [m.message.wrench for m in read_bag(bag, TOPICS) if m.topic == "/ground_reaction_force"]
    assert len(wrenches) > 20  # a tenth of a second, as the kinematics have it
    # Single stance: about the body's weight, ahead of the ankle.
    assert all(450.0 < wrench.force.y < 850.0 and wrench.torque.z > 0.0 for wrench in wrenches)


def test_a_run_without_external_loads_is_refused_before_it_begins(
    example: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cmc = example / "subject01_Setup_CMC.xml"
    cmc.write_text(cmc.read_text().replace(f" {LOADS} ", ""))
    assert main(command(example, tmp_path / "walk", "--steps", "scale,ik,static", "--ground")) == 2
    assert "has no external_loads_file; give --ground FILE" in capsys.readouterr().err
