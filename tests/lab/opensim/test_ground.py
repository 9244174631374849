"""From a centre of pressure to the ankle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.gait_bag import Angles, Leg, leg_at
from knee_contact_ros.lab.opensim.leg import FootForce, GroundFile, about_ankle, check_upright, during, read_ground
from knee_contact_ros.lab.tables import read_storage
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.plates import FREE, STANDS, TIME, plate, write_plates

ANKLE = np.tile([0.4, 0.09, 0.1], (len(TIME), 1))
ARM = np.array([0.1, -0.09, 0.02])
"""[m] from the ankle to the centre of pressure of `plate`"""


def ground(tmp_path: Path, **changed: np.ndarray) -> GroundFile:
    """A right foot's plate."""
    path = write_plates(tmp_path / "grf.mot", plate("ground_force_r_", "ground_torque_r_") | changed)
    return read_ground(path, path, "right")


def expected() -> tuple[np.ndarray, np.ndarray]:
    """Force, and torque about the ankle."""
    force = np.column_stack([50.0 + TIME, 700.0 - 100.0 * TIME, -40.0 + TIME])
    torque = np.cross(ARM, force) + np.array(FREE)
    return force * STANDS[:, None], torque * STANDS[:, None]


def test_the_torque_is_about_the_ankle_and_nothing_acts_in_the_air(tmp_path: Path) -> None:
    """Also where a plate tells no centre of pressure, and a free moment all the same."""
    told = about_ankle(ground(tmp_path), ANKLE)
    force, torque = expected()
    # The file has twelve decimals.
    assert told.force == pytest.approx(force, abs=1e-11)
    assert told.torque == pytest.approx(torque, abs=1e-8)
    assert not told.force[~STANDS].any()
    assert not told.torque[~STANDS].any()


def test_noise_of_a_plate_is_no_step(tmp_path: Path) -> None:
    """A few N have a centre of pressure that is anywhere."""
    up = np.where(STANDS, 700.0 - 100.0 * TIME, 9.9)
    far = np.where(STANDS, 0.5, 40.0)
    told = about_ankle(ground(tmp_path, ground_force_r_vy=up, ground_force_r_px=far), ANKLE)
    assert told.torque == pytest.approx(expected()[1], abs=1e-8)


def test_plates_below_one_foot_are_added(tmp_path: Path) -> None:
    path = write_plates(tmp_path / "two.mot", plate("a_force_", ""), plate("b_force_", "b_torque_"))
    of_toes, of_heel = FootForce("a_force_v", "a_force_p", ""), FootForce("b_force_v", "b_force_p", "b_torque_")
    both = about_ankle(GroundFile(read_storage(path), (of_toes, of_heel), ()), ANKLE)
    force, torque = expected()
    assert both.force == pytest.approx(2.0 * force, abs=1e-11)
    assert both.torque == pytest.approx(2.0 * torque - STANDS[:, None] * np.array(FREE), abs=1e-8)


def test_samples_between_rows_lie_between_their_moments(tmp_path: Path) -> None:
    """Not between centres of pressure: at the end of stance there is one on one side only."""
    file = ground(tmp_path)
    stamps = file.data.stamps
    still = Angles(stamps, np.zeros(len(stamps)), None)
    leg = Leg(still, still, about_ankle(file, ANKLE))
    last = int(np.flatnonzero(STANDS)[-1])
    between = (stamps[last : last + 1] + stamps[last + 1 : last + 2]) // 2
    told = leg_at(leg, stamps, between).ground
    force, torque = (values[last] for values in expected())
    assert told.force[0] == pytest.approx(0.5 * force, rel=1e-9)
    assert told.torque[0] == pytest.approx(0.5 * torque, rel=1e-9)


def test_only_the_time_of_the_kinematics_counts(tmp_path: Path) -> None:
    file = ground(tmp_path)
    stamps = file.data.stamps
    between = np.array([stamps[10] + 1, stamps[20] - 1])
    assert during(file, between).data.stamps.tolist() == stamps[10:21].tolist()
    assert during(file, stamps).data.stamps.tolist() == stamps.tolist()
    with pytest.raises(UsageError, match=r"grf\.mot spans 0 to 1\.2 s, and the kinematics 7 to 8 s"):
        during(file, np.array([7, 8]) * 10**9)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"ground_force_r_px": np.full(len(TIME), 500.0)}, r"is 499\.60 m away from the ankle while the foot stands"),
        ({"ground_force_r_pz": np.full(len(TIME), -0.3)}, r"is 0\.41 m away .* the other foot's, not in m"),
        (
            {"ground_force_r_px": np.where(TIME > 0.5, np.nan, 0.5)},
            r"p\(x y z\) is not finite at 0\.505 s, and the foot",
        ),
        ({"ground_force_r_vx": np.where(TIME > 0.5, np.inf, 0.5)}, r"v\(x y z\) is not finite at 0\.505 s"),
    ],
)
def test_what_cannot_act_on_this_foot_is_refused(tmp_path: Path, changed: dict[str, np.ndarray], says: str) -> None:
    with pytest.raises(UsageError, match=says) as refused:
        about_ankle(ground(tmp_path, **changed), ANKLE)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("up", [-700.0, 0.7])
def test_a_force_downwards_or_in_other_units_is_refused(tmp_path: Path, up: float) -> None:
    with pytest.raises(UsageError, match=r"ground_force_r_vy goes from .*; it must be in N, upwards"):
        check_upright(ground(tmp_path, ground_force_r_vy=np.where(STANDS, up, 0.0)))
    check_upright(ground(tmp_path))
