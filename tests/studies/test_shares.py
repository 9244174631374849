"""The fits behind the shipped share find a known share again."""

import numpy as np
import pytest

from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.parameters.curves import read_share_table
from studies.validation.shares import (
    Curve,
    Trial,
    constant,
    fit_curve,
    fit_table,
    share_csv,
    spacing,
)

TRUE = ShareTable(
    np.radians([-10.0, 0.0, 10.0, 20.0, 40.0, 70.0]),
    np.array([0.0, 0.6, 1.2, 1.8, 2.4]),
    0.5 + 0.4 * np.sin(np.arange(30.0)).reshape(6, 5),
)
SPACING = 0.08
"""Spacing [m] of the compartments whose moments balance the shares"""


def trial_of(table, seed, number=4000):
    """A trial with a table's shares at random angles and loads."""
    random = np.random.default_rng(seed)
    flexion = np.radians(random.uniform(-10.0, 70.0, number))
    load = random.uniform(0.0, 2.4, number)
    medial = MeasuredShare(table, 1.0).share_at(load, flexion) * load
    return Trial(flexion, load, medial, SPACING * (0.5 * load - medial))


def test_a_table_its_file_and_the_spacing_are_found_again():
    trials = [trial_of(TRUE, 1), trial_of(TRUE, 2)]
    found = fit_table(trials, smoothing=1e-12)
    read = read_share_table("share.csv", share_csv(found, ["Source: made up"]))
    for table, tolerance in ((found, 1e-5), (read, 1e-4)):
        np.testing.assert_allclose(table.flexion, TRUE.flexion, atol=1e-6)
        np.testing.assert_array_equal(table.load, TRUE.load)
        # Without a load a share divides nothing, so the first column is not determined.
        np.testing.assert_allclose(table.share[:, 1:], TRUE.share[:, 1:], atol=tolerance)
    assert spacing(trials) == pytest.approx(SPACING)
    assert np.isnan(spacing([trials[0]._replace(moment=np.full(4000, np.nan))]))


def test_shares_stay_within_0_and_1_and_neighbours_fill_in_where_nothing_was_measured():
    trial = trial_of(TRUE, 4)
    medial = np.where(trial.flexion > 0.5, -0.05, 1.05) * trial.load
    share = fit_table([trial._replace(medial=medial)], 1e-3).share
    assert (share.min(), share.max()) == (0.0, 1.0)
    seen = (trial.load < 1.2) | (trial.flexion < 0.3)
    share = fit_table([Trial(*(column[seen] for column in trial))], 1e-3).share
    assert share[-1, -1] == pytest.approx(0.5 * (share[-2, -1] + share[-1, -2]), abs=1e-6)


def test_a_curve_and_a_constant_are_found_again():
    curve = Curve(0.7, 0.8)
    # The written curve is a table with steps of 0.1 body weights.
    assert fit_curve([trial_of(curve.table, 1, 500)]) == pytest.approx(curve, rel=0.01)
    flat = ShareTable(TRUE.flexion, TRUE.load, np.full((6, 5), 0.6))
    assert constant([trial_of(flat, 1), trial_of(flat, 2)]) == pytest.approx(0.6)
