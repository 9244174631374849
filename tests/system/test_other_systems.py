"""Offline commands where the package believes that it runs on Windows or macOS, and has no ROS."""

import json
import os
import subprocess
import sys
from pathlib import PureWindowsPath
from typing import Any

import pytest

from knee_contact_ros.bags.folder import NUMBERED
from knee_contact_ros.lab.shards import is_address
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.output_files import REPAIR_COMMANDS, partial_name
from knee_contact_ros.system.ros_files import parameters_of
from tests import ROOT
from tests.helpers.needs import HAS_REPORT, HAS_VIEWER
from tests.helpers.other_systems import SYSTEMS, environment, lacking_names
from tests.helpers.package import copy_of_the_package

FOLDER = "C:\\Users\\Jürgen Müller\\knee"
"""Name of a folder that looks like a path of Windows"""
MAP = """\
time: {column: time_s, unit: s}
angle: {column: goniometer_deg, unit: deg}
load: {columns: {pm_n: 1, am_n: 1, al_n: 1, pl_n: 1}, unit: N, direction: compression}
reference: {column: knee_flexion_deg, unit: deg, sign: -1}
side: right
body_weight: 737.1
"""
STUDY = """\
bags: [{bags}/gait2354_right]
grid: {{contact.damping: [2000.0, 5000.0]}}
"""
SENSITIVITY = """\
bags: [{bags}/gait2354_right]
sensitivity: {{method: morris, n: 8, ranges: {{contact.damping: [2e3, 5e3], femur.mass: [3.0, 4.0]}}}}
"""
TRIAL = "time,flexion_angle,load,penetration_depth\n" + "".join(
    f"{0.01 * i},0.3,{900 + 10 * i},{7e-4 + 4e-6 * i}\n" for i in range(20)
)
COMMANDS = [
    "solve {bags}/gait2354_right --output out.mcap",
    "solve {bags}/gait2354_right {bags}/gait2354_left --output both.mcap",
    "table both.mcap --output both.csv",
    "solve {bags}/gait2354_right --output out.mcap --overwrite",
    "table out.mcap --output out.csv",
    "trade out.mcap --picture out.png",
    "estimate-load {bags}/gait2354_right_sensors --params load/gait2354 --output load.mcap",
    "recover cut.mcap.partial whole.mcap",
    "recover cut.mcap.partial whole.mcap --overwrite",
    "import-csv {laboratory}/cells.csv {laboratory}/motion.csv --map map.yaml --output trial",
    "import-csv {laboratory}/cells.csv {laboratory}/motion.csv --map map.yaml --output trial --overwrite",
    "align {laboratory}/cells.csv {laboratory}/motion.csv --map map.yaml --output align.yaml",
    "import-opensim --kinematics {subject}/walk_q.sto --reactions {subject}/walk_jr.sto --side right --output walk",
    "fit-profile {subject}/femur_cartilage.stl --slice -18 --output femur.csv",
    "calibrate trial.csv --free contact.stiffness --no-intervals --starts 1 --output fitted.yaml",
    "sweep study.yaml --output swept --workers 1",
    "sensitivity which.yaml --output which --workers 1",
]
if HAS_REPORT:
    COMMANDS.append("report out.mcap --output report")
if HAS_VIEWER:
    COMMANDS.append("view out.mcap both.mcap --save out.rrd")
RUN = """
import contextlib, importlib, json, pkgutil, sys
import knee_contact_ros
from knee_contact_ros.commands.main import main

NEED_ROS = ("node", "msg", "commands.demo", "commands.replay", "commands.watch", "system.ros", "system.keyboard")

def import_all():
    for module in pkgutil.walk_packages(knee_contact_ros.__path__, "knee_contact_ros."):
        name = module.name.partition(".")[2]
        if not name.startswith(NEED_ROS) and "knee_contact-" not in name:
            importlib.import_module(module.name)
    assert knee_contact_ros.load_model("healthy").run(
        time=[0.0, 0.01], flexion_angle=[0.1, 0.1], load=[500.0, 500.0]
    ).contact_force[1] > 0.0

if __name__ == "__main__":
    commands = json.loads(sys.argv[1])
    if len(commands) > 1:
        import_all()
    for command in commands:
        print(">", command, flush=True)
        # Two bags at once are another frame, which ends with 1.
        if (code := main(command.split())) > ("gait2354_left" in command):
            sys.exit(f"{command} ended with {code}")
"""
"""Runs commands, several after it has imported all that needs no ROS; guarded, as processes are spawned"""
ANSWERS = ("out.csv", "femur.csv")
"""Files of numbers, which are the same on all systems"""


def prepared(folder):
    """Fill a folder with the inputs of the commands; return where the others are."""
    folder.mkdir()
    places = {
        "bags": ROOT / "bags",
        "laboratory": ROOT / "examples" / "laboratory",
        "subject": ROOT / "examples" / "subject",
    }
    texts = {"map.yaml": MAP, "trial.csv": TRIAL, "study.yaml": STUDY, "which.yaml": SENSITIVITY}
    for name, text in texts.items():
        whole = text.format(**places) if "{bags}" in text else text
        (folder / name).write_text(whole, encoding="utf-8")
    (folder / "run.py").write_text(RUN, encoding="utf-8")
    content = next((ROOT / "bags" / "gait2354_right").glob("*.mcap")).read_bytes()
    (folder / "cut.mcap.partial").write_bytes(content[: len(content) // 2])
    return {name: str(place) for name, place in places.items()}


def run(folder, commands, **environment):
    """Run commands in a folder; return exit code, output and errors."""
    done = subprocess.run(
        [sys.executable, "run.py", json.dumps(commands)],
        cwd=folder,
        env=environment,
        capture_output=True,
        check=False,
        timeout=900,
    )
    encoding = "cp1252" if environment.get("PYTHONIOENCODING") == "cp1252" else "utf-8"
    return done.returncode, done.stdout.decode(encoding), done.stderr.decode(encoding)


@pytest.fixture(scope="module")
def answers_here(tmp_path_factory):
    """A folder with what this system computes."""
    here = tmp_path_factory.mktemp("here") / "knee"
    places = prepared(here)
    kept = [command for command in COMMANDS if any(name in command for name in ANSWERS)]
    commands = [command.format(**places) for command in (COMMANDS[0], *kept)]
    assert run(here, commands, **os.environ)[0] == 0
    return here


@pytest.mark.parametrize("system", SYSTEMS)
def test_all_that_needs_no_ros_runs_and_gives_the_same_numbers(system, answers_here, tmp_path):
    folder = tmp_path / FOLDER
    places = prepared(folder)
    commands = [command.format(**places) for command in COMMANDS]
    code, output, errors = run(folder, commands, **environment(system))
    assert code == 0, output + errors
    assert not any(escape in output + errors for escape in ("\\u", "\\x", "Traceback"))
    assert not list(folder.rglob("*.partial"))[1:]  # one is an input
    for name in ANSWERS:
        lines = (folder / name).read_text("utf-8").splitlines()
        assert lines == (answers_here / name).read_text("utf-8").splitlines()


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("command", ["node", "load", "replay {bags}/gait2354_right", "demo"])
def test_a_command_that_needs_ros_says_so_in_a_line(system, command, tmp_path):
    folder = tmp_path / FOLDER
    places = prepared(folder)
    code, _, errors = run(folder, [command.format(**places)], **environment(system))
    assert code == 1
    (line, _) = errors.splitlines()
    assert "ROS" in line


SOLVE, SOLVE_TWO = COMMANDS[:1], COMMANDS[1:3]
SWEEP = ["sweep study.yaml --output swept --workers 1"]
WRONG = [
    ("win32", SOLVE, "system/output_files.py", "import itertools", "import fcntl, itertools"),
    ("win32", SOLVE, "bags/bag.py", "import tempfile", "import tempfile, resource"),
    ("win32", SWEEP, "lab/knees.py", "import time", "import time; from signal import SIGKILL"),
    ("darwin", SWEEP, "lab/knees.py", "import time", "import time; from os import sched_getaffinity"),
    ("win32", SOLVE, "system/portable.py", "FILES = False", "FILES = True"),
    ("win32", SOLVE_TWO, "commands/offline.py", "link_or_copy(file, folder / link)",
     "(folder / link).symlink_to(file)"),
    ("win32", SOLVE, "commands/tables.py", '"answers flagged"', '"answers flagged \\u2192"'),
]  # fmt: skip
"""System, commands, file, text in it, what stands there instead: a POSIX import put back, an open file renamed, ..."""


@pytest.mark.parametrize(("system", "commands", "file", "text", "wrong"), WRONG)
def test_what_the_system_lacks_is_found(system, commands, file, text, wrong, tmp_path):
    package = copy_of_the_package(tmp_path / "copy")
    changed = package / file
    source = changed.read_text("utf-8")
    assert source.count(text) >= 1
    changed.write_text(source.replace(text, wrong, 1), encoding="utf-8")
    folder = tmp_path / FOLDER
    places = prepared(folder)
    own = environment(system)
    own["PYTHONPATH"] = os.pathsep.join([str(package.parent), own["PYTHONPATH"]])
    code, output, errors = run(folder, [command.format(**places) for command in commands], **own)
    assert code or "\\u" in output, output + errors


def test_lists_know_what_systems_lack():
    windows, mac = map(lacking_names, SYSTEMS)
    assert {"fork", "O_NONBLOCK", "getuid", "sched_getaffinity", "fdatasync"} <= {*windows["os"]}
    assert {"SIGHUP", "SIGKILL", "pthread_sigmask"} <= {*windows["signal"]}
    assert {"AF_UNIX"} <= {*windows["socket"]}
    assert {"sched_getaffinity", "sched_setscheduler"} <= {*mac["os"]}
    assert not {"fork", "O_NONBLOCK", "getuid"} & {*mac["os"]}
    assert not {"open", "replace", "link", "symlink", "cpu_count"} & {*windows["os"]}


PYTEST = (
    "-q -p no:cacheprovider -p no:xdist -W ignore::EncodingWarning tests/system/test_output_files.py "
    "tests/bags/test_writer.py tests/offline/test_outputs.py"
)
NOT_HERE = "not pipes and not hashes and not cut_off"
"""The others are about pipes, ROS's messages and how a path is quoted"""


@pytest.mark.parametrize("system", SYSTEMS)
def test_files_of_results_keep_their_promises(system):
    """The same tests of locks and names as on this system."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *PYTEST.split(), "-k", NOT_HERE],
        cwd=ROOT,
        env=environment(system),
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout


def test_paths_have_drives_and_backslashes():
    path: Any = PureWindowsPath(r"C:\data\run_3.mcap")
    partial = partial_name(path)
    assert str(partial) == r"C:\data\run_3.mcap.partial"
    assert partial.with_suffix("").suffix in REPAIR_COMMANDS
    assert NUMBERED.fullmatch(path.name)
    assert not is_address(str(path))
    assert parameters_of([rf"record.path:={path}"]) == {"record.path": str(path)}
    assert load_parameters({"record.path": str(path)}).record.path == str(path)
