"""Every submission comes to an end, once; nothing is counted twice and no attempt is lost."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.problems import Problem
from assistax_board.rules import jobs
from assistax_board.rules.scoring import encode_table
from assistax_board.service import Service
from assistax_board.store.ledger import check_chain
from assistax_board.store.receipts import verify_receipt
from assistax_board.store.schema import JOB, METADATA
from tests.board.fakes import (
    TASK,
    FakeScorer,
    advance,
    draft,
    new_service,
    new_submitter,
    noise,
    scored,
    shown,
    take,
    work_off,
)
from tests.board.running import soon


def test_a_submission_is_scored(service: Service) -> None:
    id = service.submit(new_submitter(service), draft(2.0))
    waiting = shown(service, id)
    assert (waiting.state, waiting.place, waiting.jobs) == ("queued", 1, 3)
    assert waiting.eta_seconds == pytest.approx(60.0)
    assert work_off(service) == 3
    scored = shown(service, id)
    assert (scored.state, scored.attempt, scored.place) == ("scored", "free", None)
    [score] = service.queries.scores(submission=id)
    ease = [noise("0", f"partner-{p:03d}", k) for p in range(60) for k in range(8)]
    assert score.figures["mean"] == pytest.approx(2.0 + np.mean(ease), abs=1e-6)
    assert len(service.queries.partner_scores([id])) == 60


def test_changed_receipt_is_invalid(service: Service) -> None:
    id = scored(service, new_submitter(service))
    receipt = service.queries.receipt(id)
    assert receipt is not None
    assert verify_receipt(receipt, service.signer.public_key)["submission"] == id
    with pytest.raises(ValueError, match="the key of GET /api/about"):
        verify_receipt(receipt, "no key")
    about = TestClient(create_app(service)).get("/api/about").json()
    assert about["key"] == service.signer.public_key
    receipt["content"]["scores"]["public"]["mean"] += 1.0
    with pytest.raises(ValueError, match="was changed"):
        verify_receipt(receipt, service.signer.public_key)


@pytest.mark.parametrize(
    ("data", "reason", "has_file"),
    [(b"\x80", "unknown_format", False), (b"broken", "not_finite", True)],
)
def test_refused_file_ends_with_its_reason(
    service: Service, data: bytes, reason: str, has_file: bool
) -> None:
    row = shown(service, scored(service, new_submitter(service), data=data))
    assert (row.state, row.reason, row.artefact is not None) == ("refused", reason, has_file)


def test_references_are_queued_once_and_last(service: Service, tmp_path: Path) -> None:
    for _ in range(2):
        service.add_references()
    id = service.submit(new_submitter(service), draft(2.0))
    assert shown(service, id).place == 1
    assert work_off(service, most=3) == 3
    assert shown(service, id).state == "scored"
    assert work_off(service) == 6
    names = {row.method for row in service.queries.submissions() if row.kind == "reference"}
    assert names == {"zero-action", "self-play"}
    means = {s.method: s.figures["mean"] for s in service.queries.scores(task="scratch")}
    assert means["zero-action"] < means["mine"] < means["self-play"]
    again = new_service(tmp_path, version=2)  # after an upgrade they are played anew
    assert again.adopt_version() == 3


def test_a_job_done_twice_counts_once(service: Service) -> None:
    service.submit(new_submitter(service), draft())
    work = take(service)
    table = FakeScorer().play(work, b"robot 1.0", None)
    for wrong in (table.head(10), table.with_columns(partner=table["partner"] + "x")):
        with pytest.raises(Problem, match="lacks episodes"):
            service.result(work.job, work.lease, encode_table(wrong), 1.0)
    assert service.result(work.job, work.lease, encode_table(table), 1.0)
    assert not service.result(work.job, work.lease, encode_table(table), 1.0)
    work_off(service)
    assert service.queries.submissions()[0].state == "scored"


@pytest.mark.parametrize("jump", [-1e6, jobs.LEASE_SECONDS + 1, 1e6])
def test_expired_lease_passes_to_another_worker(service: Service, jump: float) -> None:
    """Also if the clock jumps far, whichever way."""
    id = service.submit(new_submitter(service), draft())
    lost = take(service)
    advance(service, jump)
    assert work_off(service) == 3
    assert shown(service, id).state == "scored"
    assert not service.beat(lost.job, lost.lease)
    with pytest.raises(Problem, match="no longer yours"):
        service.result(lost.job, lost.lease, b"", 1.0)


def test_lease_of_slightly_fast_clock_stands(service: Service) -> None:
    service.submit(new_submitter(service), draft())
    advance(service, 5.0)
    work = take(service)
    advance(service, -5.0)
    take(service)
    with service.database.read() as connection:
        assert set(connection.execute(sa.select(JOB.failures)).scalars()) == {0}
    assert service.beat(work.job, work.lease)


def test_a_job_given_back_is_no_failure(service: Service) -> None:
    id = service.submit(new_submitter(service), draft())
    for _ in range(jobs.MAX_FAILURES + 1):
        work = take(service)
        service.give_back(work.job, work.lease)
    work_off(service)
    assert shown(service, id).state == "scored"


def test_one_lab_cannot_keep_the_others_out(service: Service) -> None:
    many, single = new_submitter(service, "many"), new_submitter(service, "one")
    for number in range(3):
        service.submit(many, draft(request=f"r{number}"))
    advance(service, 1.0)
    id = service.submit(single, draft())
    assert shown(service, id).place == 2


def test_a_withdrawn_submission_is_never_scored(service: Service) -> None:
    submitter = new_submitter(service)
    id = service.submit(submitter, draft())
    work = take(service)
    service.withdraw(id, submitter)
    with pytest.raises(Problem, match="no longer yours"):
        service.result(work.job, work.lease, b"", 1.0)
    assert shown(service, id).reason == "withdrawn"
    with pytest.raises(Problem, match="has ended"):
        service.withdraw(id, submitter)


def test_new_version_rescores_and_keeps_old_scores(service: Service, tmp_path: Path) -> None:
    lab, gone = new_submitter(service), new_submitter(service, "gone")
    id = scored(service, lab)
    scored(service, gone, 2.0)
    service.erase_submitter(gone)  # whose file cannot be played again
    running = service.submit(lab, draft(request="r2"))
    work_off(service, most=1)
    take(service)
    upgraded = new_service(tmp_path, version=2)
    assert (upgraded.adopt_version(), upgraded.adopt_version()) == (2, 0)
    assert work_off(upgraded, version=1) == 0  # a worker that was not upgraded gets nothing
    assert work_off(upgraded, version=2) == 6
    assert len({score.version for score in upgraded.queries.scores(submission=id)}) == 2
    assert shown(upgraded, running).state == "scored"


def test_erasure_removes_method_name_everywhere(service: Service) -> None:
    submitter = new_submitter(service, "Lovelace and sons")
    names = {"request": "Lovelace-1", "method": "Lovelace's robot"}
    id = service.submit(submitter, dataclasses.replace(draft(), **names))
    scored(service, new_submitter(service), 2.0)
    sha256 = str(shown(service, id).artefact)
    http = TestClient(create_app(service))
    paths = [f"/api/submissions/{id}", "/api/submissions", f"/api/boards/{TASK}"]
    paths += [f"/api/submissions/{id}/receipt", f"/submissions/{id}", f"/tasks/{TASK}"]
    paths += [f"/submissions/{id}/method", f"/tasks/{TASK}/heatmap", f"/tasks/{TASK}.csv"]
    assert all("Lovelace" in http.get(path).text for path in paths)
    service.erase_submitter(submitter)
    time.sleep(1.1)  # a page may be a second old
    for path in paths:
        http.get(path)  # a reader is shown the copy while a new one is made
    assert soon(lambda: not any("Lovelace" in http.get(path).text for path in paths))
    service.database.close()
    with service.database.read() as connection:
        tables = [connection.execute(table.select()).all() for table in METADATA.sorted_tables]
    assert "Lovelace" not in repr(tables)
    with pytest.raises(Problem, match="no artefact"):
        service.artefacts.get(sha256)
    erased = shown(service, id)
    assert (erased.submitter, erased.method) == (f"erased-{submitter}", "erased")
    receipt = service.queries.receipt(id)
    assert receipt is not None
    content = verify_receipt(receipt, service.signer.public_key)
    entries = service.queries.ledger()
    assert check_chain(entries) == len(entries)
    entry = entries[content["ledger"]["seq"] - 1]
    assert (content["method"], content["ledger"]["hash"]) == ("erased", entry.hash)
