"""`knee-contact align`: offset, lag and gain that were put in are found, with intervals that hold them."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.align import aligned
from knee_contact_ros.lab.tables import TimeSeries
from knee_contact_ros.offline.notebooks import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.errors import UsageError
from tests.helpers.commands import run
from tests.lab.trials import DELAY, MAP, OFFSET, cells, flexion, write_csv, write_trial


def series(time, degrees):
    return TimeSeries(
        "angle", Path("a.csv"), "a", np.rint(1e9 * time).astype(np.int64), np.radians(degrees)
    )


def found(
    lag=0.0137,
    offset=-7.0,
    gain=1.0,
    noise=0.0,
    seconds=12.0,
    seed=0,
):
    """What is found of a sensor at 148 Hz that is off, against a reference at 100 Hz."""
    time, known = np.arange(0.0, seconds, 1.0 / 148.0), np.arange(0.0, seconds, 0.01)
    sensor = (
        gain * flexion(time - lag)
        - offset
        + noise * np.random.default_rng(seed).normal(size=len(time))
    )
    return aligned(series(time, sensor), series(known, flexion(known)), 0.25, 0.1)


@pytest.mark.parametrize(("lag", "gain"), [(-0.043, 1.0), (0.2, 1.0), (0.0137, 0.85)])
def test_what_was_put_in_is_found_to_a_fraction_of_a_sample(lag, gain):
    """A spline through 100 Hz follows a gait to 1e-4 of a degree; a wrong gain pulls at no lag."""
    got = found(lag, gain=gain)
    assert got.lag.value == pytest.approx(lag, abs=2e-5)
    assert got.gain.value == pytest.approx(gain, abs=1e-4)
    assert got.after[0] == pytest.approx(1.0, abs=1e-6)
    assert got.lag.half < 1e-4
    if gain == 1.0:
        assert math.degrees(got.offset.value) == pytest.approx(-7.0, abs=1e-3)


def test_intervals_hold_what_was_put_in_as_often_as_they_say():
    """95 % of 30: binomially 25 or more, but for one time in a hundred."""
    tries = [found(noise=2.0, seed=seed) for seed in range(30)]
    for name, right in (("lag", 0.0137), ("offset", math.radians(-7.0)), ("gain", 1.0)):
        bounds = [getattr(got, name).bounds for got in tries]
        held = sum(low <= right <= high for low, high in bounds)
        assert held >= 25, (name, held)
        widths = np.array([high - low for low, high in bounds])
        error = np.std([getattr(got, name).value for got in tries])
        assert 2.0 * 1.5 * error < np.median(widths) < 2.0 * 3.0 * error, (
            name
        )  # 1.96 if it were normal


def test_gaps_of_the_reference_do_not_count():
    time, known = np.arange(0.0, 12.0, 1.0 / 148.0), np.arange(0.0, 12.0, 0.01)
    known = known[(known < 4.0) | (known > 5.5)]
    got = aligned(
        series(time, flexion(time - 0.02) + 5.0), series(known, flexion(known)), 0.25, 0.1
    )
    assert got.lag.value == pytest.approx(0.02, abs=2e-5)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (
            lambda t: -flexion(t),
            r"correlate with r = .* but in opposite directions with 1\.00: is a sign turned\?",
        ),
        (
            lambda t: np.random.default_rng(1).normal(size=len(t)),
            "are both of one knee, in one time",
        ),
        (lambda t: flexion(t - 0.3), "fit best at the longest lag tried, 0.25 s|r = 0"),
        (
            lambda t: np.degrees(flexion(t - 0.02)),
            r"moves 57\.3 times as far as .*: are both units right\?",
        ),
        (None, "have 0 rows in common"),
    ],
)
def test_angles_that_do_not_go_together_are_refused(sensor, words):
    """Of a sensor, or of one that measured at another time."""
    time = np.arange(0.0, 10.0, 0.01)
    measured = series(time, sensor(time)) if sensor else series(time + 30.0, flexion(time))
    with pytest.raises(UsageError, match=words):
        aligned(measured, series(time, flexion(time)), 0.25, 0.1)


def test_the_command_writes_parameters_that_make_the_sensor_right(tmp_path, capsys):
    """Flexion of the answers, computed with them, is that of the motion capture; without, it is 12 degrees off."""
    moved, tray, map_file = write_trial(tmp_path, noise=0.5)
    overlay, bag = tmp_path / "align.yaml", tmp_path / "bag"
    files = f"{moved} {tray} --map {map_file}"
    assert run(f"align {files} --output {overlay}") == 0
    said = capsys.readouterr()
    assert "warning" not in said.err
    assert re.search(r"lag \[ms\] +2[01]\.\d ", said.out)
    assert f"\n\nParameters: {overlay}\n" in said.out
    parameters = load_parameters(overlay)
    assert math.degrees(parameters.knee.flexion_offset) == pytest.approx(OFFSET, abs=0.1)
    assert parameters.pairing.angle_delay == pytest.approx(DELAY, abs=1e-3)
    assert run(f"import-csv {files} --output {bag}") == 0
    answers = solve(bag, ["healthy.yaml", str(overlay)])
    inside = answers["stamp"] < 5.9e9  # behind are forces without an angle
    right = flexion(1e-9 * answers["stamp"][inside])
    error = np.degrees(answers["flexion_angle"][inside]) - right
    assert np.sqrt(np.mean(error**2)) < 0.6  # the noise
    raw = np.degrees(solve(bag)["flexion_angle"])
    assert np.sqrt(np.mean((raw - flexion(1e-9 * solve(bag)["stamp"])) ** 2)) > 11.0
    assert run(f"align {files} --output {overlay}") == 2
    assert "exists already" in capsys.readouterr().err


def test_the_command_warns_of_a_gain_and_names_the_scale_that_corrects_it(tmp_path, capsys):
    moved, tray, map_file = write_trial(tmp_path, noise=0.5)
    map_file.write_text(
        MAP.replace("goniometer_deg, unit: deg", "goniometer_deg, unit: deg, scale: 0.8")
    )
    assert run(f"align {moved} {tray} --map {map_file} --output {tmp_path}/align.yaml") == 0
    warning = re.search(r"angle\.scale ([0-9.]+) in the map", capsys.readouterr().err)
    assert float(warning[1]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("weight", "entries", "live"),
    [
        (1.0, "", None),
        (1.0, "offset: 10", (1.0, OFFSET)),
        (-1.0, "sign: -1", (-1.0, OFFSET)),
        (-1.0, "sign: -1, offset: 180", (-1.0, OFFSET)),
        (-1.0, "scale: -1", (-1.0, OFFSET)),
        (1.0 / 1.15, "scale: 1.15", ()),
    ],
)
def test_the_file_says_what_a_node_with_the_raw_sensor_needs(weight, entries, live, tmp_path):
    """Whatever the map does to the angle, a raw sensor that is `weight` times the goniometer needs the same offset."""
    moved, tray, map_file = write_trial(tmp_path)
    map_file.write_text(
        MAP.replace("goniometer_deg, unit: deg", f"goniometer_deg, unit: deg, {entries}")
    )
    write_csv(tray, {**cells(), "goniometer_deg": weight * cells()["goniometer_deg"]})
    overlay = tmp_path / "align.yaml"
    assert run(f"align {moved} {tray} --map {map_file} --output {overlay}") == 0
    text = overlay.read_text()
    said = re.search(r"live node.* knee.flexion_sign: (\S+), knee.flexion_offset: (\S+)\.\n", text)
    assert ("do not use this file for a live node" in text) == (live == ())
    assert bool(said) == bool(live)
    if said and live:
        sign, offset = map(float, said.groups())
        assert (sign, math.degrees(offset)) == (live[0], pytest.approx(live[1], abs=0.1))


def test_a_map_without_a_reference_is_refused(tmp_path, capsys):
    _, tray, map_file = write_trial(tmp_path)
    map_file.write_text("time: {column: time_s}\nangle: {column: goniometer_deg, unit: deg}\n")
    command = f"align {tray} --map {map_file} --output {tmp_path}/align.yaml"
    assert run(command) == 2
    assert "reference: is missing" in capsys.readouterr().err
    write_csv(
        tmp_path / "r.csv",
        {"time_s": np.arange(500) / 100.0, "knee_flexion_deg": 100.0 * np.arange(500.0)},
    )
    map_file.write_text(MAP)
    assert run(f"{command} {tmp_path}/r.csv") == 2
    assert "plausible is 0 to 180: is reference.unit right" in capsys.readouterr().err
