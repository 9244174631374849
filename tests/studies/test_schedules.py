"""Drawn schedules of a session find faults that were there once."""

import os
import subprocess
import sys

import pytest

from tests import ROOT
from tests.helpers.patience import patience

PUT_BACK = {
    "": (0, ""),
    "parameters are not checked before they are set": (
        33,
        "contact_pipeline.ContactPipeline.check_retune = lambda _self, _parameters: None",
    ),
    "the state of a snapshot is that after its first answer": (
        0,
        "Ring, put = outputs.Ring, outputs.Ring.put_item\n"
        "def late(ring, item):\n"
        "    ring._state = ring._run_state()\n"
        "    put(ring, item)\n"
        "Ring.put_item = late",
    ),
    "answers that a killed recorder had been handed are not counted": (
        9,
        "kind = outputs.SinkProcess\n"
        "kind._lost = property(\n"
        "    lambda sink: sink.__dict__.get('lost', 0),\n"
        "    lambda sink, lost: sink.__dict__.update(lost=lost and sink._unsent()),\n"
        ")",
    ),
    "a recording in the middle of a run has no state": (
        0,
        "from knee_contact_ros.bags import provenance\n"
        "whole = provenance.beginning\n"
        "provenance.beginning = session.beginning = lambda ticks, _state: whole(ticks, None)",
    ),
    "the answers beside a stride are not looked at": (
        0,
        "from knee_contact_ros.streams import strides\n"
        "whole = strides.stride_of\n"
        "def inner(span, rows, ringing=None):\n"
        "    stride = whole(span, rows, ringing)\n"
        "    within = slice(*np.searchsorted(rows['stamp'], (span.start, span.end)))\n"
        "    flagged = (rows['status'][within].astype(int) & strides.UNUSABLE).any()\n"
        "    return stride._replace(usable=not flagged)\n"
        "strides.stride_of = inner",
    ),
    "recordings lack the angles that belong to no answer yet": (
        530,
        "from knee_contact_ros.streams import pairing\npairing.Synchroniser.all_unpaired = ()",
    ),
    "solve judges the samples of a recording again": (
        13,
        "from knee_contact_ros.streams import pairing\n"
        "pairing.Synchroniser.expect_recording = lambda _: None",
    ),
}
"""Faults by name: number of a schedule that is just before one that finds it, and what puts it back"""
SCHEDULES = 6
"""Number of schedules"""


@pytest.mark.parametrize("fault", PUT_BACK)
def test_a_fault_put_back_is_found(fault, tmp_path):
    first, code = PUT_BACK[fault]
    program = (
        f"from studies.schedules import *\n{code}\n"
        f"main(['--seed', '7', '--first', '{first}', '--count', '{SCHEDULES}', '--jobs', '1'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,  # where snapshots without a path lie
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=patience(),
        check=False,
    )
    assert done.returncode == bool(fault), done.stderr[-2000:]
    assert f"seed 7: {'0 of' if not fault else ''}" in done.stdout or "contact law" in done.stderr
