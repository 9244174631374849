"""OpenSim itself, on its gait2354 example: tests that need the package and the example, and say so where they lack."""

import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.opensim import Files, child, read_knee
from knee_contact_ros.lab.opensim.results import AXES, ImportSettings
from knee_contact_ros.lab.opensim.run import run_python
from knee_contact_ros.lab.opensim.setups import Setup, dynamics_setup, read_setup
from knee_contact_ros.lab.tables import read_storage
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from tests.helpers.needs import needs_opensim
from tests.helpers.offline import estimate_load
from tests.lab.opensim.storages import write_storage
from tests.lab.opensim.test_command import origin
from tests.lab.opensim.test_leg import TOPICS

pytestmark = needs_opensim

BODY_WEIGHT = 711.96
"""[N] of the scaled subject"""
SUBJECT = {"person.mass": 72.6, "person.height": 1.8}
KINEMATICS, REACTIONS = (
    "reference_CMC_Kinematics_q.sto",
    "reference_JointReaction_ReactionLoads.sto",
)
LOADS = "subject01_walk1_grf.xml"
POINTS = [f"knee_r_on_tibia_r_in_tibia_r_p{axis}" for axis in "xyz"]
QUICK = ("--steps", "scale,ik,static")
BEGUN = 0.6
"""[s] from which the estimator has seen angles for long enough"""
KNEE, ANKLE = 7.5, 2.0
"""[N m] RMS that the load node's moments may be off OpenSim's: a leg in a plane, with tabled masses, whose hip does not
accelerate, against one in space with the subject's. It was 6.6 and 5.4 (right, left) at the knee, of 26 and 20 N m RMS,
and 1.4 and 1.4 at the ankle, of 57 and 42."""


@pytest.fixture
def example(reference_data, tmp_path):
    """The example without residual reduction, over a tenth of a second."""
    folder = tmp_path / "example"
    shutil.copytree(reference_data / "opensim_gait2354", folder, copy_function=shutil.copyfile)
    folder.chmod(0o755)
    cmc = folder / "subject01_Setup_CMC.xml"
    text = cmc.read_text()
    for old, new in (
        ("subject01_simbody_adjusted.osim", "subject01_simbody.osim"),
        ("ResultsRRA/subject01_walk1_RRA_Kinematics_q.sto", "subject01_walk1_ik.mot"),
        ("0.80000000", "0.95"),
        ("1.20000000", "1.05"),
        ("     -10.00000000 </lowpass", "6 </lowpass"),
    ):
        assert old in text
        text = text.replace(old, new)
    cmc.write_text(text)
    return folder


def run_tool(tool, setup, folder):
    assert run_python(child.__name__, (tool, setup), folder, folder / "log") == 0


@pytest.fixture
def scaled(example):
    """The example with the subject's model, subject01_simbody.osim."""
    run_tool("ScaleTool", "subject01_Setup_Scale.xml", example)
    return example


EXPRESSED = """<OpenSimDocument Version="40000"><AnalyzeTool name="x"><model_file>model.osim</model_file>
<coordinates_file>q.sto</coordinates_file><initial_time>0.8</initial_time><final_time>1.0</final_time>
<results_directory>.</results_directory><AnalysisSet><objects>{}</objects></AnalysisSet></AnalyzeTool></OpenSimDocument>
"""
REACTION = """<JointReaction name="{0}_{1}"><joint_names>knee_{2}</joint_names><apply_on_bodies>{0}</apply_on_bodies>
<express_in_frame>{1}</express_in_frame><start_time>0.8</start_time><end_time>1.0</end_time></JointReaction>"""


@pytest.mark.parametrize("side", ["right", "left"])
def test_reactions_in_other_frames_are_turned_as_opensim_does(reference_data, tmp_path, side):
    """Against what JointReaction itself says of the tibia in its frame, in the same run."""
    example, frames = reference_data / "opensim_gait2354", ("child", "parent", "ground")
    kinds = [(body, frame) for body in ("child", "parent") for frame in frames]
    shutil.copyfile(example / "gait2354_simbody.osim", tmp_path / "model.osim")
    shutil.copyfile(example / KINEMATICS, tmp_path / "q.sto")
    analyses = "".join(REACTION.format(*kind, side[0]) for kind in kinds)
    (tmp_path / "setup.xml").write_text(EXPRESSED.format(analyses))
    run_tool("AnalyzeTool", "setup.xml", tmp_path)
    found = {}
    for kind in kinds:
        reactions = tmp_path / f"x_{'_'.join(kind)}_ReactionLoads.sto"
        files = Files(tmp_path / "q.sto", reactions, model=tmp_path / "model.osim")
        found[kind] = (
            read_knee(side, files, ImportSettings(anyway=True), tmp_path).wrenches["load"].values
        )
    ours = found["child", "child"]
    assert (
        np.abs(ours[:, 1]).max() > 5e4
    )  # nothing but gravity and inertia; the muscles pull as their tone does
    for kind, wrench in found.items():
        np.testing.assert_allclose(wrench, ours, rtol=0.0, atol=0.01, err_msg=f"{kind} [N, N m]")


def test_the_compartments_of_a_knee_are_added_in_the_tibias_frame(reference_data, tmp_path):
    """What OpenSim says of the tibia, told by two bodies on it that are turned and lie beside its axis."""
    import opensim

    example = reference_data / "opensim_gait2354"
    model = opensim.Model(str(example / "gait2354_simbody.osim"))
    halves = {
        "med": (0.65, [0.01, -0.02, -0.02], [0.1, 0.2, 0.3]),
        "lat": (0.35, [0.0, -0.02, 0.025], [0.0, -0.3, 0.1]),
    }
    for name, (_, place, turn) in halves.items():
        body, on = (
            opensim.Body(f"{name}_cond_r", 1e-9, opensim.Vec3(0), opensim.Inertia(1e-9)),
            (opensim.Vec3(0),) * 2,
        )
        model.addBody(body)
        at = opensim.Vec3(*place), opensim.Vec3(*turn)
        model.addJoint(
            opensim.WeldJoint(
                f"{name}_cond_joint_r", model.getBodySet().get("tibia_r"), *at, body, *on
            )
        )
    model.finalizeConnections()
    model.printToXML(str(tmp_path / "model.osim"))
    whole = Files(example / KINEMATICS, example / REACTIONS)
    table = read_storage(example / REACTIONS)
    wrench = table.columns([f"knee_r_on_tibia_r_in_tibia_r_{axis}" for axis in AXES])
    force, torque = wrench[:, :3], wrench[:, 3:] + np.cross(table.columns(POINTS), wrench[:, :3])
    torque = torque - sum(share * np.cross(place, force) for share, place, _ in halves.values())
    columns = {}
    for name, (share, _, turn) in halves.items():
        to_tibia = Rotation.from_euler("XYZ", turn).as_matrix()
        parts = np.hstack([share * force @ to_tibia, share * torque @ to_tibia])
        columns |= {
            f"{name}_cond_joint_r_on_{name}_cond_r_in_{name}_cond_r_{a}": c
            for a, c in zip(AXES, parts.T, strict=True)
        }
    jr = write_storage(tmp_path / "jr.sto", table.stamps / NANOSECONDS, columns, "no")
    parts_of = whole._replace(reactions=jr, model=tmp_path / "model.osim")
    ours, found = (
        read_knee("right", files, ImportSettings(), tmp_path).wrenches["load"].values
        for files in (whole, parts_of)
    )
    np.testing.assert_allclose(found, ours, rtol=0.0, atol=0.01)
    with pytest.raises(
        UsageError,
        match=r"med_cond_joint_r_on_med_cond_r_in_med_cond_r_fx is in med_cond_r, .*--model M",
    ):
        read_knee("right", parts_of._replace(model=None), ImportSettings(), tmp_path)


def test_a_model_needs_all_coordinates_between_two_frames(reference_data, tmp_path, capsys):
    """Ground needs the whole leg and the pelvis; Moco's reactions are in ground."""
    example = reference_data / "opensim_gait2354"
    kinematics = read_storage(example / KINEMATICS)
    known = {
        name: kinematics.column(name) for name in kinematics.names if name != "hip_rotation_r"
    }
    short = write_storage(tmp_path / "q.sto", kinematics.stamps / NANOSECONDS, known, "yes")
    force = -700.0 + 0.0 * known["knee_angle_r"]
    moco = {f"/jointset/knee_r|reaction_on_child_{place}": force for place in range(1, 7)}
    reactions = write_storage(tmp_path / "jr.sto", kinematics.stamps / NANOSECONDS, moco, None)
    model = [
        f"--model={example / 'gait2354_simbody.osim'}",
        "--side=right",
        "--rate=0",
        f"--output={tmp_path / 'bag'}",
    ]
    for angles, words in (
        (
            short,
            "has no coordinate hip_rotation_r of gait2354_simbody.osim, by which tibia_r moves in ground",
        ),
        (example / KINEMATICS, ""),
    ):
        code = main(
            ["import-opensim", "--kinematics", str(angles), "--reactions", str(reactions), *model]
        )
        assert code == (2 if words else 0)
        assert words in capsys.readouterr().err
    forces = [
        message
        for message in read_bag(tmp_path / "bag", INPUT_TYPES)
        if message.topic.endswith("force")
    ]
    size = [
        np.linalg.norm(
            [m.message.wrench.force.x, m.message.wrench.force.y, m.message.wrench.force.z]
        )
        for m in forces
    ]
    np.testing.assert_allclose(size, 700.0 * np.sqrt(3.0), atol=1e-6)


def command(folder, output, *more):
    return ["import-opensim", f"--setup={folder}", "--side=right", f"--output={output}", *more]


def of_results(folder, ground, output):
    names = {"kinematics": folder / KINEMATICS, "reactions": folder / REACTIONS}
    names |= {"model": folder / "subject01_simbody.osim", "ground": ground, "output": output}
    options = [f"--{name}={path}" for name, path in names.items()]
    return ["import-opensim", *options, "--side=both"]


def loads_in(bag):
    """Axial loads [N]."""
    return [
        -m.message.wrench.force.y
        for m in read_bag(bag, INPUT_TYPES)
        if m.topic == "/joint_reaction_force"
    ]


def as_the_gui_writes(folder):
    """Make names whole paths of another computer, and leave out the model of inverse kinematics."""
    mine = "C:\\Users\\Me\\my walk\\"
    for name, changes in {
        "subject01_Setup_IK.xml": (">subject01_walk1", ">subject01_simbody.osim<"),
        "subject01_Setup_CMC.xml": ("> subject01_walk1", "> gait2354_CMC_Act"),
        LOADS: ("> subject01_walk1_grf.mot",),
    }.items():
        text = (folder / name).read_text()
        for old in changes:
            assert old in text
            new = f">{mine}{old.strip('> ')}" if old[-1] != "<" else ">Unassigned<"
            text = text.replace(old, new)
        (folder / name).write_text(text)


def test_scaling_kinematics_and_static_optimization_make_a_bag(example, tmp_path, capsys):
    as_the_gui_writes(example)
    before = {path: path.stat().st_mtime_ns for path in example.rglob("*")}
    bag, work = tmp_path / "walk", tmp_path / "work"
    assert main(command(example, bag, *QUICK, "--work", str(work), "--ground")) == 0
    said = capsys.readouterr().out
    for part in (
        "scale",
        "static",
        "residual moment",
        "reserve knee_angle_r",
        "marker error, the wo",
    ):
        assert part in said
    assert {
        path: path.stat().st_mtime_ns for path in example.rglob("*")
    } == before  # the user's folder is left alone
    assert sorted(path.name for path in tmp_path.glob("walk*")) == ["walk"]
    assert {path.stem for path in (work / "logs").iterdir()} == {
        "scale",
        "ik",
        "static",
        "reactions",
        "dynamics",
    }
    record = origin(bag)
    assert record["source"].startswith("OpenSim 4.")
    assert "static: knee_contact_static.xml" in record["steps"]
    assert "residual force: peak" in record["quality"]
    # Single stance: the knee carries some two to four body weights, and the ground about one, ahead of the ankle.
    assert 1.5 * BODY_WEIGHT < np.mean(loads_in(bag)) < 4.5 * BODY_WEIGHT
    wrenches = [
        m.message.wrench for m in read_bag(bag, TOPICS) if m.topic == "/ground_reaction_force"
    ]
    assert len(wrenches) > 20  # a tenth of a second, as the kinematics have it
    assert all(450.0 < wrench.force.y < 850.0 and wrench.torque.z > 0.0 for wrench in wrenches)


def test_a_step_that_fails_leaves_nothing_and_says_why(example, tmp_path, capsys):
    cmc, markers = example / "subject01_Setup_CMC.xml", example / "subject01_walk1.trc"
    whole = cmc.read_text()
    cmc.write_text(whole.replace(f" {LOADS} ", ""))
    assert main(command(example, tmp_path / "walk", *QUICK, "--ground")) == 2
    assert "has no external_loads_file; give --ground FILE" in capsys.readouterr().err
    cmc.write_text(whole)
    markers.write_text("no markers")
    assert main(command(example, tmp_path / "walk", *QUICK)) == 2
    said = capsys.readouterr().err
    assert "OpenSim's ik (subject01_Setup_IK.xml) failed with code" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "walk").exists()


def moments(folder):
    """Net joint moments by OpenSim's inverse dynamics."""
    base = read_setup(folder / "subject01_Setup_CMC.xml")
    assert isinstance(base, Setup)
    setup = dynamics_setup(base, folder / "dynamics.xml", KINEMATICS, (0.53, 2.46))
    run_tool("InverseDynamicsTool", setup.path.name, folder)
    return folder / setup.results / "moments.sto"


def estimated(bag, config, output):
    """What there is to say of a bag's estimates, and these by their stamps [ns]."""
    parameters = load_parameters(
        [config / "load" / "inverse_dynamics.yaml", SUBJECT], LoadParameters
    )
    estimates = {}
    return estimate_load(
        bag,
        parameters,
        output,
        keep=lambda answer: estimates.update({answer.sensed.stamp: answer.estimate}),
    ), estimates


def test_the_load_node_finds_opensims_net_moments_and_its_load_takes_the_place(
    scaled, config, tmp_path
):
    assert main(of_results(scaled, scaled / LOADS, tmp_path / "walk")) == 0
    by_opensim, reactions = read_storage(moments(scaled)), read_storage(scaled / REACTIONS)
    for side in ("right", "left"):
        bag, output = tmp_path / f"walk_{side}", tmp_path / f"{side}.mcap"
        summary, estimates = estimated(bag, config, output)
        assert (summary.level, len(estimates), summary.refused.total()) == ("ankle_moment", 387, 0)
        stamps = np.array(list(estimates))
        late, letter = stamps > BEGUN * NANOSECONDS, side[0]
        for joint, sign, allowed in (("knee", 1.0, KNEE), ("ankle", -1.0, ANKLE)):
            column = sign * by_opensim.column(f"{joint}_angle_{letter}_moment")
            told = np.array(
                [getattr(estimate, f"{joint}_moment") for estimate in estimates.values()]
            )
            off = told - np.interp(stamps, by_opensim.stamps, column)
            assert np.sqrt(np.mean(off[late] ** 2)) < allowed
        reference = -reactions.column(f"knee_{letter}_on_tibia_{letter}_in_tibia_{letter}_fy")
        assert loads_in(bag) == pytest.approx(
            np.interp(stamps, reactions.stamps, reference), rel=1e-12
        )
        assert loads_in(output) == pytest.approx(
            [each.axial_force for each in estimates.values()], rel=1e-12
        )
