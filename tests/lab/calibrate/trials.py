"""Made trials: what a knee with known parameters answers, with noise."""

import functools
import math

import numpy as np

from knee_contact_ros import load_model

TRUE = {"contact.stiffness": 7.0e7, "contact.damping": 4000.0, "contact.exponent": 1.5}
START = {"contact.stiffness": 9.0e7, "contact.damping": 6000.0}
FINE = {"fidelity.tolerance": 1e-9, "fidelity.level": "dynamic"}
NOISE = 3e-6
"""[m]"""


@functools.cache
def inputs(least=100.0, most=1500.0):
    """Time [s], angle [rad] and load [N] of a second of pressing, quickly enough for the damping to count."""
    time = np.arange(200) * 5e-3
    part = 0.5 - 0.5 * np.cos(math.tau * 4.0 * time)
    return time, 0.3 + 0.2 * np.sin(math.tau * time), least + (most - least) * part


def answers(values=None, **limits):
    """The true answers."""
    return load_model({**TRUE, **FINE, **(values or {})}, compiled=True).run(*inputs(**limits))


def trial(seed, noise=NOISE, values=None, **limits):
    """A table with the depth measured."""
    time, angle, load = inputs(**limits)
    depth = answers(values, **limits).penetration_depth + noise * np.random.default_rng(
        seed
    ).standard_normal(len(time))
    return {"time": time, "flexion_angle": angle, "load": load, "penetration_depth": depth}


def written(path, table):
    """Its file; what is not a number is an empty cell."""
    rows = zip(*table.values(), strict=True)
    lines = [
        ",".join("" if math.isnan(cell) else repr(float(cell)) for cell in row) for row in rows
    ]
    path.write_text("\n".join(["# made", ",".join(table), *lines]) + "\n", encoding="utf-8")
    return path
