"""The compiled kernel: the same bits as the plain one, for every part that a scene can be made of."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import typeof as type_of

import knee_contact_ros
from knee_contact_ros.compiled.kernel import compiled
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_pairs import TIBIAL_GEOMETRIES
from knee_contact_ros.core.geometries import GEOMETRIES
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms import MECHANISMS
from knee_contact_ros.core.model import PLAIN, KneeModel
from knee_contact_ros.core.types import ContactState, Status

TIME = np.arange(0.0, 0.4, 0.004)
ANGLE = 0.4 + 0.3 * np.sin(7.0 * TIME)
WALKING = 900.0 + 600.0 * np.sin(13.0 * TIME)
HOPPING = np.where((TIME > 0.1) & (TIME < 0.12), -150.0, WALKING)
WALK, HOP = (TIME, ANGLE, WALKING), (TIME, ANGLE, HOPPING)
DYNAMIC = {"fidelity.level": "dynamic"}
DAMPED = ("hunt_crossley", "lankarani_nikravesh", "flores", "gonthier")


class Combination(NamedTuple):
    """What decides the types that a kernel is compiled for, and what is tried with it; laws of one formula share it.

    Every kind of part is in one of them. Only a circle in a circle with a table is compiled here, the other kernels
    come with the package; all pairs of surfaces are compiled by themselves in `tests/core/test_compiled_surfaces.py`.
    """

    formula: str
    laws: tuple[str, ...]
    femur: str
    tibia: str
    mechanism: str
    levels: tuple[str, ...]


SPRINGS = ("hertz", "elastic_foundation")
TWO_LAYERS = ("two_layer_elastic", "two_layer_viscoelastic")
COMBINATIONS = (
    Combination(
        "kelvin_voigt",
        ("kelvin_voigt",),
        "circle",
        "plane",
        "hinge",
        ("dynamic", "auto", "first_order", "quasi_static"),
    ),
    Combination("two_layer", TWO_LAYERS, "profile", "plane", "ball_and_socket", ("auto", "first_order")),
    Combination("impact", DAMPED[:2], "circle", "circle", "parallel_mechanism", ("dynamic",)),
    Combination("impact", DAMPED[2:], "circle", "circle", "table", ("dynamic",)),
    Combination("spring", SPRINGS, "profile", "plane", "hinge", ("quasi_static",)),
    Combination("kelvin_voigt", ("kelvin_voigt",), "profile", "profile", "hinge", ("quasi_static",)),
)
NAMED = {law for combination in COMBINATIONS for law in combination.laws}
COMBINATIONS += tuple(
    Combination(law, (law,), "circle", "plane", "hinge", ("auto",)) for law in CONTACT_LAWS if law not in NAMED
)


def group(combination: Combination) -> pytest.MarkDecorator:
    """One process runs all tests of a kernel, so that it is compiled once."""
    return pytest.mark.xdist_group(f"kernel for {combination.formula}")


LAWS = [
    pytest.param(combination, law, id=f"{law}-{combination.tibia}", marks=group(combination))
    for combination in COMBINATIONS
    for law in combination.laws
]
FIRST = COMBINATIONS[0]
CASES = [
    pytest.param(combination, law, level, id=f"{law}-{combination.tibia}-{level}", marks=group(combination))
    for combination in COMBINATIONS
    for law in combination.laws
    for level in combination.levels
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
        }
        | changes,
        compiled=False,
    )


def assert_same_bits(plain: KneeModel, *columns: np.ndarray) -> np.recarray[Any, Any]:
    """Run and stream, plain and compiled; the plain series."""
    assert plain.kernel is PLAIN
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
    assert {level for combination in COMBINATIONS for level in combination.levels} == set(LEVELS)


@pytest.mark.parametrize(("combination", "law", "level"), CASES)
def test_the_compiled_kernel_gives_the_bits_of_the_plain_one(
    config: Path, combination: Combination, law: str, level: str
) -> None:
    # Exponents other than 1.5 take another way through the power law.
    for changes in ({}, {"fidelity.tolerance": 1e-9}, {"contact.exponent": 1.7, "contact.stiffness": 3e8}):
        assert_same_bits(knee(config, combination, law, **{"fidelity.level": level} | changes), *WALK)
    assert_same_bits(knee(config, combination, law, **{"fidelity.level": level}), *HOP)


@pytest.mark.parametrize(("combination", "law"), LAWS)
def test_a_prescribed_height_gives_the_same_bits(config: Path, combination: Combination, law: str) -> None:
    forced = knee(config, combination, law, **{"fidelity.level": "quasi_static"})
    height = forced.run(*WALK).femoral_height + 6e-4 * np.sin(40.0 * TIME)
    series = assert_same_bits(knee(config, combination, law, drive="displacement"), *WALK, height)
    assert series.gap.max() > 0.0


@group(FIRST)
def test_lift_off_and_landing_are_events_in_both(config: Path) -> None:
    series = assert_same_bits(knee(config, FIRST, "kelvin_voigt", **DYNAMIC), *HOP)
    assert series.contact_state.min() == ContactState.SEPARATED
    assert series.contact_state[-1] == ContactState.CARTILAGE


@group(COMBINATIONS[1])
def test_layers_are_events_in_both(config: Path) -> None:
    series = assert_same_bits(knee(config, COMBINATIONS[1], "two_layer_viscoelastic"), *HOP)
    assert set(series.contact_state) == set(ContactState)


@group(FIRST)
@pytest.mark.parametrize("level", ["dynamic", "auto"])
def test_a_budget_runs_out_at_the_same_evaluation(config: Path, level: str) -> None:
    changes = {"fidelity.level": level, "fidelity.budget": 100, "fidelity.tolerance": 1e-12}
    series = assert_same_bits(knee(config, FIRST, "kelvin_voigt", **changes), *HOP)
    assert (series.status & Status.NOT_CONVERGED != 0).any()
    assert 0.5 * 100 < series.evaluations.max() <= 100


@group(FIRST)
def test_a_law_that_may_pull_pulls_in_both(config: Path) -> None:
    series = assert_same_bits(knee(config, FIRST, "kelvin_voigt", **DYNAMIC, **{"contact.allow_tension": True}), *HOP)
    assert series.contact_force.min() < 0.0


@group(FIRST)
def test_extremes_overflow_alike(config: Path) -> None:
    changes = {"contact.stiffness": 1e15, "contact.damping": 1e9, "femur.mass": 1e-4, "fidelity.budget": 1000}
    load = np.where(np.arange(len(TIME)) % 2, 1e6, -1e6)
    assert_same_bits(knee(config, FIRST, "kelvin_voigt", **DYNAMIC, **changes), 1e3 * TIME, ANGLE, load)


@group(FIRST)
def test_a_stream_goes_on_with_its_own_memory(config: Path) -> None:
    quick = compiled(knee(config, FIRST, "kelvin_voigt", **DYNAMIC))
    expected = quick.run(*WALK)
    streams = [quick.stream() for _ in range(3)]
    for i, row in enumerate(zip(*(column.tolist() for column in WALK), strict=True)):
        for stream in streams:
            assert stream.tick(*row).penetration_depth == expected.penetration_depth[i]


@group(FIRST)
def test_a_level_asks_for_no_kernel_of_its_own(config: Path) -> None:
    models = [knee(config, FIRST, "kelvin_voigt", **{"fidelity.level": level}) for level in LEVELS]
    models.append(knee(config, FIRST, "kelvin_voigt", drive="displacement"))
    assert len({type_of(model.scene) for model in models}) == 1


@pytest.mark.parametrize("command", ["--help", "solve --help"])
def test_nothing_waits_for_the_compiler_that_does_not_need_it(command: str) -> None:
    code = (
        "import sys\nfrom knee_contact_ros.cli.main import main\n"
        f"code = main({command.split()!r})\nsys.exit(code or 'numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode == 0
