"""The study of throughput: all ways read the same messages, and who writes them writes as many."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader

from studies.throughput import WAYS, make_bag

TICKS = 1500


def test_all_ways_read_and_write_the_same_number_of_messages(tmp_path: Path) -> None:
    bag, written = tmp_path / "bag.mcap", {}
    make_bag(bag, TICKS)
    for way, run in WAYS.items():
        output = tmp_path / way.replace(" ", "_")
        assert run(bag, output) == 2 * TICKS
        written[way] = next(output.glob("*.mcap"), None)
    for way, path in written.items():
        if path is None:
            assert way.endswith(("reading", "decoding"))
            continue
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = sorted(summary.statistics.channel_message_counts.values())
        assert counts[-4:] == 4 * [TICKS]  # beside them the leg, now and then
