"""Results as JSON, and completion of the command line."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.commands.live import demo
from knee_contact_ros.commands.main import main
from knee_contact_ros.system.terminal import print_json
from tests import ROOT
from tests.system.test_other_systems import MAP, TRIAL


def printed(capsys, *words):
    """Run a command; return the only thing that it prints."""
    assert main([*map(str, words), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_solve_and_table_print_what_is_in_the_recording(right_bag, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    solved = printed(capsys, "solve", right_bag, "--output", out)
    answers = read_answers(out)
    assert solved["ticks"] == len(answers)
    assert solved["peaks"]["penetration_depth"]["penetration_depth"] == np.max(
        answers["penetration_depth"]
    )
    assert [peak["load"] for peak in solved["load_peaks"]] == pytest.approx(
        [1265.2, 1556.9, 1337.7, 1613.8], abs=0.05
    )  # as the table of the tutorial has them
    assert solved["refused"] == {}
    assert solved["warnings"] == []
    assert solved["files"] == {"Recording": str(out)}
    both = tmp_path / "both.mcap"
    compartments = printed(
        capsys, "solve", right_bag, "-p", "load.compartment:=both", "--output", both
    )
    assert compartments["lateral"]["ticks"] == len(answers)
    table = tmp_path / "out.csv"
    told = printed(capsys, "table", out, "--output", table)
    assert told == {"answers": {"/knee_contact": len(answers)}, "files": {"Table": str(table)}}


def test_other_results_are_json_too(right_bag, sensors_bag, tmp_path, capsys):
    load = printed(capsys, "estimate-load", sensors_bag, "--output", tmp_path / "load.mcap")
    assert load["largest"]["axial_force"] > load["mean_axial_force"] > 0.0
    file = next(right_bag.glob("*.mcap"))
    recovered = printed(capsys, "recover", file, tmp_path / "whole.mcap")
    assert recovered["unread_bytes"] == 0
    assert recovered["faults"] == []
    files = [ROOT / "examples" / "laboratory" / f"{name}.csv" for name in ("cells", "motion")]
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    words = "--map", tmp_path / "map.yaml", "--output", tmp_path / "align.yaml"
    aligned = printed(capsys, "align", *files, *words)
    assert aligned["rows"] > 100
    assert aligned["gain"]["half"] < 0.1
    trial = tmp_path / "trial.csv"
    trial.write_text(TRIAL, encoding="utf-8")
    words = "--free", "contact.stiffness", "--no-intervals", "--output", tmp_path / "fit.yaml"
    fitted = printed(capsys, "calibrate", trial, *words)
    assert fitted["values"]["contact.stiffness"] > 0.0
    assert fitted["files"] == {"Parameters": str(tmp_path / "fit.yaml")}
    pytest.importorskip("matplotlib", reason="needs the extra trade")
    traded = printed(capsys, "trade", right_bag, "--picture", tmp_path / "out.png")
    assert {each["level"] for each in traded["settings"]} == {"quasi_static", "dynamic"}
    assert traded["ticks"] == 387
    assert traded["advice"]


def test_what_has_no_number_is_null(capsys):
    print_json(bound=np.inf, values=np.array([1.5, np.nan]), path=Path("a"), flag=True)
    found = json.loads(capsys.readouterr().out)
    assert found == {"bound": None, "values": [1.5, None], "path": "a", "flag": True}


def test_the_table_of_the_demo_is_json_too():
    assert "--json" in {name for option in demo.params for name in option.opts}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands_and_options(shell):
    def asked(**variables):
        code = "from knee_contact_ros.commands.main import main; raise SystemExit(main())"
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | variables,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout

    script = asked(_KNEE_CONTACT_COMPLETE=f"{shell}_source")
    assert "knee-contact" in script
    assert f"_KNEE_CONTACT_COMPLETE={shell}_complete" in script
    for words, number, expected in (
        ("knee-contact sol", "1", "solve"),
        ("knee-contact solve --out", "2", "--output"),
    ):
        found = asked(
            _KNEE_CONTACT_COMPLETE=f"{shell}_complete",
            COMP_WORDS=words,
            COMP_CWORD=words.split()[-1] if shell == "fish" else number,
        )
        assert expected in found
