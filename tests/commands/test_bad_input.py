"""Bad input to every command: it is refused in one line with code 2, nothing is written, no input is replaced."""

import os
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import knee_contact
from tests.helpers.commands import run
from tests.helpers.walking import walk, walking_bag

NO_FOLDER = "there is no folder typo; make it first"
NO_BAG = "no bag at nowhere"
WRONG_PARAMETER = "parameter level: 5 is not allowed"
BAD_INPUT: dict[str, dict[str, str]] = {
    "demo": {
        "--output typo/demo": NO_FOLDER,
        "--bag nowhere": NO_BAG,
        "--params nowhere.yaml": "nowhere.yaml: cannot read the parameter file",
        "--rate 0": "0.01<=x<=100",
        "--from-sensors --bag {bag}": "has no topic /ground_reaction_force",
        "--from-sensors --params load/gait2354": "no parameters for node knee_contact",
        "--load-params load/insole": "--load-params is for --from-sensors",
    },
    "watch": {
        "--wait 0": "0.1<=x<=3600.0",
        "--once --wait 0.1": "no node with knee_contact or load_estimate in ROS domain",
    },
    "view": {
        "{bag} --save typo/out.rrd": NO_FOLDER,
        "{bag} --save x.png": "--save x.png: its name must end with .rrd",
    },
    "report": {"{bag} --output typo/report": NO_FOLDER},
    "table": {
        "nowhere --output x.csv": NO_BAG,
        "{bag} --output x.csv": "has no answers: knee-contact solve computes them",
        "{bag} --output x.xlsx": "--output x.xlsx: its name must end with .csv or .parquet",
    },
    "cite": {
        "nowhere": NO_BAG,
        "": "Missing argument 'BAG'",
        "{walk}": "does not say how it was made",
    },
    "node": {
        "--nonsense": "--nonsense: the node takes ROS arguments only, after --ros-args",
        "--ros-args --params-file nowhere.yaml": "nowhere.yaml: cannot read the parameter file",
    },
    "load": {
        "--ros-args --params-file nowhere.yaml": "nowhere.yaml: cannot read the parameter file",
    },
    "replay": {
        "nowhere": NO_BAG,
        "": "Missing argument 'BAG'",
        "{walk}": "its topics: /ground_reaction_force",
        "{bag} --sensors": "no topic /ground_reaction_force",
    },
    "solve": {
        "{bag} --output typo/out.mcap": NO_FOLDER,
        "{bag} --output out.csv": "--output out.csv: its name must end with .mcap",
        "nowhere --output x.mcap": NO_BAG,
        "nowhere": "Missing option '--output'",
        "{bag} --output x.mcap -p knee.joint_name:=hip": "has no joint 'hip'; it has knee",
        "{bag} --output x.mcap -p load.share=1": "-p 'load.share=1': it must be NAME:=VALUE",
        "{bag} --output x.mcap --namespace left": "has no topic /left/joint_states",
        "{bag} --output x.mcap --remap angles:=/exo": "FROM must be joint_states or joint_reaction",
        "{walk} --output x.mcap": "--remap joint_reaction_force:=TOPIC or --namespace NAME reads",
    },
    "estimate-load": {
        "{walk} --output typo/out.mcap": NO_FOLDER,
        "{walk} --output out.db3": "--output out.db3: its name must end with .mcap",
        "{walk} --output x.mcap --params healthy": "no parameters for node knee_load; found /**/kn",
        "{walk} --output x.mcap --params inverse_dynamic": "did you mean load/inverse_dynamics?",
        "{walk} --output x.mcap -p knee.joint_nam:=x": "did you mean knee.joint_name?",
        "{walk} --output x.mcap -p level:=5": WRONG_PARAMETER,
        "{walk} --output x.mcap --remap joint_reaction_force:=/x": "FROM must be joint_states or g",
        "{bag} --output x.mcap": "its topics: /joint_reaction_force",
    },
    "about": {"more": "Got unexpected extra argument (more)"},
    "recover": {
        "{file} typo/out.mcap": NO_FOLDER,
        "{file} out": "output out: its name must end with .mcap",
    },
    "import-opensim": {
        "--side right --kinematics q --reactions r --output typo/bag": NO_FOLDER,
    },
    "import-csv": {"cells.csv --map map.yaml --output typo/bag": NO_FOLDER},
    "align": {"cells.csv --map map.yaml --output typo/align.yaml": NO_FOLDER},
    "fit-profile": {
        "{file} --slice auto --output typo/out.csv": NO_FOLDER,
        "{file} --slice 0 --output x.yaml": "--output x.yaml: its name must end with .csv",
        "{file} --slice 0 --output x.csv --slab nan": "'--slab': nan is not a finite number",
    },
    "calibrate": {"trial.csv --free contact.stiffness --output typo/fitted.yaml": NO_FOLDER},
    "sweep": {"nowhere.yaml --output out": "nowhere.yaml: cannot read the study"},
    "sensitivity": {"nowhere.yaml --output out": "nowhere.yaml: cannot read the study"},
    "export": {
        "healthy --output typo/out": NO_FOLDER,
        "healthy --name 2nd --output out": "name '2nd' is no name in C",
        "healthy -p drive:=displacement --output out": "drive displacement cannot be exported",
        "nowhere --output out": "nowhere: cannot read the parameter file",
    },
    "trade": {
        "{bag} --picture typo/trade.png": NO_FOLDER,
        "{bag} --picture x.pdf": "--picture x.pdf: its name must end with .png",
        "{bag} --worth inf": "'--worth': inf is not a finite number",
    },
}
"""What is refused, by command and by its arguments"""


def test_every_command_has_bad_input():
    untested = [*knee_contact.commands.keys() - BAD_INPUT.keys()]
    assert not untested, f"{untested}: add arguments that are refused to BAD_INPUT in {__file__}"


@pytest.fixture(scope="module")
def sensors(tmp_path_factory):
    """A bag of a walking leg's sensors."""
    return walking_bag(tmp_path_factory.mktemp("walk") / "walk.mcap", walk())


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (f"{command} {arguments}", reason)
        for command, refused in BAD_INPUT.items()
        for arguments, reason in refused.items()
    ]
    + [("walk", "No such command 'walk'")],
)
def test_it_is_refused_in_one_line_and_nothing_is_written(
    words,
    reason,
    right_bag,
    sensors,
    tmp_path,
    monkeypatch,
    capfd,
):
    if words.startswith(("node", "load", "replay", "demo", "watch")):
        pytest.importorskip("rclpy", reason="needs ROS")
    monkeypatch.chdir(tmp_path)
    file = right_bag / "gait2354_right_0.mcap"
    assert run(words.format(bag=right_bag, file=file, walk=sensors)) == 2
    out, error = capfd.readouterr()
    assert out == ""
    assert error.startswith("knee-contact: ")
    assert error.count("\n") == 1
    assert reason in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        "solve {} --output o.mcap",
        "solve --params {} --output o.mcap",
        "solve --subject {} --output o.mcap",
        "view {} --save o.rrd",
        "estimate-load {} --output o.mcap",
        "recover {} o.mcap",
        "replay {}",
        "demo --bag {}",
        "report {} --output o",
        "report --compare {} --output o",
        "sweep {} --output o",
        "trade {} --output o",
        "fit-profile {} --output o.csv",
        "calibrate {} --output o.yaml",
    ],
)
@pytest.mark.parametrize("kind", ["loop", "pipe", "/dev/zero", "folder"])
def test_pipes_devices_and_loops_are_refused(
    words,
    kind,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    Path("folder").mkdir()
    os.mkfifo("pipe")
    assert run(words.format(kind)) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    "words",
    [
        "align a.csv --map {0} --overwrite --output own.yaml",
        "calibrate a.csv --params {0} --free load.share --overwrite --output own.yaml",
        "table {0} --output own.csv",
        "trade {0} --picture own.png",
    ],
)
def test_an_input_is_never_replaced(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    own = Path(words.rsplit(maxsplit=1)[-1])
    own.write_text("precious")
    assert run(words.format(own)) == 2
    assert f"{own} is the input, which is never changed" in capsys.readouterr().err
    assert own.read_text() == "precious"
