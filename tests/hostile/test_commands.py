"""Files of somebody who means no good, given to the commands that read such files: they end soon, and say why."""

import os
import resource
import signal
import sys

import pytest

from knee_contact_ros.commands.main import knee_contact, main
from tests.helpers.forked import PROCESSES
from tests.helpers.needs import HAS_REPORT, HAS_VIEWER, needs_viewer
from tests.hostile.cases import BAGS, GAIT

COMMANDS = {
    "solve": "{bag} --output {output}/out.mcap",
    "report": "{bag} --output {output}/report",
    "view": "{bag} --save {output}/out.rrd",
    "recover": "{bag} {output}/out.mcap",
    "estimate-load": "{bag} --output {output}/out.mcap "
    "--remap=ground_reaction_force:=/joint_reaction_force",
    "table": "{bag} --output {output}/out.csv",
    "cite": "{bag}",
    "trade": "{bag} --picture {output}/out.png",
    "calibrate": "{bag} --free person.tone --output {output}/out.yaml",
    "replay": "{bag} --wait 0",
    "demo": "--bag {bag} --output {output}/out",
}
"""Arguments with which a command reads a bag"""
READ_NO_BAG = {
    *("node", "load", "watch", "import-opensim", "import-csv", "align", "fit-profile"),
    *("sweep", "sensitivity", "export", "about"),
}
OTHERWISE = [
    ("a chunk that hides ten gigabytes", "recover"),
    ("channels without end", "recover"),
    ("escape codes in topics", "recover"),
    ("quality of service without end", "recover"),
    ("records within each other", "recover"),
    ("a profile that is named", "report"),
    ("metadata that is a pipe", "report"),
    ("escape codes in topics", "estimate-load"),
    ("messages that are none", "estimate-load"),
    ("escape codes in topics", "table"),
    ("escape codes in topics", "cite"),
    ("messages that are none", "trade"),
    ("messages that are none", "calibrate"),
    ("a chunk that hides ten gigabytes", "replay"),
    ("a chunk that hides ten gigabytes", "demo"),
]
"""Where other commands have ways of their own"""
SEEN = [
    pytest.param(name, "view", marks=needs_viewer)
    for name in ("a profile that is named", "escape codes in topics")
]
MEMORY, SECONDS, PATIENCE = 3 * 2**30, 20, 60
"""Addresses [B] and processor time [s] that a command may use, and the time [s] for one that waits"""


def limited(arguments, log):
    """In a process of its own: run a command with little memory and time; what it says goes to `log`."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    signal.alarm(PATIENCE)
    sys.exit(main(arguments))


def run(command, bag, output):
    """Exit code (negative: of a signal) of a command, and what it said."""
    log = output.with_name("log")
    arguments = [command, *COMMANDS[command].format(bag=bag, output=output).split()]
    process = PROCESSES.Process(target=limited, args=(arguments, log))
    process.start()
    process.join()
    return process.exitcode, log.read_text(errors="replace")


def files(folder):
    """All that is in a folder: sizes and times."""
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in folder.rglob("*")
    }


@pytest.mark.parametrize(
    ("name", "command"), [(name, "solve") for name in BAGS] + OTHERWISE + SEEN
)
def test_bags(name, command, tmp_path):
    theirs, output = tmp_path / "theirs", tmp_path / "output"
    theirs.mkdir()
    output.mkdir()
    bag = BAGS[name](theirs)
    before = files(theirs)
    code, said = run(command, bag, output)
    assert code in (0, 1, 2), said
    assert "Traceback" not in said
    assert code == 0 or said.splitlines()[-1].startswith("knee-contact: ")
    assert said.replace("\n", "").isprintable()
    assert files(theirs) == before
    made = {path.name for path in output.iterdir()}
    assert made <= {"out.mcap", "out.rrd", "out.csv", "out.png", "out.yaml", "report"}


def test_every_command_that_reads_bags_is_given_bad_ones():
    others = knee_contact.commands.keys() - READ_NO_BAG
    assert others == COMMANDS.keys(), (
        f"{others ^ COMMANDS.keys()}: add arguments to COMMANDS and cases to OTHERWISE in {__file__}, or to READ_NO_BAG"
    )
    assert COMMANDS.keys() == {"solve", "view", *(command for _, command in OTHERWISE)}


def test_a_good_bag_passes_the_same_way(tmp_path):
    output, again = tmp_path / "output", tmp_path / "again"
    output.mkdir()
    again.mkdir()
    for command in ("solve", *["report"][:HAS_REPORT], *["view"][:HAS_VIEWER]):
        assert run(command, GAIT, output)[0] == 0
    assert run("recover", output / "out.mcap", again)[0] == 0
