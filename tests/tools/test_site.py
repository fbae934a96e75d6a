"""The site holds all of docs/, its links lead somewhere, and it fetches nothing from elsewhere."""

import json
import re
from pathlib import Path

import pytest

import assistax_zoo as az
from assistax_zoo.shell.main import all_commands
from evaluation.seat.modules import playable
from tools import site

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return site.build(tmp_path_factory.mktemp("build"))


@pytest.mark.slow
def test_every_page_is_built_and_in_the_navigation(built: Path) -> None:
    settings = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    docs = ROOT / "docs"
    for path in (*docs.glob("*.md"), *docs.glob("log/*.md"), *docs.glob("*.ipynb")):
        page = path.relative_to(docs).with_suffix("").as_posix()
        assert (built / f"{page}.html").is_file()
        assert f'"{page}.md"' in settings, f"{page} is not in nav of zensical.toml"


@pytest.mark.slow
def test_the_site_has_a_page_to_play_for_each_task(built: Path) -> None:
    text = (built / "play.html").read_text(encoding="utf-8")
    for task in playable():
        assert f'href="play/{task}.html"' in text
        assert "Content-Security-Policy" in (built / "play" / f"{task}.html").read_text("utf-8")


@pytest.mark.slow
def test_the_front_page_has_a_film_and_pages_to_play(built: Path) -> None:
    text = (built / "index.html").read_text(encoding="utf-8")
    assert 'src="film.html"' in text
    assert "An episode of gentle_scratch" in (built / "film.html").read_text("utf-8")
    assert all(f'href="play/{task}.html"' in text for task in playable())


@pytest.mark.slow
def test_sections_of_the_menu_are_closed(built: Path) -> None:
    text = (built / "index.html").read_text(encoding="utf-8")
    menu = text.partition('aria-label="Navigation"')[2].partition("</nav>\n")[0]
    assert "md-nav__toggle" in text and "checked" not in menu
    assert "md-nav__item--section" not in text


def test_links_of_all_markdown_files_lead_somewhere() -> None:
    assert site.find_dead_links() == []


def test_a_planted_dead_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "docs" / "data" / "notes.md"
    page.parent.mkdir(parents=True)
    page.write_text("[a](notes.md#x) [b](../gone.md) [c](https://x.org)\n```\n[d](no.md)\n```\n")
    (tmp_path / "README.md").write_text('<img src="docs/none.png">')
    assert site.find_dead_links(tmp_path) == [
        "README.md links to docs/none.png, which is not there",
        "docs/data/notes.md links to ../gone.md, which is not there",
    ]


@pytest.mark.slow
def test_no_table_is_left_as_text(built: Path) -> None:
    for path in built.rglob("*.html"):
        assert not re.search(r"<p>[^<]*\|\s*-{3,}", path.read_text(encoding="utf-8")), path.name
    page = (built / "CONTRIBUTING.html").read_text(encoding="utf-8")
    assert page.count("<table") == 3


@pytest.mark.slow
def test_every_name_and_command_is_in_the_reference(built: Path) -> None:
    page = (built / "api.html").read_text(encoding="utf-8")
    assert [name for name in az.__all__ if f'id="assistax_zoo.{name}"' not in page] == []
    page = (built / "commands.html").read_text(encoding="utf-8")
    places = [f'id="assistax-zoo-{name.replace(".", "-")}"' for name in all_commands()]
    assert [place for place in places if place not in page] == []
    page = (built.parent / "docs" / "commands.md").read_text(encoding="utf-8")
    of_evaluate = page.partition("## assistax-zoo evaluate\n")[2].partition("\n## ")[0]
    assert " --episodes 8 --out results\n```" in of_evaluate  # its example is the end
    assert "default: ()" not in page and "default: *" not in page
    assert "Table of Contents" not in page


@pytest.mark.slow
def test_a_picture_opens_at_its_own_size(built: Path) -> None:
    for name in ("images/gentle_lift.webp", "images/speed.png", "images/my_robot-1.png"):
        pages = [path.read_text(encoding="utf-8") for path in built.rglob("*.html")]
        linked = rf'<a href="(?P<to>(\.\./)?{name})"><img [^>]*src="(?P=to)"'
        assert any(re.search(linked, page) for page in pages), name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "message"),
    [
        ("[x](nowhere.md)", "page does not exist"),
        ("[x](zoo.md#nowhere)", "anchor"),
        ("![x](images/nowhere.png)", "nowhere.png"),
        ("::: assistax_zoo.nothing", "assistax_zoo.nothing"),
        ('<img src="https://example.org/x.png">', "fetches https://example.org/x.png"),
    ],
)
def test_a_planted_defect_stops_the_build(
    planted: str, message: str, tmp_path: Path, monkeypatch
) -> None:
    # The defect is planted in a page between its source and the build.
    relink = site._relink
    monkeypatch.setattr(site, "_relink", lambda *page: f"{relink(*page)}\n\n{planted}\n")
    with pytest.raises(ValueError, match=re.escape(message)):
        site.build(tmp_path)


@pytest.mark.parametrize(
    ("page", "problem"),
    [
        ('<a href="b.html">', None),
        ('<a href="b.html#here">', None),
        ('<a href="#gone">', "a.html links to #gone, which has no such place"),
        ('<a href="b.html#gone">', "a.html links to b.html#gone, which has no such place"),
        ('<a href="c.html">', "a.html links to c.html, which is not there"),
        ('<img src="c.png">', "a.html links to c.png, which is not there"),
        ('<script src="//cdn.org/x.js">', "a.html fetches //cdn.org/x.js"),
        ('<link rel="stylesheet" href="https://x.org/f">', "a.html fetches https://x.org/f"),
        ('<a href="https://example.org">', None),
    ],
)
def test_problems_of_a_page(page: str, problem: str | None, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(page)
    (tmp_path / "b.html").write_text('<p id="here">')
    assert site.find_problems(tmp_path) == ([problem] if problem else [])


def test_a_notebook_keeps_text_tables_and_pictures(tmp_path: Path) -> None:
    png = {"data": {"image/png": "aGVsbG8=", "text/plain": "<Figure>"}}
    html = {"data": {"text/html": ["<table>\n", "\n", "</table>"], "text/plain": "rows"}}
    outputs = [{"text": ["one\n"]}, html, png, {"data": {"text/plain": ["2"]}}]
    cells = [
        {"cell_type": "markdown", "source": ["# Title"]},
        {"cell_type": "code", "source": ["f()"], "outputs": outputs},
    ]
    page = site.notebook_page(json.loads(json.dumps({"cells": cells})), "n", tmp_path)
    assert page.startswith("# Title\n\n```python\nf()\n```\n\n```text\none\n```")
    assert "<table>\n</table>" in page and "```text\n2\n```" in page
    assert "(images/n-1.png)" in page
    assert (tmp_path / "images" / "n-1.png").read_bytes() == b"hello"
