"""The page of validation says what the code gives, where the measurements are; the rules of its study by hand."""

from statistics import fmean

import numpy as np
import pytest
from click.testing import CliRunner

from tests import ROOT

pytest.importorskip("tabulate", reason="the studies' tables")

from benchmarks.report import save
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.joint_reaction.walking import MEASURED_LOADS
from knee_contact_ros.lab.calibrate.walk import CLOCK, DEVIATIONS, MASS, MEAN_FLEXION, ZERO
from knee_contact_ros.parameters.load_schema import PersonSection
from studies.validation.__main__ import main
from studies.validation.data import SENSOR_LEVELS, missed, near, runs, walks, with_medial
from studies.validation.minutes import mean_flexion, told
from studies.validation.movements import CYCLES, scores
from studies.validation.sections import COMMAND, TITLE, chosen, line_errors, sections
from studies.validation.split import CALLED, other_person, shipped
from studies.validation.split import missed as missed_by
from studies.validation.total import (
    CURVE,
    DEFAULT,
    FREE,
    OTHERS,
    SENSORS,
    clocks,
    errors_of,
    estimates,
    fitted,
    mean_loads,
    on_time,
    person_mean,
)

pytestmark = pytest.mark.xdist_group("validation")  # its estimates are made once
PAGE = ROOT / "docs" / "explanation" / "validation.md"
WORDS = 1600
PERSONS = {"JW GC1", "JW GC4", "PS GC5", "DM GC2"}
"""Persons and sessions of the page"""


@pytest.fixture(scope="module")
def measured(reference_data):
    found = walks(reference_data)
    if {walk.key for walk in found} != PERSONS:
        pytest.skip("the measurements of the instrumented knees are not on this machine")
    return found


@pytest.fixture(scope="module")
def found(measured):
    return estimates(measured)


def test_without_the_measurements_nothing_is_made(tmp_path):
    for arguments in ([], ["--data", str(tmp_path)]):
        result = CliRunner(env={"INSTRUMENTED_KNEE": ""}).invoke(
            main, [*arguments, "--folder", str(tmp_path)]
        )
        assert result.exit_code == 0
        assert "nothing is made" in result.output
    assert not list(tmp_path.iterdir())


def test_the_page_is_what_the_code_gives(measured, found, tmp_path):
    page = PAGE.read_text(encoding="utf-8")
    machine = page.splitlines()[2].split(" on ", 1)[1].rstrip(".")
    save(tmp_path / "page.md", TITLE, COMMAND, sections(measured, found), machine)
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == page
    assert sum(any(letter.isalnum() for letter in word) for word in page.split()) <= WORDS


def test_the_mean_of_sensors_and_curve_is_closer_than_either(measured, found):
    curve = person_mean(errors_of(chosen(found, "", CURVE)))
    for level in LOAD_LEVELS:
        shipped_error = person_mean(errors_of(chosen(found, level, OTHERS)))
        assert shipped_error < person_mean(errors_of(chosen(found, level, SENSORS))) - 0.02
        assert shipped_error < curve < person_mean(line_errors(measured))


def test_the_defaults_are_those_of_all_persons(measured):
    timed = on_time(measured, clocks(measured))
    together = fitted(timed, SENSOR_LEVELS, DEFAULT.moment_arm_scale)
    assert [getattr(PersonSection(), name) for name in FREE] == pytest.approx(together, abs=0.01)
    for shipped_load, load in zip(MEASURED_LOADS, mean_loads(timed), strict=True):
        assert shipped_load == pytest.approx(load, abs=0.005)  # it has two decimals


def test_the_mean_flexion_and_what_people_differ_by_are_those_of_all_persons(measured):
    for shipped_flexion, flexion in zip(MEAN_FLEXION, mean_flexion(measured), strict=True):
        assert shipped_flexion == pytest.approx(flexion, abs=0.0006)  # it has three decimals
    sessions = told(measured).values()
    for name, differences in (
        (ZERO, [each.offset for each in sessions]),
        (CLOCK, [each.delay for each in sessions]),
        (MASS, [each.weight - 1.0 for each in sessions]),
    ):
        found = np.sqrt(np.mean(np.square(differences)))
        assert 0.6 * DEVIATIONS[name] < found <= DEVIATIONS[name]  # a fifth walk widens one


def test_the_shipped_share_is_the_one_form_that_holds_for_the_other_person(
    measured,
):
    medial = with_medial(measured)
    missed = {
        form: fmean(errors.values()) for form, errors in missed_by(medial, other_person).items()
    }
    without_moment = list(CALLED)[:5]
    assert min(without_moment, key=missed.__getitem__) == "curve"
    assert missed["moment"] < missed["external"] < missed["curve"]
    assert (ROOT / "config" / "share_medial.csv").read_text(encoding="utf-8") == shipped(medial)[1]


def test_movements_without_constants_are_marked_and_walking_is_not():
    marked, f1 = scores()
    assert f1 >= 0.89
    assert all(part > 0.9 for name, part in marked.items() if not CYCLES[name].known)
    assert all(part < 0.1 for name, part in marked.items() if CYCLES[name].known)


def test_spikes_and_missing_plates_go_with_what_is_near_them():
    time = np.arange(200) * 0.01
    spikes = np.zeros(200, dtype=bool)
    spikes[50] = True
    assert runs(near(time, spikes)) == [(40, 61)]
    on_plate, bears = time < 0.6, ((time > 0.1) & (time < 0.7)) | (time > 1.0)
    assert runs(missed(time, on_plate, bears)) == [
        (91, 200)
    ]  # 0.1 s before 1.01 s; the first step is on the plate
    assert runs(missed(time, on_plate | (time > 1.2), bears)) == []
