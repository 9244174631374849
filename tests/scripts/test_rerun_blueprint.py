"""Rerun opens our recordings directly: what the shipped blueprint names is there, and is seen."""

import os
import re
import subprocess
import threading
from contextlib import contextmanager

import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
from rerun.chunk import RrdReader

from knee_contact_ros.model.types import ContactState, Fidelity, Status
from knee_contact_ros.parameters.files import load_parameters
from scripts.make_layouts import COLOURS, JOINTS, LANES, PLOTS, STATES
from scripts.make_rerun_blueprint import APPLICATION, TIMELINE, application_of, blueprint
from tests.helpers.offline import solve
from tests.helpers.viewer import RERUN, pixels_of, rendered, wait_for

PEAK = 2_430_000_000


@pytest.fixture(scope="module")
def recording(right_bag, tmp_path_factory):
    """The right leg's gait in an osteoarthritic knee, whose name Rerun does not take as it is."""
    path = tmp_path_factory.mktemp("direct") / "gait 2354.right.mcap"
    parameters = load_parameters(["osteoarthritis", "mri_femur"])
    solve(right_bag, parameters, path)
    return path


@pytest.fixture(scope="module")
def shipped(config):
    """The blueprint as it is installed."""
    return config / "rerun" / "knee_contact.rbl"


def rerun(*arguments):
    """What a command of Rerun writes to standard output."""
    return subprocess.run([RERUN, *arguments], check=True, capture_output=True).stdout


@contextmanager
def piped(content, folder):
    """A pipe that gives the content, as a shell's `<(...)` does."""
    pipe = folder / "pipe"
    os.mkfifo(pipe)
    thread = threading.Thread(target=pipe.write_bytes, args=[content], daemon=True)
    thread.start()
    yield pipe
    thread.join(timeout=10.0)
    pipe.unlink()


def content(blueprint):
    """What a blueprint says, without its random names."""
    (store,) = RrdReader(blueprint).blueprints()
    found = set()
    for chunk in RrdReader(blueprint).stream(store=store):
        batch = chunk.to_record_batch()
        for name in set(batch.schema.names) - {
            "rerun.controls.RowId",
            "log_time",
            "log_tick",
            "blueprint",
        }:
            if name not in (
                "ActiveVisualizers:instruction_ids",
                "ViewportBlueprint:root_container",
            ):
                said = f"{chunk.entity_path} {name} {batch.column(name).to_pylist()}"
                found.add(re.sub(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", "...", said))
    return found


def test_the_shipped_blueprint_is_what_the_module_makes(shipped, tmp_path):
    blueprint().save(APPLICATION, tmp_path / "new.rbl")
    assert content(shipped) == content(tmp_path / "new.rbl"), (
        "make it again: python -m scripts.make_rerun_blueprint"
    )
    assert RrdReader(shipped).blueprints()[0].application_id == APPLICATION


def seen(screen):
    """Every view shows every one of its curves, or lanes, and Rerun has nothing to complain of."""
    # The blueprint is a file of its own: until it has come, the viewer shows a layout of its own making
    wait_for(lambda: len(screen.views()) == len(PLOTS) + 2, "the views of the blueprint")
    screen.set_time(TIMELINE, PEAK)
    assert screen.complaints() == []
    for plot in PLOTS:
        picture = screen.picture(plot.headline)
        for curve in plot.curves:
            # A line across the view has a pixel in each of its 800 columns; edges are blended, and curves cross.
            assert pixels_of(picture, COLOURS[curve.colour]) > picture.shape[1] / 8, (
                plot.title,
                curve.name,
            )
    lanes = screen.picture(STATES)
    for word in (ContactState.CARTILAGE, ContactState.BONE):
        assert darkened(lanes, LANES[0].colours[word]) > 1000
    assert darkened(lanes, LANES[1].colours[Fidelity.DYNAMIC]) > 1000
    assert darkened(lanes, LANES[2].colours[Status.OK]) > 1000
    joints = screen.picture(JOINTS)
    assert (joints.max(axis=2) > 100).sum() > joints.shape[1] / 2


def darkened(picture, colour):
    """How many pixels have a colour in the view of states, which takes a fifth of its light away."""
    return pixels_of(picture, (*(round(0.785 * part) for part in COLOURS[colour]),), within=3)


def test_opened_directly_with_the_shipped_blueprint(recording, shipped, tmp_path):
    routed = rerun("rrd", "route", "--application-id", application_of(recording), shipped)
    with piped(routed, tmp_path) as blueprint, rendered(recording, blueprint) as screen:
        seen(screen)
