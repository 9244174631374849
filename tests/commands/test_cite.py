"""`knee-contact cite`."""

import json

from knee_contact_ros import __version__, solve
from tests.helpers.commands import run


def test_it_prints_what_a_paper_cites_as_text_and_as_json(right_bag, tmp_path, capsys):
    recording = tmp_path / "out.mcap"
    solve(right_bag, output=recording)
    assert run(f"cite {recording}") == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"knee_contact_ros {__version__}" in lines[0]
    assert "load: fixed_share: 0.5 of the axial joint reaction; body weight 737.068 N" in lines
    assert run(f"cite {recording} --json") == 0
    parts = json.loads(capsys.readouterr().out)
    assert lines == [f"{name}: {text}" for name, text in parts.items()]


def test_a_damaged_recording_is_cited_as_far_as_it_can_be(right_bag, tmp_path, capsys):
    recording = tmp_path / "out.mcap"
    solve(right_bag, output=recording)
    content = recording.read_bytes()
    recording.write_bytes(content[: len(content) // 2])
    assert run(f"cite {recording}") == 1
    out, error = capsys.readouterr()
    assert "law: kelvin_voigt" in out
    assert error.startswith(f"knee-contact: bag {recording} is damaged: ")
