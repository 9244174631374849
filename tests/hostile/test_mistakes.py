"""Mistakes of newcomers, through every command that takes their numbers: refused, or told with the likely cause.

What is right is not warned about. tests/ros/test_streams.py walks through the live node, and
tests/lab/profiles/test_refusals.py has those with surfaces.
"""

import re
from collections.abc import Callable

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.gait_bag import ImportedGait, Signal, write_bag
from tests.lab.opensim.storages import write_model, write_storage
from tests.lab.trials import write_csv
from tests.model.test_inputs import Columns, gait

WEIGHT = 72.6 * 9.80665
Change = Callable[..., Columns]


def by_csv(folder, time, angle, load):
    """Import a table in degrees and N."""
    write_csv(folder / "t.csv", {"t": time, "a": np.degrees(angle), "f": load})
    text = "time: {{column: t}}\nangle: {{column: a, unit: deg}}\nload: {{column: f, unit: N}}\nbody_weight: {}\n"
    (folder / "map.yaml").write_text(text.format(WEIGHT))
    return ["import-csv", "t.csv", "--map=map.yaml", "--output=bag"]


def by_opensim(folder, time, angle, load):
    """Import results of OpenSim, whose flexion is negative."""
    write_model(folder / "m.osim")
    write_storage(folder / "q.mot", time, {"knee_angle_r": -np.degrees(angle)}, "yes")
    stem = "walker_knee_r_on_tibia_r_in_tibia_r_"
    columns = {
        stem + axis: (0.0 if axis != "fy" else -1.0) * load
        for axis in ("fx", "fy", "fz", "mx", "my", "mz")
    }
    write_storage(folder / "jr.sto", time, columns, "no")
    files = ["--kinematics=q.mot", "--reactions=jr.sto", "--model=m.osim"]
    return ["import-opensim", *files, "--side=right", "--output=bag"]


def by_bag(folder, time, angle, load, axis=1):
    """Solve a bag of somebody's own."""
    stamps, wrench = np.rint(1e9 * time).astype(np.int64), np.zeros((len(time), 6))
    wrench[:, axis] = -load
    angles = Signal(stamps, angle[:, None]).with_rate()
    write_bag(
        ImportedGait("right", {"knee": angles}, {"load": Signal(stamps, wrench)}, {}, []),
        folder / "own",
        {},
    )
    return ["solve", "own", "-p", f"body_weight:={WEIGHT}", "--output=out.mcap"]


def upright(folder, time, angle, load):
    """Solve a bag whose forces have z up, as robots have it."""
    return by_bag(folder, time, angle, load, axis=2)


def by_insole(folder, time, angle, load):
    """Import an insole, which bears a third of what the knee does, for estimate-load."""
    command = by_csv(folder, time, angle, load / 3.0)
    text = (folder / "map.yaml").read_text()
    (folder / "map.yaml").write_text(text.replace("load:", "ground_force:"))
    return command


ANGLES: dict[str, tuple[Change, str]] = {
    "degrees for radians": (
        lambda t, q, f: (t, np.degrees(q), f),
        "degrees|range of motion|beyond",
    ),
    "an offset of 5 rad": (lambda t, q, f: (t, q + 5.0, f), "offset|angle-unit|included|rad"),
    "the sign": (lambda t, q, f: (t, -q - 0.6, f), "sign"),
    "the included angle": (lambda t, q, f: (t, np.pi - q, f), "included angle|sign"),
    "columns swapped": (
        lambda t, q, f: (t, f, q),
        "range of motion|beyond|must not exceed|angle-unit",
    ),
}
TIMES: dict[str, tuple[Change, str]] = {
    "milliseconds": (lambda t, q, f: (1e3 * t, q, f), "milliseconds"),
}
LOADS: dict[str, tuple[Change, str]] = {
    "no load": (lambda t, q, f: (t, q, 0.0 * f), "throughout|the peak"),
    "the other sign": (lambda t, q, f: (t, q, -f), "pulls|negative throughout"),
    "kN": (lambda t, q, f: (t, q, f / 1e3), "kN|the peak"),
    "body weights": (lambda t, q, f: (t, q, f / WEIGHT), "BW|body weights|must be in N"),
    "percent of body weight": (
        lambda t, q, f: (t, q, f / (0.01 * WEIGHT)),
        "%BW|percent|body weights",
    ),
    "a spike": (lambda t, q, f: (t, q, np.where(t == t[50], 41e3, f)), "spike"),
}
OF_GAIT: dict[str, tuple[Change, str]] = {
    "pounds": (lambda t, q, f: (t, q, f / 4.448), "lbf|body weights"),
    "radians for degrees": (lambda t, q, f: (t, np.radians(q), f), "range of motion|like rad"),
    "mN": (lambda t, q, f: (t, q, 1e3 * f), "spike|load.unit"),
    "kilograms": (lambda t, q, f: (t, q, f / 9.80665), "kgf|body weights|must be in N"),
    "an encoder": (lambda t, q, f: (t, q - 1.6, f), "offset|sign"),
    "a loose contact": (
        lambda t, q, f: (t, np.where(t > t[200], q + 0.9, q), f),
        "the step at|included",
    ),
}
GROUND: dict[str, tuple[Change, str]] = {
    "kN": (lambda t, q, f: (t, q, f / 1e3), "must be in N"),
    "upside down": (lambda t, q, f: (t, q, -f), "upwards"),
    "percent of body weight": (lambda t, q, f: (t, q, f / (0.01 * WEIGHT)), "must be in N"),
    "body weights": (lambda t, q, f: (t, q, f / WEIGHT), "must be in N"),
    "pounds": (lambda t, q, f: (t, q, f / 4.448), "lbf"),
    "a scale of 10": (lambda t, q, f: (t, q, 10.0 * f), "body weights, plausible"),
}
OPENSIM_KNOWS = {"the sign", "radians for degrees", "an encoder", "degrees for radians"}
"""What OpenSim's header or importer finds out by itself, or which its files hold otherwise; see test_results"""
WAYS = {
    by_csv: ANGLES | TIMES | LOADS | OF_GAIT,
    by_opensim: {
        name: each
        for name, each in (ANGLES | TIMES | LOADS | OF_GAIT).items()
        if name not in OPENSIM_KNOWS
    }
    | {
        "the other sign": (
            LOADS["the other sign"][0],
            "pulls .* force on the tibia, and not on the femur",
        )
    },
    by_bag: {
        name: each for name, each in (ANGLES | TIMES | LOADS).items() if name != "columns swapped"
    },
    upright: {"z up": (lambda *columns: columns, "force.z carries .*: is z up")},
    by_insole: ANGLES | TIMES | GROUND,
}
MISTAKES = [(way, name) for way, mistakes in WAYS.items() for name in mistakes]


@pytest.mark.parametrize(
    ("way", "name"), MISTAKES, ids=lambda each: getattr(each, "__name__", each)
)
def test_a_mistake_is_reported(
    way,
    name,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    change, words = WAYS[way][name]
    code = main(way(tmp_path, *change(*gait())))
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(words, said), said
    assert code == 2 or way in (by_bag, upright)


UNUSED = "contact.layer_depth"
WITHOUT_EFFECT = f"{UNUSED} has no effect under contact.law kelvin_voigt"


def by_option(folder, bag):
    return ["solve", bag, "-p", f"{UNUSED}:=1e-3", "--output=out.mcap"]


def by_file(folder, bag):
    lines = ["/**/knee_contact:", "  ros__parameters:", f"    {UNUSED}: 1.0e-3"]
    (folder / "knee.yaml").write_text("\n".join(lines))
    return ["solve", bag, "--params=knee.yaml", "--output=out.mcap"]


def by_sweep(folder, bag):
    pytest.importorskip("pyarrow", reason="needs the extra lab")
    (folder / "study.yaml").write_text(f"bags: [{bag}]\ngrid:\n  {UNUSED}: [4.0e-4, 1.0e-3]\n")
    return ["sweep", "study.yaml", "--workers=1", "--output=cases"]


@pytest.mark.parametrize("way", [by_option, by_file, by_sweep])
def test_a_parameter_that_the_law_does_not_use_is_named_once(
    way, right_bag, tmp_path, monkeypatch, capsys
):
    """tests/ros/test_streams.py has the live node."""
    monkeypatch.chdir(tmp_path)
    assert main(way(tmp_path, str(right_bag))) == 0
    assert capsys.readouterr().err.count(WITHOUT_EFFECT) == 1


@pytest.mark.parametrize(("mass", "told"), [("150", True), ("72.6", False)])
def test_the_mass_of_another_person_is_told_of_an_estimated_load(
    mass, told, right_bag, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    bag = right_bag.with_name("gait2354_right_sensors")
    command = ["estimate-load", str(bag), "-p", f"person.mass:={mass}", "--output=loads.mcap"]
    assert main(command) == 0
    said = capsys.readouterr().err
    words = "foot of a walking leg bears 0.50 body weights at most, and in walking it is 1.0 to 1.3: is the body's mass"
    assert said.count(words) == int(told)
    assert bool(said) == told


@pytest.mark.parametrize("way", [by_csv, by_opensim, by_bag, by_insole])
def test_right_input_has_no_warning(
    way,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    assert main(way(tmp_path, *gait())) == 0
    assert capsys.readouterr().err == ""
