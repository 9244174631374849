"""What ends a node before it begins: one line that says what is wrong, and code 2."""

import json
import shlex
import subprocess
import sys
from importlib.util import find_spec

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import not_installed
from tests.helpers.needs import HAS_VIEWER
from tests.helpers.patience import patience

BOTH, ROS2_CONTROL = "load --with-contact", "knee.source:=dynamic_joint_states"
REFUSED = [
    ("node", "-p contact.damping:=-1.0", "parameter contact.damping: -1.0 is not allowed"),
    (
        "node",
        "-p contact.dampin:=1.0",
        "unknown parameter contact.dampin; did you mean contact.damping?",
    ),
    (
        "node",
        "-p femur.geometry:=profile -p femur.profile:=nowhere.csv",
        "cannot read nowhere.csv",
    ),
    ("node", "--params-file /nowhere.yaml", "/nowhere.yaml: cannot read the parameter file"),
    (
        "node",
        "-p record.path:=/tmp/kn\udce9e.mcap",
        r"'record.path:=/tmp/kn\udce9e.mcap' is not UTF-8",
    ),
    (
        "node",
        "-p 'knee.source:=/a geometry_msgs/Vector3Stamped vector.w'",
        "Vector3 has no field 'w'; it has x, y, z",
    ),
    (
        "node",
        "-p 'knee.source:=/a exo_msgs/State angle'",
        "exo_msgs/msg/State needs the ROS 2 package exo_msgs",
    ),
    (
        "node",
        "-p 'knee.source:=/a std_msgs/Float65 data'",
        "std_msgs has no message Float65; did you mean Float6",
    ),
    (
        "node",
        "-p 'knee.source:=/a std_msgs/Float64 data'",
        "std_msgs/msg/Float64 has no header with a stamp",
    ),
    (
        "node",
        "-p qos_overrides./knee_contact.publisher.reliability:=perhaps",
        "parameter qos_overrides./knee_contact.publisher.reliability: 'perhaps' is not allowed; it must be best_",
    ),
    ("load", "-p person.mas:=70.0", "unknown parameter person.mas; did you mean person.mass?"),
    (
        "load",
        "-p level:=ankle_moment",
        "level: 'ankle_moment' is not allowed; it needs ground.components",
    ),
    (
        BOTH,
        "-p person.height:=1.8",
        "knee_contact: unknown parameter person.height",
    ),
    (
        BOTH,
        "-r __node:=leg",
        "two nodes would have the name /leg; rename one of them, as -r knee_load:__node:=NAME",
    ),
    (
        BOTH,
        "-r knee_contact:joint_reaction_force:=/measured",
        "/knee_contact takes /joint_reaction_force from /knee_load, and cannot listen to /measured: give both",
    ),
    (
        BOTH,
        "-r knee_load:__ns:=/left",
        "takes /left/joint_states from /left/knee_load, and cannot listen to",
    ),
    (
        BOTH,
        "-p knee_contact:load.source:=/measured",
        "parameter load.source: '/measured' is not allowed with --with-contact: the force comes from the load node",
    ),
    (
        "node",
        "-r __node:=knee2 --params-file osteoarthritis.yaml",
        "osteoarthritis.yaml: no parameters for node knee2; found /**/knee_contact",
    ),
    (
        "node",
        "-r __ns:=/left --params-file load/gait2354",
        "for node left/knee_contact; found /**/knee_load",
    ),
    (
        "load",
        "-p knee_lod:person.mass:=60.0",
        "-p knee_lod:person.mass:=60.0: no parameters for node knee_load; found",
    ),
    (
        BOTH,
        "-r __ns:=/left -p knee_contact:load.share:=0.7",
        "no parameters for node left/knee_load or "
        "left/knee_contact; found knee_contact; in a namespace, use a file with /left/knee_contact",
    ),
]
"""Command, arguments and what is said"""
if HAS_VIEWER:
    REFUSED += [
        (
            "node",
            "-p rerun.mode:=serve -p rerun.knees:=left,right",
            "this knee, knee, must be one of them",
        )
    ]
if not find_spec("control_msgs"):
    REFUSED += [
        (
            "node",
            f"-p {ROS2_CONTROL}",
            "'dynamic_joint_states' needs the ROS 2 package control_msgs",
        )
    ]


PROGRAM = """
import json, sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from knee_contact_ros.commands.main import main

found = []
for words in json.loads(sys.argv[1]):
    with redirect_stdout(StringIO()) as said, redirect_stderr(said):
        found.append((main(words), said.getvalue()))
print(json.dumps(found))
"""
"""All of them in one process, one after another: none comes far"""


@pytest.fixture(scope="module")
def found():
    """Codes, and what was said."""
    words = json.dumps(
        [[*kind.split(), "--ros-args", *shlex.split(given)] for kind, given, _ in REFUSED]
    )
    command = [sys.executable, "-c", PROGRAM, words]
    done = subprocess.run(
        command, stdout=subprocess.PIPE, text=True, timeout=patience(), check=True
    )
    return [tuple(each) for each in json.loads(done.stdout)]


@pytest.mark.parametrize("number", range(len(REFUSED)), ids=[words for *_, words in REFUSED])
def test_what_is_wrong_ends_the_node_at_once(found, number):
    code, output = found[number]
    assert (code, len(output.splitlines())) == (2, 1), output
    assert REFUSED[number][-1] in output


def test_a_node_without_rerun_tells_what_to_install(start_node, tmp_path):
    arguments = [
        f"record.path:={tmp_path / 'new.mcap'}",
        "rerun.mode:=file",
        "rerun.path:=x.rrd",
    ]
    code, output = start_node(*arguments, without="rerun_cli").end()
    assert code == 2
    assert (
        output
        == f"knee-contact: parameter rerun.mode: file: {not_installed('rerun-sdk', 'viewer')}\n"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["load", "node"])
def test_arguments_that_ros_would_pass_over_are_refused(kind, capsys):
    assert main([kind, "-p", "person.mass:=70"]) == 2
    assert (
        capsys.readouterr().err
        == "knee-contact: -p: the node takes ROS arguments only, after --ros-args\n"
    )
