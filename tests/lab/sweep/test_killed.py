"""Whatever is killed, no finished case is lost: the next run computes the rest, and the table is the same."""

import os
import random
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from knee_contact_ros.lab.study_file import Study, read_study
from knee_contact_ros.system.errors import IncompleteError
from tests.helpers.processes import remount
from tests.lab.sweep.studies import Cluster, assert_same, computed, end, started, table, wait_until

pytestmark = pytest.mark.xdist_group("cluster of cohorts")
CASES = 640
A_BLOCK = 40


@pytest.fixture(scope="module")
def asked(tmp_path_factory, right_bag):
    """A study of some seconds."""
    path = tmp_path_factory.mktemp("study") / "study.yaml"
    path.write_text(
        f"bags: [{right_bag}]\nvalues: {{fidelity.level: dynamic, fidelity.tolerance: 1.0e-10}}\n"
        f"sample: {{n: {CASES}, method: sobol, ranges: {{contact.damping: [1.0e3, 1.0e4]}}}}\n"
    )
    return path


@pytest.fixture(scope="module")
def expected(asked, cluster, tmp_path_factory):
    """Its table, when nothing happens."""
    folder = tmp_path_factory.mktemp("expected")
    assert computed(read_study(asked, Study), folder, scheduler=cluster.address)[1] == CASES
    return table(folder)


@pytest.fixture
def own(tmp_path):
    """A cluster to be killed."""
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster")
    cluster.add_worker()
    yield cluster
    cluster.close()


def begun(asked, out, *options, files=2):
    """A command of which so many files of the table are there."""
    code = "import sys; from knee_contact_ros.commands.main import main; sys.exit(main())"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    client = started("-c", code, "sweep", str(asked), "--output", str(out), *options, **pipes)
    wait_until(lambda: len(list(out.glob("cases-*"))) >= files)
    return client


def assert_goes_on(asked, out, address, expected, files=1):
    """The next run computes the rest."""
    there, now, _ = computed(read_study(asked, Study), out, scheduler=address)
    assert there >= A_BLOCK * files
    assert there + now == CASES
    assert_same(table(out), expected)


def test_killed_workers(asked, expected, own, tmp_path):
    out = tmp_path / "out"
    with ThreadPoolExecutor() as pool:
        client = pool.submit(computed, read_study(asked, Study), out, scheduler=own.address)
        for files in sorted(random.sample(range(1, 13), 2)):
            wait_until(
                lambda files=files: len(list(out.glob("cases-*"))) >= files or client.done()
            )
            time.sleep(random.uniform(0.0, 0.1))
            own.add_worker()
            end(own.workers[-2])
        assert client.result() == (0, CASES, 0)
    assert_same(table(out), expected)


def test_a_killed_scheduler(asked, expected, own, tmp_path):
    out, files = tmp_path / "out", random.randint(1, 10)
    client = begun(asked, out, "--scheduler", own.address, files=files)
    end(own.scheduler)
    said, errors = client.communicate(timeout=60)
    assert (client.returncode, said) == (1, "")
    waits = f"knee-contact: warning: scheduler {own.address}: it has no workers yet; waiting\n"
    assert errors.removeprefix(waits) == (
        "knee-contact: the scheduler no longer answers; finished cases are kept; the same command computes the rest\n"
    )
    assert len(table(out)) < CASES
    own.start_scheduler()
    own.add_worker()
    assert_goes_on(asked, out, own.address, expected, files)


def in_group(leader):
    """Processes of a group that still run."""
    listing = subprocess.run(
        ["/bin/ps", "-eo", "pgid,stat,pid"], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split() for line in listing.splitlines()[1:]]
    return [
        pid for group, state, pid in rows if group == str(leader) and not state.startswith("Z")
    ]


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_client_that_ends_leaves_no_process(asked, expected, cluster, tmp_path, interrupted):
    """A terminal's Ctrl-C reaches the workers, too; or the client alone is killed."""
    out = tmp_path / "out"
    client = begun(asked, out, "--workers", "2")
    if interrupted:
        os.killpg(client.pid, signal.SIGINT)
    else:
        client.kill()
    said, errors = client.communicate(timeout=60)
    if interrupted:
        assert (client.returncode, said, errors.strip()) == (130, "", "knee-contact: interrupted")
        assert list(out.glob("_*")) == []
    wait_until(lambda: not in_group(client.pid))
    assert len(table(out)) < CASES
    assert_goes_on(asked, out, cluster.address, expected)


def test_a_full_disk(asked, expected, cluster, small_disk):
    remount(small_disk, "size=150k")
    out = small_disk / "out"
    with pytest.raises(IncompleteError, match=f"output {out}: No space left on device"):
        computed(read_study(asked, Study), out, scheduler=cluster.address)
    assert list(out.glob("_*")) == []
    assert len(table(out)) < CASES
    remount(small_disk, "size=20m")
    assert_goes_on(asked, out, cluster.address, expected)
