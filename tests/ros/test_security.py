"""The node's policy against the node itself; refusing to run unsecured where security is asked for; open ports."""

import os
import re
import subprocess
import sys
from contextlib import suppress
from xml.etree import ElementTree as ET

import psutil
import pytest

from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.files import share_folder
from tests.helpers.patience import patience

COMMAND = [sys.executable, "-m", "knee_contact_ros.commands.main"]
POLICY = share_folder() / "config" / "security" / "knee_contact.policy.xml"
RULES = {
    "publish": "publisher",
    "subscribe": "subscriber",
    "reply": "service",
    "request": "client",
}
"""A policy's rule and what the graph calls it"""
PRIVILEGES = {"topics": {"publish", "subscribe"}, "services": {"reply", "request"}}
KEYSTORE_FILES = (
    "cert.pem",
    "governance.p7s",
    "identity_ca.cert.pem",
    "key.pem",
    "permissions.p7s",
    "permissions_ca.cert.pem",
)


def allowed_names(node):
    """Full names that the policy allows a node, by rule."""
    names: dict[str, set[str]] = {rule: set() for rule in RULES}
    policy = ET.parse(POLICY).getroot()  # noqa: S314 (our own file)
    (profile,) = (profile for profile in policy.iter("profile") if profile.get("node") == node)
    assert profile.get("ns") == "/"
    for group in profile:
        for rule, qualifier in group.attrib.items():
            assert rule in PRIVILEGES[group.tag]
            assert qualifier == "ALLOW"
            for element in group:
                assert element.tag + "s" == group.tag
                assert element.text not in names[rule]
                names[rule].add(
                    "/"
                    + re.sub("^(~/|/)", lambda m: f"{node}/" if m[0] == "~/" else "", element.text)
                )
    return names


def offered_names(peer, node):
    """What a running node has in the graph."""
    names: dict[str, set[str]] = {}
    for rule, kind in RULES.items():
        ask = getattr(peer.node, f"get_{kind}_names_and_types_by_node")
        names[rule] = {name for name, _ in ask(node, "/")}
    return names


@pytest.mark.parametrize(
    ("node", "kind", "force", "more"),
    [
        (Parameters.node, "node", "/joint_reaction_force", ("load.compartment:=both",)),
        (LoadParameters.node, "load", "/ground_reaction_force", ()),
    ],
)
def test_the_policy_is_what_the_node_has(peer, start_node, node, kind, force, more):
    start_node("use_sim_time:=true", *more, kind=kind)
    peer.wait_until(lambda: node in peer.node.get_node_names())
    peer.wait_until(lambda: {"/joint_states", force} <= offered_names(peer, node)["subscribe"])
    peer.spin(0.5)
    assert offered_names(peer, node) == allowed_names(node)


@pytest.fixture
def keystore(tmp_path, monkeypatch):
    """A keystore that is there, with nothing true in it; security is enforced."""
    enclave = tmp_path / "keystore" / "enclaves"
    enclave.mkdir(parents=True)
    for name in KEYSTORE_FILES:
        (enclave / name).write_text("made up")
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(enclave.parent))
    return enclave


def processes_of(keystore):
    """What runs with this keystore in its environment, except ourselves."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if (
                process.environ().get("ROS_SECURITY_KEYSTORE") == str(keystore)
                and process.pid != os.getpid()
            ):
                found.append(process)
    return found


COMPANION = share_folder() / "examples" / "assist_as_needed.py"
REFUSALS = {
    "node": ([*COMMAND, "node"], "knee-contact: cannot join the ROS graph: .*(?i:security)"),
    "replay": (
        [*COMMAND, "replay", share_folder() / "bags" / "gait2354_right"],
        "knee-contact: cannot join the ROS .*",
    ),
    "demo": ([*COMMAND, "demo"], "knee-contact: cannot join the ROS graph: .*"),
    "companion": ([sys.executable, COMPANION], "assist_as_needed: .*"),
    "node without its enclave": ([*COMMAND, "node"], "knee-contact: .*SECURITY ERROR.*"),
}
"""Commands, and what they say"""


@pytest.mark.parametrize("name", REFUSALS)
def test_where_security_is_enforced_and_cannot_be_had_nothing_runs(name, keystore, tmp_path):
    """One line beside ROS's log; no process, so no socket, is left."""
    command, words = REFUSALS[name]
    if "without" in name:
        keystore.rename(keystore.with_name("other"))
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=patience(), check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert processes_of(tmp_path / "keystore") == []
    (line,) = [line for line in done.stderr.splitlines() if line.startswith(words[:14])]
    assert re.match(words, line), line
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["keystore"]
