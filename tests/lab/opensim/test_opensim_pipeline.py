"""OpenSim itself, on its gait2354 example: tests that need the package and the example, and say so where they lack."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.reader import INPUT_TYPES, read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.opensim.command import Files, read_knee
from knee_contact_ros.lab.opensim.pipeline import find_setups
from knee_contact_ros.lab.opensim.results import Settings
from tests.helpers.needs import needs_opensim
from tests.lab.opensim.test_import_opensim import origin

pytestmark = needs_opensim

BODY_WEIGHT = 711.96
"""[N] of the scaled subject"""


def command(folder: Path, output: Path, *more: str) -> list[str]:
    return ["import-opensim", "--setup", str(folder), "--side", "right", "--output", str(output), *more]


def test_scaling_kinematics_and_static_optimization_make_a_bag(
    example: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in example.rglob("*")}
    bag, work = tmp_path / "walk", tmp_path / "work"
    assert main(command(example, bag, "--steps", "scale,ik,static", "--work", str(work))) == 0
    said = capsys.readouterr().out
    for part in (
        "scaling",
        "static optimization",
        "residual moment",
        "reserve knee_angle_r",
        "marker error, the worst",
    ):
        assert part in said
    assert {path: path.stat().st_mtime_ns for path in example.rglob("*")} == before  # the user's folder is left alone
    assert sorted(path.name for path in tmp_path.glob("walk*")) == ["walk"]
    assert {path.name for path in (work / "logs").iterdir()} == {
        f"{step}.log" for step in ("scale", "ik", "static", "reactions", "dynamics")
    }
    record = origin(bag)
    assert record["source"].startswith("OpenSim 4.")
    assert "static: knee_contact_static.xml" in record["steps"]
    assert "residual force: peak" in record["quality"]
    forces = [m.message.wrench.force.y for m in read_bag(bag, INPUT_TYPES) if m.topic == "/joint_reaction_force"]
    # Single stance: the knee carries some two to four body weights.
    assert 1.5 * BODY_WEIGHT < -np.mean(forces) < 4.5 * BODY_WEIGHT


def test_set_up_files_in_folders_of_their_own(example: Path, tmp_path: Path) -> None:
    """As many keep them: each step's file in a folder, data beside; the same numbers come out."""
    together, apart = tmp_path / "together", tmp_path / "apart"
    assert main(command(example, together, "--steps", "scale,ik,static")) == 0
    for step, setup in (("ik", "subject01_Setup_IK.xml"), ("cmc", "subject01_Setup_CMC.xml")):
        (example / step).mkdir()
        text = (example / setup).read_text()
        for name in ("subject01_simbody.osim", "subject01_walk1.trc", "gait2354_CMC", "subject01_walk1_grf.xml"):
            text = text.replace(name, f"../{name}")
        text = text.replace(" subject01_walk1_ik.mot ", " ../ik/subject01_walk1_ik.mot ")
        (example / step / setup).write_text(text)
        (example / setup).unlink()
    setups = [example / name for name in ("subject01_Setup_Scale.xml", "ik/subject01_Setup_IK.xml")]
    more = [argument for path in setups for argument in ("--setup", str(path))]
    cmc = example / "cmc" / "subject01_Setup_CMC.xml"
    assert main(command(cmc, apart, *more, "--steps", "scale,ik,static")) == 0
    first, second = (
        [m.message.wrench.force.y for m in read_bag(bag, INPUT_TYPES) if m.topic == "/joint_reaction_force"]
        for bag in (together, apart)
    )
    assert first == pytest.approx(second, abs=1e-6)  # ten decimals, and the same program


def test_reactions_on_the_femur_are_those_on_the_tibia(example: Path, tmp_path: Path) -> None:
    """OpenSim's own answer to what we do with a reaction that acts on the femur."""
    work = tmp_path / "work"
    assert main(command(example, tmp_path / "walk", "--steps", "scale,ik,static", "--work", str(work))) == 0
    setup = work / "knee_contact_reactions.xml"
    for words in (("apply_on_bodies>child", "apply_on_bodies>parent"), ('name="knee_contact"', 'name="parent"')):
        setup.write_text(setup.read_text().replace(*words))
    script = f"import opensim; assert opensim.AnalyzeTool({str(setup)!r}).run()"
    subprocess.run([sys.executable, "-I", "-c", script], cwd=work, check=True, capture_output=True)
    results = work / "ResultsReactions"
    child, parent = (
        read_knee("right", Files(results / f"{name}_Kinematics_q.sto",
                                 results / f"{name}_JointReaction_ReactionLoads.sto"), Settings(angle_sign=-1))
        for name in ("knee_contact", "parent")
    )  # fmt: skip
    assert "Newton" in " ".join(parent.notes)
    assert "Newton" not in " ".join(child.notes)
    # Ten decimals in the files; the torque has 0.5 m times a force.
    assert parent.reactions.force == pytest.approx(child.reactions.force, abs=1e-7)
    assert parent.reactions.torque == pytest.approx(child.reactions.torque, abs=1e-7)


def test_a_step_that_fails_leaves_nothing_and_says_why(
    example: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (example / "subject01_walk1.trc").write_text("no markers")
    assert main(command(example, tmp_path / "walk", "--steps", "scale,ik,static")) == 2
    said = capsys.readouterr().err
    assert "OpenSim's ik (subject01_Setup_IK.xml) failed with code" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "walk").exists()


def test_interrupted_it_ends_its_step_and_leaves_nothing(example: Path, tmp_path: Path) -> None:
    output, work = tmp_path / "walk", tmp_path / "work"
    arguments = command(example, output, "--steps", "scale,ik,cmc", "--work", str(work))
    process = subprocess.Popen(
        [sys.executable, "-m", "knee_contact_ros.commands.main", *arguments], stderr=subprocess.PIPE
    )
    until = time.monotonic() + 120.0
    while not (work / "logs" / "cmc.log").exists():
        assert process.poll() is None
        assert time.monotonic() < until, "computed muscle control has not begun"
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert said.decode().split() == ["knee-contact:", "interrupted"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["example", "work"]
    assert str(work.resolve()) not in folders_of_processes()


def folders_of_processes() -> set[str]:
    """Working directories of all processes that we may look at."""
    found = set()
    for link in Path("/proc").glob("[0-9]*/cwd"):
        with suppress(OSError):
            found.add(str(link.readlink()))
    return found


def test_the_examples_set_up_files_are_recognised(reference_data: Path) -> None:
    assert list(find_setups([reference_data / "opensim_gait2354"])) == ["cmc", "ik", "rra", "scale"]
