"""Schemathesis on the API: no request that it can think of breaks the server."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings

from assistax_board.app import create_app
from tests.board.fakes import draft, new_service, new_submitter, work_off
from tests.board.test_season import open_season


@pytest.mark.slow
def test_no_request_breaks_the_server(tmp_path: Path) -> None:
    import schemathesis  # takes seconds, which every other run of the tests would pay too

    service = new_service(tmp_path)
    service.submit(new_submitter(service), draft(2.0, season=open_season(service)))
    work_off(service)
    app = create_app(service)
    app.state.limiter.hit = lambda *_: None  # a fuzzer is fast
    token = service.create_token(("submit", "work", "organise"), submitter="fuzzer")
    headers = {"Authorization": f"Bearer {token}"}
    schema = schemathesis.openapi.from_asgi("/openapi.json", app)
    results: list[Any] = list(schema.get_all_operations())
    operations = [result.ok() for result in results]
    for operation in operations:
        fuzz(operation, headers)
    assert len(operations) > 20


def fuzz(operation: Any, headers: dict[str, str]) -> None:
    @given(case=operation.as_strategy())
    @settings(
        max_examples=10,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    def call(case: Any) -> None:
        response = case.call(headers=headers)
        assert response.status_code < 500, (operation.label, response.text)

    call()
