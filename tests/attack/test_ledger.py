"""The counts of a family, which `make attack` prints."""

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.attack import ledger


def test_a_failed_trial_is_counted_and_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "attack.jsonl"
    monkeypatch.setattr(ledger, "LOG", str(log))
    monkeypatch.setattr(ledger, "SHARE", 0.1)
    for fails in (False, True):
        counted = ledger.Ledger("a family")
        with counted.trial("one"):
            assert not fails, "a false figure"
        ends = pytest.raises(AssertionError, match="a false figure") if fails else nullcontext()
        with ends:
            counted.close()
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert [(line["trials"], line["failures"]) for line in lines] == [(1, 0), (1, 1)]
    assert {line["family"] for line in lines} == {"a family"}
    assert {line["share"] for line in lines} == {0.1}
