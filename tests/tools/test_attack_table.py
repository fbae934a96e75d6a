"""The table of the attack's counts: made from its log, written between two markers."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.attack import ledger
from tools import attack_table

LINE = {"family": "kills", "trials": 1200, "failures": 0, "struck": 3, "share": 1.0}
LINE |= {"slowest_seconds": 2.25, "most_memory_mib": 1024}


def test_a_ledger_ends_in_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last run of a family counts; a failure and a part of an attack are said."""
    log, page = tmp_path / "attack.jsonl", tmp_path / "page.md"
    monkeypatch.setattr(ledger, "LOG", str(log))
    monkeypatch.setattr(ledger, "SHARE", 0.1)
    monkeypatch.setattr(attack_table, "PAGE", page)
    page.write_text(f"# Counts\n\n{attack_table.BEGIN}\nold\n{attack_table.END}\n\nmore\n")
    for fails in (False, True):
        counted = ledger.Ledger("a family")
        with counted.trial("one"):
            assert not fails, "a false figure"
        ends = pytest.raises(AssertionError, match="a false figure") if fails else nullcontext()
        with ends:
            counted.close()
    assert attack_table.main([str(log)]) == 0
    text = page.read_text()
    assert text.startswith("# Counts\n\n<!--") and text.endswith("-->\n\nmore\n")
    assert "| a family | 1 |  | 1 |" in text and "old" not in text
    assert "1 trials of 1 families, 1 failures. This was no whole attack: a share of 0.1" in text


def test_sums_are_of_all_families() -> None:
    text = attack_table.table([LINE, {**LINE, "family": "locks", "failures": 2}])
    assert "| kills | 1,200 | 3 | 0 | 2.2 | 1,024 |" in text
    assert text.endswith("2,400 trials of 2 families, 2 failures.")


def test_a_page_without_markers_is_left(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(attack_table.BEGIN)
    with pytest.raises(ValueError, match="each once"):
        attack_table.write(page, "table")
    assert page.read_text() == attack_table.BEGIN


def test_the_page_has_its_markers() -> None:
    content = (Path(__file__).parents[2] / attack_table.PAGE).read_text(encoding="utf-8")
    assert (content.count(attack_table.BEGIN), content.count(attack_table.END)) == (1, 1)
