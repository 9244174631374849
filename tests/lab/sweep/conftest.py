"""A real scheduler with two workers, for all tests of cohorts that do no harm to it."""

import pytest

from tests.lab.sweep.studies import Cluster

Client = pytest.importorskip("distributed", reason="the extra sweep is not installed").Client


@pytest.fixture(scope="package")
def cluster(tmp_path_factory):
    """The workers run in another folder than the client: names relative to one mean nothing in the other."""
    cluster, elsewhere = (
        Cluster(tmp_path_factory.mktemp("cluster")),
        tmp_path_factory.mktemp("elsewhere"),
    )
    for _ in range(2):
        cluster.add_worker(elsewhere)
    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    yield cluster
    cluster.close()


@pytest.fixture
def address(cluster):
    """Of the scheduler."""
    return cluster.address
