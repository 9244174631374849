"""Set-up files and what comes of them, without OpenSim itself: test_by_opensim.py runs it."""

import re

import numpy as np
import pytest

from knee_contact_ros.lab.opensim.quality import assess, verdict
from knee_contact_ros.lab.opensim.run import OpenSimRun, failure_in, warnings_in
from knee_contact_ros.lab.opensim.setups import Setup, plan, read_setup
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import write_storage

SETUPS = {
    "scale.xml": "<ScaleTool name='s'><GenericModelMaker><model_file>generic.osim</model_file></GenericModelMaker>"
    "<MarkerPlacer><marker_file>static.trc</marker_file><output_model_file>scaled.osim</output_model_file></MarkerPlacer>"
    "</ScaleTool>",
    "ik.xml": "<InverseKinematicsTool name='i'><model_file>scaled.osim</model_file><marker_file>walk.trc</marker_file>"
    "<time_range> 0.4 1.6</time_range><output_motion_file>ik.mot</output_motion_file></InverseKinematicsTool>",
    "rra.xml": "<RRATool name='walk_RRA'><model_file>scaled.osim</model_file><initial_time> 0.8 </initial_time>"
    "<results_directory>./RRA</results_directory><desired_kinematics_file>ik.mot</desired_kinematics_file>"
    "<output_model_file>adjusted.osim</output_model_file></RRATool>",
    "cmc.xml": "<CMCTool name='walk'><model_file> adjusted.osim </model_file><force_set_files>act.xml</force_set_files>"
    "<results_directory>./CMC</results_directory><external_loads_file>grf.xml</external_loads_file>"
    "<desired_kinematics_file>RRA/walk_RRA_Kinematics_q.sto</desired_kinematics_file><rra_controls_file> "
    "</rra_controls_file><initial_time>0.8</initial_time><final_time>1.2</final_time>"
    "<lowpass_cutoff_frequency>6</lowpass_cutoff_frequency></CMCTool>",
    "analyze.xml": "<AnalyzeTool name='a'><AnalysisSet><objects><Kinematics/></objects></AnalysisSet></AnalyzeTool>",
    "grf.xml": "<ExternalLoads><datafile>grf.mot</datafile></ExternalLoads>",
}
STEPS = ["scale", "ik", "rra", "cmc"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Set-up files and what they read; planning asks whether OpenSim is there, and needs nothing of it."""
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: name)
    for name, text in SETUPS.items():
        (tmp_path / name).write_text(f"<OpenSimDocument Version='40000'>{text}</OpenSimDocument>")
    for name in ("generic.osim", "static.trc", "walk.trc", "act.xml", "grf.mot"):
        (tmp_path / name).write_text("<a/>")
    return tmp_path


@pytest.mark.parametrize(
    ("steps", "planned"),
    [
        ([], STEPS),
        (["cmc", "rra", "ik", "scale"], STEPS),
        (["scale", "ik", "rra", "static"], [*STEPS[:3], "static"]),
        (["cmk"], "--steps: there is no cmk; there are scale, ik, rra, cmc, static"),
        (["ik"], "--steps ik: one of cmc and static must be among them"),
        (["cmc", "static"], "--steps cmc,static: one of cmc and static"),
    ],
)
def test_steps_run_in_their_order(folder, steps, planned):
    if isinstance(planned, str):
        with pytest.raises(UsageError, match=planned):
            plan([folder], steps)
        return
    where, setups = plan([folder], steps)
    assert (where, [setup.step for setup in setups]) == (folder, planned)


@pytest.mark.parametrize(
    ("name", "content", "paths", "says"),
    [
        ("", "", ["none"], "no such file or folder"),
        (
            "",
            "",
            ["grf.xml"],
            "no set-up file of a scale, IK, RRA, CMC or static optimization tool",
        ),
        ("", "", ["ik.xml", "cmc.xml"], "no set-up file for scale; there are ik, cmc"),
        (
            "ik2.xml",
            SETUPS["ik.xml"],
            ["."],
            r"ik\.xml and ik2\.xml are both for ik; give the files",
        ),
        (
            "scale.xml",
            "<ScaleTool><model_file>/data/g.osim</model_file></ScaleTool>",
            ["."],
            "names /data/g.osim, which is not in its folder",
        ),
        (
            "scale.xml",
            "<ScaleTool><model_file>C:\\g.osim</model_file></ScaleTool>",
            ["."],
            "names C:/g.osim, which is not in its folder",
        ),
        (
            "scale.xml",
            f"<ScaleTool><model_file>{'../' * 30}g.osim</model_file></ScaleTool>",
            ["."],
            "are all over /; put them into a folder of their own",
        ),
        ("scale.xml", "no xml", ["."], r"scale\.xml is not an OpenSim document"),
    ],
)
def test_set_up_files_that_cannot_be(folder, name, content, paths, says):
    if name:
        (folder / name).write_text(content if content == "no xml" else f"<D>{content}</D>")
    with pytest.raises(UsageError, match=says):
        plan([folder / path for path in paths], STEPS)


MINE = "C:\\Users\\Me\\my walk\\"


def of_the_gui(text):
    """A set-up file with whole paths of another computer, and the model that is open there."""
    for tag in ("model_file", "output_model_file"):
        if tag == "model_file" and "ScaleTool" not in text:
            text = re.sub(
                "<model_file>[^<]*</model_file>", "<model_file>Unassigned</model_file>", text
            )
    return re.sub(
        r"(<\w+_(?:file|files|directory)>) *(?:\./)?([\w/.]+\.?\w*) *<",
        lambda match: (
            match[1]
            + (match[2] if match[2] == "Unassigned" else MINE + match[2].replace("/", "\\"))
            + "<"
        ),
        text,
    )


def test_set_up_files_as_the_gui_writes_them_are_those_of_their_folder(folder):
    _, plain = plan([folder], [])
    for name in ("scale.xml", "ik.xml", "rra.xml", "cmc.xml"):
        path = folder / name
        path.write_text(of_the_gui(path.read_text()))
        assert MINE in path.read_text()
    where, setups = plan([folder], [])
    assert where == folder
    for before, after in zip(plain, setups, strict=True):
        assert after.changed
        assert not before.changed
        texts = [
            {
                each.tag: (each.text or "").strip().removeprefix("./")
                for each in setup.tool.iter()
                if not len(each)
            }
            for setup in (before, after)
        ]
        assert texts[0] == texts[1], after.path.name


@pytest.mark.parametrize(("more", "words"), [("", "0 models"), ("a.osim b.osim", "2 models")])
def test_a_set_up_file_without_a_model_needs_one_beside_it(folder, more, words):
    (folder / "generic.osim").unlink()
    for name in more.split():
        (folder / name).write_text("<a/>")
    scale = folder / "scale.xml"
    scale.write_text(scale.read_text().replace("generic.osim", ""))
    with pytest.raises(
        UsageError, match=rf"scale\.xml names no model_file, and its folder has {words}"
    ):
        plan([folder], [])


def test_set_up_files_in_several_folders(folder):
    for name in ("ik", "cmc"):
        (folder / name).mkdir()
        (folder / f"{name}.xml").rename(folder / name / f"{name}.xml")
    ik, cmc = (folder / name / f"{name}.xml" for name in ("ik", "cmc"))
    ik.write_text(
        ik.read_text().replace("scaled.osim", "../scaled.osim").replace("walk.trc", "../walk.trc")
    )
    text = (
        cmc.read_text().replace("adjusted.osim", "../scaled.osim").replace("act.xml", "../act.xml")
    )
    cmc.write_text(
        text.replace("grf.xml", "../grf.xml").replace(
            "RRA/walk_RRA_Kinematics_q.sto", "../ik/ik.mot"
        )
    )
    where, setups = plan([folder / "scale.xml", ik, cmc], [])
    assert where == folder
    assert [setup.path for setup in setups] == [folder / "scale.xml", ik, cmc]


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("[info] a\n[error] no such marker\n[info] bye\n", "[error] no such marker"),
        ("[warning] Couldn't find file mesh.vtp: failed\nthe end\n\n", "the end"),
        ("", "it said nothing"),
    ],
)
def test_the_line_of_a_log_that_reports_a_failure(tmp_path, log, words):
    (tmp_path / "l").write_text(log)
    assert failure_in(tmp_path / "l") == words


def test_warnings_of_a_log_are_told_once_and_not_those_of_bones(tmp_path):
    lines = [
        "[info] a",
        "[warning] Couldn't find file 'talus.vtp'.",
        *2 * ["[warning] marker X is not there"],
    ]
    (tmp_path / "l").write_text("\n".join(lines))
    assert warnings_in(tmp_path / "l") == ["[warning] marker X is not there"]
    (tmp_path / "l").write_text("\n".join(f"[error] {number}" for number in range(9)))
    assert warnings_in(tmp_path / "l")[3:] == ["and 6 more (--work DIR keeps its log)"]


ACTUATORS = """<D><ForceSet><defaults>
<CoordinateActuator name="default"><coordinate>hip</coordinate></CoordinateActuator></defaults><objects>
<PointActuator name="FX"/><PointActuator name="FY"/><TorqueActuator name="MZ"/>
<CoordinateActuator name="pelvis_tz_actuator"><coordinate> pelvis_tz </coordinate></CoordinateActuator>
<CoordinateActuator name="knee_reserve"><coordinate>knee_angle_r</coordinate></CoordinateActuator>
<CoordinateActuator name="hip_reserve"><coordinate>hip_flexion_r</coordinate></CoordinateActuator>
<CoordinateActuator name="toe_reserve"><coordinate>mtp_angle_r</coordinate></CoordinateActuator>
<CoordinateActuator name="off"><coordinate>ankle_angle_r</coordinate></CoordinateActuator></objects></ForceSet></D>"""
LOADS = """<D><ExternalLoads><objects><ExternalForce><force_identifier> right_v </force_identifier></ExternalForce>
<ExternalForce><force_identifier>left_v</force_identifier></ExternalForce></objects><datafile>grf.mot</datafile>
</ExternalLoads></D>"""
TIME = np.array([0.0, 0.5, 1.0])
JUDGED = {
    "residual force": (13.0, 45.0, True),  # of 3, 4 and 12 N; 5 % of 900 N
    "residual moment": (10.0, 9.0, False),  # 1 % of 900 N x 1 m
    "reserve knee_angle_r": (3.0, 4.0, True),  # 5 % of 80 N m; shown although it passes
    "reserve hip_flexion_r": (6.0, 5.0, False),
    "marker error, RMS of all": (15.0, 20.0, True),
    "marker error, the worst": (50.0, 40.0, False),
}
"""Peak, limit and verdict"""


def stored(path, columns):
    return write_storage(
        path, TIME, {name: np.array(column) for name, column in columns.items()}, "no"
    )


@pytest.fixture
def run(tmp_path):
    """400 N and 500 N on the feet in the middle, centre of mass at 1 m; before and after it the ground presses more."""
    (tmp_path / "act.xml").write_text(ACTUATORS)
    (tmp_path / "grf.xml").write_text(LOADS)
    (tmp_path / "cmc.xml").write_text(
        "<D><CMCTool name='walk'><force_set_files>act.xml</force_set_files>"
        "<external_loads_file>grf.xml</external_loads_file></CMCTool></D>"
    )
    (tmp_path / "ik.xml").write_text("<D><InverseKinematicsTool name='i'/></D>")
    feet = {f"{side}_v{axis}": np.zeros(5) for side in ("right", "left") for axis in "xyz"}
    feet |= {
        "right_vy": np.array([9e3, 0.0, 400.0, 0.0, 9e3]),
        "left_vy": np.array([0.0, 0.0, 500.0, 0.0, 0.0]),
    }
    write_storage(tmp_path / "grf.mot", np.array([-1.0, 0.0, 0.5, 1.0, 2.0]), feet, "yes")
    forces = stored(
        tmp_path / "f.sto",
        {
            "soleus_r": [900.0] * 3,
            "FX": [3.0, 0.0, 0.0],
            "FY": [4.0, 0.0, 0.0],
            "MZ": [0.0, -10.0, 0.0],
            "pelvis_tz_actuator": [12.0, 0.0, 0.0],
            "knee_reserve": [0.0, 1.0, -3.0],
            "hip_reserve": [0.0, 6.0, 0.0],
            "toe_reserve": [0.9, 0.0, 0.0],
        },
    )
    moments = stored(
        tmp_path / "m.sto",
        {
            "knee_angle_r_moment": [0.0, 80.0, 0.0],
            "hip_flexion_r_moment": [0.0, 0.0, -100.0],
            "mtp_angle_r_moment": [0.0, 0.1, 0.0],
        },
    )
    stored(
        tmp_path / "knee_contact_BodyKinematics_pos_global.sto",
        {"center_of_mass_Y": [0.99, 1.0, 1.01]},
    )
    errors = {"marker_error_RMS": [0.01, 0.015, 0.01], "marker_error_max": [0.02, 0.05, 0.01]}
    stored(tmp_path / "i_ik_marker_errors.sto", errors)
    setups = [read_setup(tmp_path / name) for name in ("ik.xml", "cmc.xml")]
    own = tuple(setup for setup in setups if isinstance(setup, Setup))
    return OpenSimRun(tmp_path, own[1], forces, tmp_path, moments, {}, own)


def test_peaks_and_their_limits(run):
    found = assess(run)
    assert [check.name for check in found] == list(JUDGED)
    for check in found:
        peak, allowed, passed = JUDGED[check.name]
        assert (check.peak, check.allowed, check.passed) == (
            pytest.approx(peak),
            pytest.approx(allowed),
            passed,
        )
        text = f"{check.unit}, {'within' if passed else 'ABOVE'} {allowed:.3g} ({check.basis})"
        assert (
            check.sentence() == f"{check.name}: peak {check.peak:.3g}, RMS {check.rms:.3g} {text}"
        )
    assert found[0].rms == pytest.approx(13.0 / np.sqrt(3.0))
    said = " ".join(verdict(found))
    assert said.count("ABOVE") == 3
    assert "Do not trust these results before you know why" in said
    assert said.endswith("residual moment, reserve hip_flexion_r, marker error, the worst.")
    said = " ".join(verdict([check for check in found if check.passed]))
    assert "within the limits in the literature" in said
    assert "ABOVE" not in said


def test_a_run_that_cannot_be_judged_says_why(run):
    run.moments.unlink()
    with pytest.raises(UsageError, match=r"cannot read .*m\.sto"):
        assess(run)
