"""Where the commands write, and what they refuse to."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main

FIT_SHARE = ["fit-share", "--trial", "a.csv", "--axial", "a", "--medial", "a", "--flexion", "a", "--body-weight", "700"]


MISSING = "there is no folder typo; make it first"
REFUSED: list[tuple[list[str], str]] = [
    (["solve", "{bag}", "--output", "typo/out.mcap"], MISSING),
    (["estimate-load", "{bag}", "--output", "typo/out.mcap"], MISSING),
    (["recover", "{file}", "typo/out.mcap"], MISSING),
    (["view", "{bag}", "--save", "typo/out.rrd"], MISSING),
    (["report", "{bag}", "--output", "typo/report"], MISSING),
    (["demo", "--output", "typo/demo"], MISSING),
    (["fit-profile", "{file}", "--slice", "auto", "--output", "typo/out.csv"], MISSING),
    ([*FIT_SHARE, "--output", "typo/share.csv"], MISSING),
    (["calibrate", "trial.csv", "--free", "contact.stiffness", "--output", "typo/fitted.yaml"], MISSING),
    (["import-csv", "cells.csv", "--map", "map.yaml", "--output", "typo/bag"], MISSING),
    (["align", "cells.csv", "--map", "map.yaml", "--output", "typo/align.yaml"], MISSING),
    (["import-opensim", "--side", "right", "--kinematics", "q", "--reactions", "r", "--output", "typo/bag"], MISSING),
    (["trade", "{bag}", "--picture", "typo/trade.png"], MISSING),
    (["solve", "{bag}", "--output", "out.csv"], "--output out.csv: its name must end with .mcap"),
    (["estimate-load", "{bag}", "--output", "out.db3"], "--output out.db3: its name must end with .mcap"),
    (["recover", "{file}", "out"], "output out: its name must end with .mcap"),
    (["view", "{bag}", "--save", "x.png"], "--save x.png: its name must end with .rrd"),
    (["trade", "{bag}", "--picture", "x.pdf"], "--picture x.pdf: its name must end with .png"),
    (["fit-profile", "{file}", "--slice", "0", "--output", "x.yaml"], "--output x.yaml: its name must end with .csv"),
    ([*FIT_SHARE, "--output", "x.yaml"], "--output x.yaml: its name must end with .csv"),
]


@pytest.mark.parametrize(("arguments", "says"), REFUSED)
def test_a_misspelt_folder_and_a_wrong_ending_are_refused(
    arguments: list[str], says: str, right_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    file = right_bag / "gait2354_right_0.mcap"
    assert main([argument.format(bag=right_bag, file=file) for argument in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("knee-contact: ")
    assert said.endswith(f"{says}\n")
    assert not list(tmp_path.iterdir())


def test_solve_leaves_a_file_and_nothing_beside(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two in one folder are two recordings: of the folder none is taken, and both are named."""
    for name in ("a", "b"):
        assert main(["solve", str(right_bag), "--output", str(tmp_path / f"{name}.mcap")]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]
    assert main(["solve", str(tmp_path / "a.mcap"), "--output", str(tmp_path / "b.mcap")]) == 2
    assert (
        capsys.readouterr().err
        == f"knee-contact: {tmp_path / 'b.mcap'} exists already; choose another name, or --overwrite\n"
    )
    assert main(["solve", str(tmp_path), "--output", str(tmp_path / "c.mcap")]) == 2
    assert capsys.readouterr().err == (
        f"knee-contact: {tmp_path} has more than one recording, and no usable metadata.yaml that names one; "
        "give one of these files: a.mcap, b.mcap\n"
    )


def test_the_other_recordings_of_a_bags_folder_are_named(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "bag"
    shutil.copytree(right_bag, folder)
    shutil.copy(folder / "gait2354_right_0.mcap", folder / "later.mcap")
    assert main(["solve", str(folder), "--output", str(tmp_path / "out.mcap")]) == 0
    told = "only gait2354_right_0.mcap is read; to read later.mcap, give it as a file\n"
    assert capsys.readouterr().err == f"knee-contact: warning: {folder}: {told}"
