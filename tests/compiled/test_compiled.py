"""The compiled kernel: the same bits as the plain one, for every part that a scene can be made of."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.compiled import compiled
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_pairs import TIBIAL_GEOMETRIES
from knee_contact_ros.core.geometries import GEOMETRIES
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms import MECHANISMS
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import ContactState, Status

TIME = np.arange(0.0, 0.4, 0.004)
ANGLE = 0.4 + 0.3 * np.sin(7.0 * TIME)
WALKING = 900.0 + 600.0 * np.sin(13.0 * TIME)
HOPPING = np.where((TIME > 0.1) & (TIME < 0.12), -150.0, WALKING)
DAMPED = ("hunt_crossley", "lankarani_nikravesh", "flores", "gonthier")


class Combination(NamedTuple):
    """What decides the types that a kernel is compiled for; laws of one formula share it.

    Compiling all of them takes minutes where nothing is kept from before, so a measured femur steps on a plane only.
    """

    laws: tuple[str, ...]
    femur: str
    tibia: str
    mechanism: str
    level: str = "auto"
    drive: str = "force"


COMBINATIONS = (
    Combination(("kelvin_voigt",), "circle", "plane", "hinge", "dynamic"),
    Combination(("kelvin_voigt",), "circle", "plane", "hinge", "auto"),
    Combination(("hertz", "elastic_foundation"), "profile", "profile", "hinge", "quasi_static"),
    Combination(("two_layer_elastic", "two_layer_viscoelastic"), "circle", "plane", "table", "first_order"),
    Combination(("two_layer_elastic", "two_layer_viscoelastic"), "profile", "plane", "hinge", "auto"),
    Combination(DAMPED, "circle", "circle", "parallel_mechanism", "dynamic"),
    Combination(("kelvin_voigt",), "profile", "circle", "ball_and_socket", drive="displacement"),
    Combination(DAMPED, "circle", "profile", "hinge", drive="displacement"),
)
NAMED = {law for combination in COMBINATIONS for law in combination.laws}
COMBINATIONS += tuple(Combination((law,), "circle", "plane", "hinge") for law in CONTACT_LAWS if law not in NAMED)
CASES = [
    pytest.param(combination, law, id="-".join((law, *combination[1:])))
    for combination in COMBINATIONS
    for law in combination.laws
]


def knee(config: Path, combination: Combination, law: str, **changes: Any) -> KneeModel:
    """The plain model."""
    return knee_contact_ros.load_model(
        {
            "contact.law": law,
            "femur.geometry": combination.femur,
            "femur.profile": str(config / "femur_medial.csv"),
            "tibia.geometry": combination.tibia,
            "tibia.profile": str(config / "tibia_medial.csv"),
            "translation.mechanism": combination.mechanism,
            "translation.table": str(config / "translation_medial.csv"),
            "fidelity.level": combination.level,
            "drive": combination.drive,
        }
        | changes
    )


def assert_same_bits(plain: KneeModel, *columns: np.ndarray) -> np.recarray[Any, Any]:
    """Run and stream, plain and compiled; the plain series."""
    expected = plain.run(*columns)
    quick = compiled(plain)
    assert quick.run(*columns).tobytes() == expected.tobytes()
    stream = quick.stream()
    rows = [stream.tick(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]
    assert b"".join(row.tobytes() for row in rows) == expected.tobytes()
    return expected


def test_everything_is_in_the_table() -> None:
    assert {law for combination in COMBINATIONS for law in combination.laws} == set(CONTACT_LAWS)
    assert {combination.femur for combination in COMBINATIONS} == set(GEOMETRIES)
    assert {combination.tibia for combination in COMBINATIONS} == set(TIBIAL_GEOMETRIES)
    assert {combination.mechanism for combination in COMBINATIONS} == set(MECHANISMS)
    assert {combination.level for combination in COMBINATIONS} == set(LEVELS)
    assert {combination.drive for combination in COMBINATIONS} == {"force", "displacement"}


@pytest.mark.parametrize(("combination", "law"), CASES)
def test_the_compiled_kernel_gives_the_bits_of_the_plain_one(config: Path, combination: Combination, law: str) -> None:
    if combination.drive == "displacement":
        forced = knee(config, combination._replace(drive="force", level="quasi_static"), law)
        height = forced.run(TIME, ANGLE, WALKING).femoral_height + 6e-4 * np.sin(40.0 * TIME)
        series = assert_same_bits(knee(config, combination, law), TIME, ANGLE, WALKING, height)
        assert series.gap.max() > 0.0
        return
    # Exponents other than 1.5 take another way through the power law.
    for changes in ({}, {"fidelity.tolerance": 1e-9}, {"contact.exponent": 1.7, "contact.stiffness": 3e8}):
        assert_same_bits(knee(config, combination, law, **changes), TIME, ANGLE, WALKING)
    assert_same_bits(knee(config, combination, law), TIME, ANGLE, HOPPING)


def test_lift_off_landing_and_layers_are_events_in_both(config: Path) -> None:
    series = assert_same_bits(knee(config, COMBINATIONS[0], "kelvin_voigt"), TIME, ANGLE, HOPPING)
    assert series.contact_state.min() == ContactState.SEPARATED
    assert series.contact_state[-1] == ContactState.CARTILAGE
    series = assert_same_bits(knee(config, COMBINATIONS[4], "two_layer_viscoelastic"), TIME, ANGLE, HOPPING)
    assert set(series.contact_state) == set(ContactState)


@pytest.mark.parametrize("index", [0, 1])
def test_a_budget_runs_out_at_the_same_evaluation(config: Path, index: int) -> None:
    plain = knee(config, COMBINATIONS[index], "kelvin_voigt", **{"fidelity.budget": 100, "fidelity.tolerance": 1e-12})
    series = assert_same_bits(plain, TIME, ANGLE, HOPPING)
    assert (series.status & Status.NOT_CONVERGED != 0).any()
    assert 0.5 * 100 < series.evaluations.max() <= 100


def test_a_law_that_may_pull_pulls_in_both(config: Path) -> None:
    series = assert_same_bits(
        knee(config, COMBINATIONS[0], "kelvin_voigt", **{"contact.allow_tension": True}), TIME, ANGLE, HOPPING
    )
    assert series.contact_force.min() < 0.0


def test_extremes_overflow_alike(config: Path) -> None:
    changes = {"contact.stiffness": 1e15, "contact.damping": 1e9, "femur.mass": 1e-4, "fidelity.budget": 1000}
    load = np.where(np.arange(len(TIME)) % 2, 1e6, -1e6)
    assert_same_bits(knee(config, COMBINATIONS[0], "kelvin_voigt", **changes), 1e3 * TIME, ANGLE, load)


def test_a_stream_goes_on_with_its_own_memory(config: Path) -> None:
    quick = compiled(knee(config, COMBINATIONS[0], "kelvin_voigt"))
    expected = quick.run(TIME, ANGLE, WALKING)
    streams = [quick.stream() for _ in range(3)]
    for i, row in enumerate(zip(TIME.tolist(), ANGLE.tolist(), WALKING.tolist(), strict=True)):
        for stream in streams:
            assert stream.tick(*row).penetration_depth == expected.penetration_depth[i]


@pytest.mark.parametrize("command", ["--help", "solve --help"])
def test_nothing_waits_for_the_compiler_that_does_not_need_it(command: str) -> None:
    code = (
        "import sys\nfrom knee_contact_ros.cli.main import main\n"
        f"code = main({command.split()!r})\nsys.exit(code or 'numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0
