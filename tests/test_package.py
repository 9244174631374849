"""The package's own names: what is public, and that it costs nothing until it is used."""

import subprocess
import sys

import pytest

import knee_contact_ros


def test_dir_names_what_is_public_and_all_of_it_is_there():
    public = [
        "Gait",
        "Results",
        "UsageError",
        "__version__",
        "calibrate",
        "estimate_load",
        "load_model",
        "paired",
        "sensitivity",
    ]
    assert dir(knee_contact_ros) == [*public, "solve", "sweep", "uncertainty"]
    assert all(getattr(knee_contact_ros, name) for name in dir(knee_contact_ros))
    with pytest.raises(AttributeError, match="no attribute 'load_modell'"):
        _ = knee_contact_ros.load_modell


def test_importing_it_imports_nothing_heavy():
    code = "import sys, knee_contact_ros; print([n for n in ('numpy', 'scipy', 'numba', 'pandas') if n in sys.modules])"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "[]\n"
    )


def test_a_model_and_its_runs_take_no_library_of_tables():
    code = (
        "import sys, knee_contact_ros as k; m = k.load_model(); r = m.run([0.0], [0.1], [700.0]); "
        "print([n for n in ('numba', 'pandas', 'polars', 'xarray', 'matplotlib', 'rclpy') if n in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "[]\n"
    )


def test_models_and_streams_fit_a_line():
    model = knee_contact_ros.load_model()
    assert (
        repr(model)
        == "<KneeModel: circle on plane, hinge, contact law 7.906e+07 N/m^1.5, force drive>"
    )
    stream = model.stream()
    assert repr(stream).startswith("<Stream no tick yet: circle on plane")
    contact = stream.tick(0.25, 0.3, 700.0)
    assert repr(stream).startswith("<Stream at 0.25 s: circle on plane")
    assert (
        repr(contact) == "<Contact at 0.25 s: load 700.0 N, contact force 700.0 N, depth 0.428 mm>"
    )
    mri = repr(knee_contact_ros.load_model("mri_knee"))
    assert "\n" not in mri
    assert len(mri) < 120
