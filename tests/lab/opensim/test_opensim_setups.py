"""Set-up files: which step each is, and whether it finds what it needs, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.opensim.pipeline import (
    dynamics_setup,
    find_setups,
    plan,
    reactions_setup,
    read_setup,
    read_xml,
    results_of,
    static_setup,
)
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import not_installed

SETUPS = {
    "scale.xml": "<ScaleTool name='s'><GenericModelMaker><model_file>generic.osim</model_file></GenericModelMaker>"
    "<MarkerPlacer><marker_file>static.trc</marker_file><output_model_file>scaled.osim</output_model_file></MarkerPlacer>"
    "</ScaleTool>",
    "ik.xml": "<InverseKinematicsTool name='i'><model_file>scaled.osim</model_file><marker_file>walk.trc</marker_file>"
    "<output_motion_file>ik.mot</output_motion_file></InverseKinematicsTool>",
    "rra.xml": "<RRATool name='walk_RRA'><model_file>scaled.osim</model_file>"
    "<results_directory>./RRA</results_directory><desired_kinematics_file>ik.mot</desired_kinematics_file><output_model_file>adjusted.osim</output_model_file>"
    "</RRATool>",
    "cmc.xml": "<CMCTool name='walk'><model_file> adjusted.osim </model_file><force_set_files>act.xml</force_set_files>"
    "<results_directory>./CMC</results_directory><external_loads_file>grf.xml</external_loads_file>"
    "<desired_kinematics_file>RRA/walk_RRA_Kinematics_q.sto</desired_kinematics_file>"
    "<rra_controls_file> </rra_controls_file>"
    "<initial_time>0.8</initial_time><final_time>1.2</final_time>"
    "<lowpass_cutoff_frequency>6</lowpass_cutoff_frequency>"
    "</CMCTool>",
    "analyze.xml": "<AnalyzeTool name='a'><AnalysisSet><objects><Kinematics/></objects></AnalysisSet></AnalyzeTool>",
    "grf.xml": "<ExternalLoads><datafile>grf.mot</datafile></ExternalLoads>",
}
STEPS = ["scale", "ik", "rra", "cmc"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in SETUPS.items():
        (tmp_path / name).write_text(f"<OpenSimDocument Version='40000'>{text}</OpenSimDocument>")
    for name in ("generic.osim", "static.trc", "walk.trc", "act.xml", "grf.mot"):
        (tmp_path / name).write_text("<a/>")
    return tmp_path


def test_set_up_files_are_told_by_what_they_hold(folder: Path) -> None:
    assert sorted(find_setups([folder])) == sorted(STEPS)
    assert list(find_setups([folder / "ik.xml", folder / "cmc.xml"])) == ["ik", "cmc"]
    assert read_setup(folder / "analyze.xml") is None
    static = folder / "static.xml"
    static.write_text("<D><AnalyzeTool name='a'><StaticOptimization/></AnalyzeTool></D>")
    assert find_setups([folder])["static"].path == static


def test_properties(folder: Path) -> None:
    cmc = find_setups([folder])["cmc"]
    assert (cmc.name, cmc.text("model_file"), cmc.text("rra_controls_file"), cmc.results()) == (
        "walk", "adjusted.osim", "", "CMC",
    )  # fmt: skip
    assert cmc.reads() == ["adjusted.osim", "act.xml", "grf.xml", "RRA/walk_RRA_Kinematics_q.sto"]


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planning asks whether OpenSim is there, and needs nothing of it."""
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: name)


@pytest.mark.parametrize(
    ("steps", "planned"),
    [([], STEPS), (["cmc", "rra", "ik", "scale"], STEPS), (["scale", "ik", "rra", "static"], [*STEPS[:3], "static"])],
)
def test_steps_run_in_their_order(folder: Path, installed: None, steps: list[str], planned: list[str]) -> None:
    where, setups = plan([folder], steps)
    assert where == folder
    assert [setup.step for setup in setups] == planned


def test_a_step_is_left_out_if_its_result_is_there(folder: Path, installed: None) -> None:
    with pytest.raises(
        UsageError, match=r"cmc\.xml \(cmc\) needs adjusted\.osim, which is not in .* and comes of no step"
    ):
        plan([folder], ["cmc"])
    (folder / "RRA").mkdir()
    for name in ("adjusted.osim", "RRA/walk_RRA_Kinematics_q.sto"):
        (folder / name).write_text("")
    assert [setup.step for setup in plan([folder], ["cmc"])[1]] == ["cmc"]


@pytest.mark.parametrize(
    ("steps", "says"),
    [
        (["cmk"], "--steps: there is no cmk; there are scale, ik, rra, cmc, static"),
        (["ik"], "--steps ik: one of cmc and static must be among them"),
        (["cmc", "static"], "--steps cmc,static: one of cmc and static"),
    ],
)
def test_steps_that_cannot_be(folder: Path, installed: None, steps: list[str], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        plan([folder], steps)


def test_set_up_files_that_cannot_be(folder: Path, installed: None) -> None:
    with pytest.raises(UsageError, match="no such file or folder"):
        plan([folder / "none"], [])
    with pytest.raises(UsageError, match="no set-up file of a scale, IK, RRA, CMC or static optimization tool"):
        plan([folder / "grf.xml"], [])
    with pytest.raises(UsageError, match="no set-up file for scale; there are cmc"):
        plan([folder / "cmc.xml"], ["scale", "cmc"])
    (folder / "ik2.xml").write_text((folder / "ik.xml").read_text())
    with pytest.raises(UsageError, match=r"ik\.xml and ik2\.xml are both for ik; give the files"):
        plan([folder], [])
    (folder / "ik2.xml").unlink()
    (folder / "grf.mot").unlink()
    with pytest.raises(UsageError, match=r"cmc\.xml \(cmc\) needs grf\.mot"):
        plan([folder], ["scale", "ik", "rra", "cmc"])
    scale = folder / "scale.xml"
    for name in ("/data/generic.osim", "C:\\data\\generic.osim"):
        scale.write_text(f"<D><ScaleTool><model_file>{name}</model_file></ScaleTool></D>")
        with pytest.raises(UsageError, match="files must be named from its folder, with /"):
            plan([folder], [])
    up = "../" * len(folder.parts)
    scale.write_text(f"<D><ScaleTool><model_file>{up}generic.osim</model_file></ScaleTool></D>")
    with pytest.raises(UsageError, match="are all over /; put them into a folder of their own"):
        plan([folder], [])
    scale.write_text("no xml")
    with pytest.raises(UsageError, match=r"scale\.xml is no OpenSim document"):
        plan([folder], [])


def test_set_up_files_in_several_folders(folder: Path, installed: None) -> None:
    for name in ("ik", "cmc"):
        (folder / name).mkdir()
        (folder / f"{name}.xml").rename(folder / name / f"{name}.xml")
    ik = folder / "ik" / "ik.xml"
    ik.write_text(ik.read_text().replace("scaled.osim", "../scaled.osim").replace("walk.trc", "../walk.trc"))
    cmc = folder / "cmc" / "cmc.xml"
    text = cmc.read_text().replace("adjusted.osim", "../scaled.osim").replace("act.xml", "../act.xml")
    cmc.write_text(text.replace("grf.xml", "../grf.xml").replace("RRA/walk_RRA_Kinematics_q.sto", "../ik/ik.mot"))
    where, setups = plan([folder / "scale.xml", ik, cmc], [])
    assert where == folder
    assert [setup.path for setup in setups] == [folder / "scale.xml", ik, cmc]
    ik.write_text(ik.read_text().replace("ik.mot", "other.mot"))
    with pytest.raises(UsageError, match=r"cmc\.xml \(cmc\) needs \.\./ik/ik\.mot, which is not in"):
        plan([folder / "scale.xml", ik, cmc], [])


def test_our_own_set_ups_have_what_the_muscles_step_had(folder: Path, tmp_path: Path) -> None:
    cmc = find_setups([folder])["cmc"]
    static = static_setup(cmc, tmp_path / "s.xml", 5)
    assert read_setup(static.path) is not None  # it is a set-up file of ours to read, too
    assert (static.text("coordinates_file"), static.text("step_interval")) == ("RRA/walk_RRA_Kinematics_q.sto", "5")
    assert static.text("lowpass_cutoff_frequency_for_coordinates") == "6.0"
    for base, states in ((cmc, "CMC/walk_states_repaired.sto"), (static, None)):
        setup = reactions_setup(base, tmp_path / "r.xml", states, "forces.sto")
        tool = read_xml(setup.path).find("AnalyzeTool")
        assert tool is not None
        found = {tag: tool.findtext(f".//{tag}") for tag in (
            "model_file", "force_set_files", "external_loads_file", "initial_time", "final_time", "forces_file",
            "apply_on_bodies", "express_in_frame", "states_file", "coordinates_file")}  # fmt: skip
        assert list(found.values()) == [
            "adjusted.osim", "act.xml", "grf.xml", "0.8", "1.2", "forces.sto", "child", "child", states,
            None if states else "RRA/walk_RRA_Kinematics_q.sto",
        ]  # fmt: skip
    dynamics = dynamics_setup(cmc, tmp_path / "d.xml", "q.sto", (0.83, 1.19))
    assert (dynamics.text("time_range"), dynamics.text("coordinates_file")) == ("0.83 1.19", "q.sto")


def test_results_of_a_step_that_are_not_there(folder: Path) -> None:
    with pytest.raises(UsageError, match=r"cmc has not written CMC/walk_Actuation_force\.sto"):
        results_of(find_setups([folder])["cmc"])


def test_without_opensim_the_command_says_what_to_install(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: None)
    arguments = ["--setup", str(folder), "--side", "right", "--output", str(tmp_path / "walk")]
    assert main(["import-opensim", *arguments]) == 2
    assert not_installed("opensim", "opensim") in capsys.readouterr().err
    assert not (tmp_path / "walk").exists()
