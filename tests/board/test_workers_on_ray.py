"""Workers on a real Ray of two CPUs on this machine: each takes jobs of its own."""

from collections.abc import Iterator

import pytest

from assistax_base import cluster as ray_blocks
from assistax_base.cluster import RayCluster
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.work.working_process import run_workers_on_ray
from tests.board.fakes import FakeScorer, draft, new_submitter
from tests.board.running import served


@pytest.fixture
def two_cpus() -> Iterator[None]:
    import ray

    # A cluster of this size: only the private name takes the number of cores.
    ray_blocks._connect(ray, None, num_cpus=2)
    yield
    ray.shutdown()


@pytest.mark.slow
def test_a_cluster_of_workers_empties_the_queue(service: Service, two_cpus: None) -> None:
    submitter = new_submitter(service)
    for number in range(20):
        service.submit(submitter, draft(request=f"r{number}"))
    with served(service) as server:
        client = server.client("work")
        run_workers_on_ray(RayCluster(cpus=1), client, FakeScorer, until_empty=True)
    assert {row.state for row in service.queries.submissions()} == {"scored"}
    with service.database.read() as connection:
        names = {row.worker for row in connection.execute(schema.jobs.select())}
    assert len(names) == 2, "both CPUs had one"
