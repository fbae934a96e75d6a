"""Guides are short, and all pages without the log stay readable in an evening or two."""

import copy

import pytest

from tools import docs_size


def test_guides_and_concepts_are_within_their_bars() -> None:
    words = docs_size.count_words()
    assert {"start.md", "robot.md", "training.md", "publish.md", "run_board.md"} <= set(
        words["Guides"]
    )
    assert docs_size.find_problems(words) == []


def test_every_page_of_docs_is_counted_once() -> None:
    pages = [page for group, names in docs_size.count_words().items() for page in names]
    docs = docs_size.ROOT / "docs"
    assert sorted(set(pages) - {"README.md"}) == sorted(
        name
        for path in docs.rglob("*.md")
        if not (name := path.relative_to(docs).as_posix()).startswith("data/")
    )
    assert len(pages) == len(set(pages))


@pytest.mark.parametrize(
    ("group", "page", "count", "problem"),
    [
        ("Guides", "start.md", 1_201, "start.md has 1,201 words"),
        ("Home", "README.md", 1_201, "README.md has 1,201 words"),
        ("Concepts", "concepts.md", 12_000, "guides and concepts have"),
        ("Reference", "tasks.md", 25_000, "pages without the log have"),
    ],
)
def test_a_page_that_grew_too_long_is_found(
    group: str, page: str, count: int, problem: str
) -> None:
    words = copy.deepcopy(docs_size.count_words())
    words[group][page] = count
    assert any(text.startswith(problem) for text in docs_size.find_problems(words))


def test_the_log_and_notebooks_may_grow() -> None:
    words = copy.deepcopy(docs_size.count_words())
    words["Log"]["log/care.md"] = 100_000
    words["Notebooks"]["notebook.md"] = 100_000
    assert docs_size.find_problems(words) == []
