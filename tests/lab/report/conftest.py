"""Reports, and what they are made of."""

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.report import figures
from knee_contact_ros.parameters.files import load_parameters
from tests.helpers.offline import solve

DEVIATIONS = "axial_load: 5 %\nmedial_share: 0.06\ncontact.stiffness: 20 %\nfemur.radius: 0.002\n"
RUNS = ["right", "right, with osteoarthritis.yaml", "left", "left, with osteoarthritis.yaml"]
"""Runs of `both`"""


@pytest.fixture(scope="session")
def bags(config):
    return config.parent / "bags" / "gait2354_right", config.parent / "bags" / "gait2354_left"


@pytest.fixture(scope="session")
def recording(tmp_path_factory, bags):
    """The right knee as we record it."""
    path = tmp_path_factory.mktemp("recording") / "knee.mcap"
    parameters = load_parameters(["osteoarthritis", {"body_weight": 700.0}])
    solve(bags[0], parameters, path)
    return path


@pytest.fixture
def deviations(tmp_path):
    path = tmp_path / "sd.yaml"
    path.write_text(DEVIATIONS)
    return path


@pytest.fixture(scope="session")
def both(tmp_path_factory, bags):
    """Both knees, healthy beside osteoarthritic. Tests that look at it run in the group `report`."""
    output = tmp_path_factory.mktemp("report") / "both"
    labels = ["--label=right", "--label=left", "--compare=osteoarthritis.yaml"]
    assert main(["report", *map(str, bags), *labels, f"--output={output}"]) == 0
    return output


@pytest.fixture
def report(tmp_path, monkeypatch):
    """Writes a report with small pictures; gives its folder."""
    monkeypatch.setattr(figures, "_DOTS_PER_INCH", 20)

    def run(*arguments, code=0):
        output = tmp_path / "out"
        assert main(["report", *map(str, arguments), f"--output={output}"]) == code
        return output

    return run
