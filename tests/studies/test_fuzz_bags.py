"""Some of the damaged bags of `studies.fuzz_bags`; all of them are in `docs/studies/fuzz_bags.md`."""

from collections import Counter

from studies.fuzz_bags.bags import make
from studies.fuzz_bags.judge import BAD, SAID, SILENT, answers_to, expected, solved, try_case

CASES = 42
"""A multiple of the kinds of bags"""


def test_no_damaged_bag_gives_a_traceback_or_a_wrong_answer_without_a_word(tmp_path):
    (tmp_path / "whole").mkdir()
    bags = make(tmp_path / "whole")
    verdicts = [
        try_case(seed, bags, tmp_path / "case") for seed in range(1_000_000, 1_000_000 + CASES)
    ]
    assert [verdict for verdict in verdicts if verdict.outcome in BAD] == []
    outcomes = Counter(verdict.outcome for verdict in verdicts)
    assert outcomes[SAID] > CASES // 2  # of most there is something left
    protected = [
        v for v in verdicts if v.kind in {"MCAP, uncompressed", "MCAP, zstd", "MCAP, lz4"}
    ]
    assert sum(verdict.foreign for verdict in protected) == 0


def test_a_wrong_answer_is_noticed(tmp_path, monkeypatch):
    (tmp_path / "whole").mkdir()
    bags = make(tmp_path / "whole")
    others = answers_to([])
    monkeypatch.setattr("studies.fuzz_bags.judge.expected", lambda: others)
    assert expected()
    assert solved("MCAP, zstd", bags["MCAP, zstd"], tmp_path)[0] == SILENT
