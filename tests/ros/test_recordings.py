"""The node's recordings: in several files, in memory until asked for, and in a folder that vanishes."""

from __future__ import annotations

import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np

from knee_contact_ros.bags.provenance import Change, read_provenance
from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.model.types import FLAT, TOLD, Status
from knee_contact_ros.offline.solve import solve
from tests.helpers.sinks import wait_until
from tests.ros.conftest import Peer, Start, trigger
from tests.ros.test_outputs import stamps, walk


def test_each_recording_may_have_a_folder_of_its_own(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """So `metadata.yaml` of one life, or of one start of a recording, names all files of that one."""
    node = start_node("-p", f'record.path:="{tmp_path}/{{stamp}}/knee.mcap"', "-p", "pairing.wait:=0.2")
    peer.wait_for_node()
    walk(peer, 0, 20)
    assert trigger(peer, "stop_recording")[0]
    peer.spin(1.1)  # names go by the second
    begun = trigger(peer, "start_recording")
    walk(peer, 20, 20)
    assert node.stop()[0] == 0
    first, second = sorted(tmp_path.iterdir())
    for folder, numbers in ((first, range(20)), (second, range(20, 40))):
        assert re.fullmatch(r"\d{4}(_\d\d){2}-\d\d(_\d\d){2}", folder.name)
        assert stamps(folder) == list(numbers)
    assert begun == (True, f"recording to {second / 'knee.mcap'}")


def test_a_snapshot_is_a_complete_recording_of_the_last_seconds(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """Without a recorder: what a ring in memory holds, with parameters and resets, is solved again to the same bits."""
    given = ["-p", f"record.path:={tmp_path / 'knee.mcap'}", "-p", "record.snapshot:=0.5", "-p", "pairing.wait:=5.0"]
    node = start_node(*given)
    peer.wait_for_node()
    assert trigger(peer, "stop_recording")[0]
    save = partial(trigger, peer, "save_snapshot")
    saved, reason = save()
    assert not saved
    assert "there is nothing to save" in reason
    walk(peer, 0, 300)
    peer.wait_until(lambda: len(peer.contacts) == 300)
    assert save()[1] == f"{tmp_path / 'knee_snapshot.mcap'} will be complete in a moment: 100 answers, 0.495 s"
    wait_until((tmp_path / "knee_snapshot.mcap").exists)
    assert trigger(peer, "reset")[0]
    walk(peer, 300, 40)
    peer.wait_until(lambda: len(peer.contacts) == 340)
    assert save()[1].startswith(f"{tmp_path / 'knee_snapshot_1.mcap'} ")
    walk(peer, 100, 40)  # the clock is set back
    peer.wait_until(lambda: len(peer.contacts) == 380)
    third = [save()]
    wait_until(lambda: third[-1][0] or third.append(save()))  # once the one before is open
    assert third[-1][1].endswith("moment: 101 answers, 0.495 s")
    assert "is there already" not in node.stop()[1]  # the answers have told the names
    assert stamps(tmp_path / "knee_snapshot_2.mcap") == [*range(279, 340), *range(100, 140)]
    assert stamps(tmp_path / "knee_snapshot.mcap") == list(range(200, 300))
    assert stamps(tmp_path / "knee_snapshot_1.mcap") == list(range(240, 340))
    how = read_provenance(tmp_path / "knee_snapshot_1.mcap")
    assert how is not None
    assert (how.ticks_before, how.changes) == (240, (Change(60, None),))
    solve(tmp_path / "knee_snapshot_1.mcap", how, tmp_path / "again.mcap", lambda *_: None)
    live, again = (read_answers(tmp_path / name) for name in ("knee_snapshot_1.mcap", "again.mcap"))
    assert np.array_equal(live[60:].view(FLAT)[list(TOLD)], again[60:].view(FLAT)[list(TOLD)])  # from the reset on
    sure = again["status"] & Status.NOT_CONVERGED == 0  # the others come from a rest that there was not
    assert not sure[0]
    assert sure[60:].all()
    assert np.abs(live["penetration_depth"] - again["penetration_depth"])[sure].max() < 1e-6


def test_a_recording_whose_folder_is_removed_ends_and_not_the_node(
    peer: Peer, start_node: Start, tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    node = start_node("-p", f"record.path:={folder}/knee.mcap")
    peer.wait_for_node()
    wait_until((folder / "knee.mcap.partial").exists)
    walk(peer, 0, 20)
    shutil.rmtree(folder)
    peer.wait_until(lambda: "was removed" in peer.problems.get("knee_contact: recorder", ""))
    walk(peer, 20, 20)
    code, said = node.stop()
    assert code == 0
    words = f"recording {folder}/knee.mcap stopped: its file or folder was removed while it was written"
    assert said.count(words) == 1
    assert "Traceback" not in said
    assert "40 ticks" in said
    assert not folder.exists()
