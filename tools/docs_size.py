"""Word count of the documentation by page and group: `python -m tools.docs_size`.

Groups are the sections of `nav` in zensical.toml. Guides and concepts are for reading through, so
their words are bounded. All pages that a user may have to read are bounded together: not the log,
which has every measurement, nor notebooks.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
MAX_GUIDE = 1_200  # words of a guide, of README too
MAX_READ = 12_000  # words of all guides and concepts
READ = ("Guides", "Concepts")
MAX_PAGES = 25_000  # words of all pages but those of `APART`
APART = ("Log", "Notebooks")


def count_words(root: Path = ROOT) -> dict[str, dict[str, int]]:
    """Return the number of words of each page, by group, without generated pages."""
    nav = tomllib.loads((root / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]
    groups = {group: pages for entry in nav for group, pages in entry.items()}
    return {
        group: {
            page: _words(root / "docs" / page)
            for page in _names(pages)
            if (root / "docs" / page).is_file()
        }
        for group, pages in groups.items()
    } | {"Home": {"README.md": _words(root / "README.md")}}


def _words(page: Path) -> int:
    """Return the number of a page's words; marks such as a table's bars are none."""
    return sum(any(map(str.isalnum, word)) for word in page.read_text(encoding="utf-8").split())


def find_problems(words: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return messages for pages and groups that are too long."""
    bounded = {**words["Home"], **words["Guides"]}
    problems = [
        f"{page} has {count:,} words; a guide has at most {MAX_GUIDE:,}: move details to a "
        "reference page"
        for page, count in bounded.items()
        if count > MAX_GUIDE
    ]
    total = sum(sum(words[group].values()) for group in READ)
    if total > MAX_READ:
        problems.append(f"guides and concepts have {total:,} words; at most {MAX_READ:,}")
    total = sum(sum(pages.values()) for group, pages in words.items() if group not in APART)
    if total > MAX_PAGES:
        problems.append(
            f"pages without the log have {total:,} words; at most {MAX_PAGES:,}: say a thing once, "
            "and link to it"
        )
    return problems


def _names(pages: Any) -> list[str]:
    """Return the pages of a `nav` entry: a name, a list, or names with titles."""
    if isinstance(pages, str):
        return [pages]
    if isinstance(pages, Mapping):
        return [name for value in pages.values() for name in _names(value)]
    return [name for entry in pages for name in _names(entry)]


def main() -> int:
    """Print the words of each page and group; return 1 if there is a problem."""
    words = count_words()
    for group, pages in words.items():
        if pages:
            print(f"{sum(pages.values()):7,}  {group}")
        for page, count in sorted(pages.items(), key=lambda item: -item[1]):
            print(f"{count:7,}    {page}")
    problems = find_problems(words)
    print(
        "\n".join(problems) or f"{sum(map(sum, (x.values() for x in words.values()))):7,}  in all"
    )
    return bool(problems)


if __name__ == "__main__":
    raise SystemExit(main())
