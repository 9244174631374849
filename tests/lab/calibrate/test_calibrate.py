"""`knee_contact_ros.calibrate` on made data: the truth is found, or it is told why not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from knee_contact_ros import calibrate, load_model
from tests.lab.calibrate.trials import FINE, START, TRUE, answers, inputs, trial

FREE = ["contact.stiffness", "contact.damping"]


def fitted(table: Any, free: Any = FREE, values: dict[str, Any] | None = None, **options: Any) -> Any:
    return calibrate(table, "healthy", free, {**START, **(values or {})}, compiled=True, **options)


def test_the_truth_is_found_within_its_intervals_and_with_its_noise() -> None:
    # One in twenty may fail; P(more than 3 of 20) is 1.6 %, and the seeds are fixed.
    missed = 0
    for seed in range(10):
        found = fitted(trial(seed), starts=1)
        for name in FREE:
            low, high, *opened = found.intervals[name]
            assert low < found.values[name] < high
            assert opened == [False, False]
            missed += not low <= TRUE[name] <= high
        assert found.noise["penetration_depth"] == pytest.approx(3e-6, rel=0.3)  # 5 deviations: 1/sqrt(2 x 198)
        assert found.warnings == ()
    assert missed <= 3


def test_without_noise_the_truth_itself_is_found_and_what_is_predicted_is_what_was_measured() -> None:
    table = trial(0, noise=0.0)
    found = fitted(table, with_intervals=False)
    assert found.values["contact.stiffness"] == pytest.approx(7.0e7, rel=1e-4)  # depths err by 1e-9 of 7e-4 m
    assert found.values["contact.damping"] == pytest.approx(4000.0, rel=1e-2)
    np.testing.assert_allclose(found.predicted.penetration_depth, table["penetration_depth"], atol=5e-9)
    assert found.intervals == {}
    assert np.abs(found.residuals["penetration_depth"]).max() < 5e-9


def test_what_is_fitted_is_taken_by_a_model() -> None:
    found = fitted(trial(1), with_intervals=False)
    model = load_model(["healthy", FINE, found.to_parameters()], compiled=True)
    depth = model.run(*inputs()).penetration_depth
    np.testing.assert_allclose(depth, found.predicted.penetration_depth, atol=5e-9)
    assert repr(found).startswith("<Calibration: contact.stiffness=")


def test_a_wider_level_has_wider_intervals_and_a_known_noise_is_taken() -> None:
    table, true = trial(2), {"contact.damping": 4000.0}
    half, most = (fitted(table, ["contact.stiffness"], true, level=level).intervals["contact.stiffness"]
                  for level in (0.5, 0.99))  # fmt: skip
    # Quantiles of the normal distribution: 0.674 and 2.576; of Student's with 199 degrees they differ by 1 %
    assert (most.high - most.low) / (half.high - half.low) == pytest.approx(2.576 / 0.6745, rel=0.02)
    told = fitted(table, ["contact.stiffness"], true, sigma={"penetration_depth": 3e-5})
    assert told.noise == {"penetration_depth": 3e-5}
    assert any("times the noise given" in warning and "too wide" in warning for warning in told.warnings)
    told = fitted(table, ["contact.stiffness"], true, sigma={"penetration_depth": 1e-6})
    assert any("times the noise given" in warning and "too narrow" in warning for warning in told.warnings)


def test_outliers_move_a_robust_fit_less() -> None:
    table = trial(3)
    table["penetration_depth"][::25] += 2e-4
    off = {loss: abs(fitted(table, with_intervals=False, loss=loss).values["contact.stiffness"] / 7.0e7 - 1.0)
           for loss in ("linear", "soft_l1", "huber")}  # fmt: skip
    assert max(off["soft_l1"], off["huber"]) < 0.1 * off["linear"]
    table = trial(3)
    table["penetration_depth"][::25] += 2e-4 * (-1.0) ** np.arange(8)  # on one side alone they would still shift it
    low, high, *_ = fitted(table, ["contact.stiffness"], {"contact.damping": 4000.0}, loss="huber").intervals[
        "contact.stiffness"
    ]
    assert low < 7.0e7 < high


def test_force_depth_and_gap_are_measured_where_they_are() -> None:
    load = {"least": -60.0, "most": 700.0}  # it parts and lands
    true = answers(**load)
    time, angle, force = inputs(**load)
    random = np.random.default_rng(4)
    noise = random.standard_normal((3, len(time)))
    depth = np.where(true.gap > 0.0, np.nan, true.penetration_depth + 3e-6 * noise[0])
    gap = np.where(true.gap > 0.0, true.gap + 1e-5 * noise[1], np.nan)
    contact = np.where(np.arange(len(time)) % 2, true.contact_force + 4.0 * noise[2], np.nan)
    table = {"time": time, "flexion_angle": angle, "load": force, "penetration_depth": depth, "gap": gap,
             "contact_force": contact}  # fmt: skip
    found = fitted(table, [*FREE, "femur.mass"])
    assert np.isfinite(found.residuals["gap"]).sum() == (true.gap > 0.0).sum() > 10
    for name, value in (TRUE | {"femur.mass": 9.3014}).items():
        if name in found.intervals:
            assert found.intervals[name].low < value < found.intervals[name].high
    assert found.noise["contact_force"] == pytest.approx(4.0, rel=0.4)


def test_a_share_is_that_of_the_axial_load() -> None:
    table = trial(5)
    table["axial_load"] = table.pop("load") / 0.6
    found = fitted(table, ["load.share"], TRUE)
    low, high, *_ = found.intervals["load.share"]
    assert low < 0.6 < high
    assert high - low < 0.01


def test_a_radius_is_found_where_the_height_is_prescribed_and_a_surface_made_anew() -> None:
    time, angle, load = inputs()
    height = 0.0335 - 2e-4 * (0.5 - 0.5 * np.cos(8.0 * np.pi * time))
    true = load_model({**TRUE, "drive": "displacement", "femur.radius": 0.0338}, compiled=True)
    noise = np.random.default_rng(6).standard_normal(len(time))
    force = true.run(time, angle, load, height).contact_force + 2.0 * noise
    table = {"time": time, "flexion_angle": angle, "femoral_height": height, "contact_force": force}
    found = calibrate(table, "healthy", {"femur.radius": (0.0335, 0.0345)},
                      {**TRUE, "drive": "displacement"}, compiled=True)  # fmt: skip
    low, high, *_ = found.intervals["femur.radius"]
    assert low < 0.0338 < high


def test_a_trade_off_is_told_and_how() -> None:
    narrow = fitted(trial(7, least=690.0, most=710.0), ["contact.stiffness", "contact.exponent"], TRUE)
    assert any("contact.stiffness and contact.exponent trade off (correlation 1.0000)" in warning
               and "cannot tell them apart" in warning for warning in narrow.warnings)  # fmt: skip
    assert narrow.correlation[0, 1] > 0.999
    wide = fitted(trial(7, least=20.0, most=2000.0), ["contact.stiffness", "contact.exponent"], TRUE)
    assert not any("cannot tell them apart" in warning for warning in wide.warnings)
    assert any("never one of them alone" in warning for warning in wide.warnings)


def test_what_the_law_itself_does_not_tell_apart_is_told_with_its_direction() -> None:
    """The elastic foundation knows modulus over thickness alone (Johnson 1985, Sec. 4.3)."""
    time, angle, load = inputs()
    values = {"fidelity.level": "quasi_static", "contact.law": "elastic_foundation"}
    depth = load_model(values).run(time[:40], angle[:40], load[:40]).penetration_depth
    depth += 3e-6 * np.random.default_rng(11).standard_normal(40)
    table = {"time": time[:40], "flexion_angle": angle[:40], "load": load[:40], "penetration_depth": depth}
    free = ["contact.youngs_modulus", "contact.foundation_thickness"]
    found = calibrate(table, values, free, with_intervals=False, starts=1, compiled=False)
    (warning,) = (each for each in found.warnings if "trade off" in each)
    assert "contact.youngs_modulus 10 % up with contact.foundation_thickness 10 % up leaves nearly the same" in warning
    assert "cannot tell them apart" in warning


def test_an_interval_without_an_end_is_told() -> None:
    slow = trial(8, noise=2e-5)
    found = fitted(slow, {"contact.stiffness": None, "contact.damping": (1.0, 20000.0)}, {"contact.damping": 4000.0})
    low, high, *_ = found.intervals["contact.damping"]
    assert low < 4000.0 < high
    noisier = fitted(trial(8, noise=3e-4), {"contact.damping": (1.0, 6000.0)}, TRUE)
    assert noisier.intervals["contact.damping"][2:] == (True, True)
    assert any("contact.damping is not bounded by the data below or above" in each for each in noisier.warnings)


def test_what_a_model_cannot_describe_is_told() -> None:
    """Residuals that are alike from sample to sample: the damping is held at a wrong value."""
    found = fitted(trial(9), ["contact.stiffness"], {"contact.damping": 30000.0})
    assert any("alike from sample to sample" in warning for warning in found.warnings)
    at_end = fitted(trial(9), {"contact.stiffness": (8e7, 1e8)}, {"contact.damping": 4000.0})
    assert any("the fit lies at the end of its range, 8e+07" in warning for warning in at_end.warnings)


def test_the_same_data_have_the_same_answer() -> None:
    one, other = (fitted(trial(10)) for _ in range(2))
    assert one.values == other.values
    assert one.intervals == other.intervals
