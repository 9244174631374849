"""Models are copied and sent to other processes."""

from __future__ import annotations

import copy
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from knee_contact_ros import Results, load_model
from knee_contact_ros.model.knee import KneeModel


def bits(knee: KneeModel) -> bytes:
    time = 0.002 * np.arange(6)
    return knee.run(time, 0.1 + time, 600.0 + 4e3 * time).tobytes()


@pytest.mark.parametrize("compiled", [None, False])
def test_a_loaded_model_works_in_another_process(compiled: bool | None) -> None:
    knee = load_model(["osteoarthritis", "mri_femur"], compiled=compiled)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(bits, knee).result(120.0) == bits(knee)
    assert isinstance(copy.deepcopy(knee).run([0.0], [0.1], [700.0]), Results)
