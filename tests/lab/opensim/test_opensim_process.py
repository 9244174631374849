"""What a step's log tells: how far it is, and why it failed. The steps themselves are in test_opensim_pipeline.py."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.lab.opensim.pipeline import last_words, progress_of, read_setup, times_of


@pytest.mark.parametrize(
    ("line", "done"),
    [
        ("[info] CMC::computeControls, t = 0.9000000000000001", 250),
        ("[info] Frame 95 (t = 1.0):\t total squared error = 0.0136", 500),
        ("time = 1.1849 Performance = 47.7 Constraint violation = 2.1e-10", 962),
        ("[info] Loaded model subject01", 0),
        ("t = 0.2", 0),
        ("t = 7", 999),
        ("t = -", 0),
    ],
)
def test_the_last_time_in_the_log_is_how_far_it_is(tmp_path: Path, line: str, done: int) -> None:
    log = tmp_path / "step.log"
    log.write_text("x" * 10_000 + "\nt = 0.81\n" * (done > 0) + line + "\n")
    assert progress_of(log, (0.8, 1.2)) == (done, 1000)
    assert progress_of(log, (0.0, 0.0)) == (0, 1000)


def test_times_of_set_up_files(tmp_path: Path) -> None:
    path = tmp_path / "s.xml"
    for text, times in (
        ("<InverseKinematicsTool><time_range> 0.4 1.6</time_range></InverseKinematicsTool>", (0.4, 1.6)),
        ("<CMCTool><initial_time> 0.8 </initial_time><final_time>1.2</final_time></CMCTool>", (0.8, 1.2)),
        ("<CMCTool><initial_time> 0.8 </initial_time></CMCTool>", (0.0, 0.0)),
    ):
        path.write_text(f"<D>{text}</D>")
        setup = read_setup(path)
        assert setup is not None
        assert times_of(setup) == times


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("[info] a\n[error] no such marker\n[info] bye\n", "[error] no such marker"),
        ("[warning] Couldn't find file mesh.vtp: failed\nthe end\n\n", "the end"),
        ("", "it said nothing"),
    ],
)
def test_the_line_that_tells_of_a_failure(tmp_path: Path, log: str, words: str) -> None:
    (tmp_path / "l").write_text(log)
    assert last_words(tmp_path / "l") == words
