"""What is told in words beside the plots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.offline.notebooks import solve
from knee_contact_ros.streams.strides import impulse_per_stride
from knee_contact_ros.streams.topics import Answer
from knee_contact_ros.view.anatomy import KneeOutlines
from knee_contact_ros.view.scene import Remarks
from tests.helpers.answers import rows_of
from tests.view.rrd import lists
from tests.view.scenes import WEIGHT, at

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


def test_events_are_told_with_their_times(knee: tuple[KneeOutlines, list[Answer]], drawn: Path) -> None:
    _, answers = knee
    told = [text[0] for _, text in lists(drawn, "/knee/events", "TextLog:text")]
    assert "2.015 s  load peak 1.81 BW (1337.7 N)" in told
    assert "2.430 s  load peak 2.19 BW (1613.8 N)" in told
    assert "1.955 s  bone contact begins" in told
    assert "2.125 s  bone contact ends" in told
    assert len([text for text in told if "heel strike" in text]) == 2
    assert len([text for text in told if "toe-off" in text]) == 1
    (stride,) = (text for text in told if "stride" in text)
    (expected,) = impulse_per_stride(rows_of(answers), WEIGHT)
    whole, stance = expected.impulse, expected.stance_impulse
    ending = f"stride of {expected.span.duration:.2f} s: impulse {whole:.1f} N s, stance {stance:.1f} N s"
    assert stride == f"{expected.span.end / 1e9:.3f} s  {ending}"


def test_every_stride_has_its_impulse_though_old_samples_go(right_bag: Path) -> None:
    """The shipped gait eight times without a pause, and once more from the beginning on."""
    gait = np.asarray(solve(right_bag))
    length = int(gait["stamp"][-1] - gait["stamp"][0]) + 5_000_000
    walked = np.concatenate([at(gait, gait["stamp"] + place * length) for place in range(8)])
    expected = impulse_per_stride(walked, WEIGHT)
    assert len(expected) >= 8
    whole = np.concatenate([walked, walked])
    for batches in ([whole], np.array_split(whole, 57), np.array_split(whole, 1000)):
        remarks = Remarks(WEIGHT)
        told = [remark for batch in batches for remark in remarks.take(batch)] + remarks.finish()
        strides = sorted(remark for remark in told if remark.text.startswith("stride"))
        for remark, one in zip(strides, [one for one in expected for _ in range(2)], strict=True):
            assert remark.stamp == one.span.end
            assert f"impulse {one.impulse:.1f} N s, stance {one.stance_impulse:.1f} N s" in remark.text
