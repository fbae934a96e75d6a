"""A board of many methods: pages of rows, short rows, and the places of a season at its top."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from starlette.testclient import TestClient

from tests.board.board_data import ROBOTS, Robot, add_care, make_app
from tests.board.browser import accessibility_faults, opened
from tests.board.fakes import close_spring, declared, new_service, new_submitter, work_off
from tests.board.running import serving
from tests.board.test_pages_browser import tab_to
from tests.board.test_pages_visitors import methods
from tests.board.test_season import open_season
from tests.system import CHROMIUM, needs

BOARD = "/tasks/scratch"
ENTRIES, SINGLES = 53, 12
LARGE = (
    *ROBOTS[:3],
    *(
        Robot(f"laboratory of robotics {i}", f"population play {i}", 300.0 + i, seeds=2)
        for i in range(ENTRIES)
    ),
    *(Robot("visitor", f"single robot {i}", 200.0 + i) for i in range(SINGLES)),
)


@pytest.fixture(scope="module", params=["", "care"])
def large(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[str]:
    """Serve a board of more methods than a page has rows, once with columns of care."""
    folder = tmp_path_factory.mktemp("large")
    app = make_app(folder, LARGE)
    if request.param:
        add_care(folder)
    with serving(app) as address:
        yield address


@pytest.mark.slow
def test_a_long_board_has_pages(tmp_path: Path) -> None:
    with TestClient(make_app(tmp_path, LARGE)) as client:
        first = client.get(BOARD).text
        listed, singles = first.split('id="singles"')
        assert len(methods(listed)) == 50 and "rows 1 to 50 of 56" in listed
        assert len(methods(singles)) == 10 and "All 12 single robots" in singles
        second = client.get(f"{BOARD}?page=2").text
        rest = methods(second)
        assert len(rest) == 6 and not set(rest) & set(methods(listed))
        assert 'rel="prev" href="/tasks/scratch"' in second and 'rel="next"' not in second
        assert 'rel="next" href="/tasks/scratch?page=2"' in first
        assert methods(client.get(f"{BOARD}?page=999").text) == rest, "there is no further one"
        found = client.get(f"{BOARD}?search=population&sort=method&page=2").text
        assert len(methods(found)) == ENTRIES - 50
        assert 'href="/tasks/scratch?sort=method&amp;search=population"' in found
        assert len(methods(client.get(f"{BOARD}?show=singles").text)) == SINGLES
        for page in ("0", "-1", "x", "99999999999999999999"):
            assert client.get(f"{BOARD}?page={page}").status_code == 422


@pytest.mark.slow
@needs("chromium", CHROMIUM)
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (1400, "dark"), (400, "light")])
def test_rows_of_a_long_board_are_short(
    browser: Browser, large: str, width: int, scheme: str
) -> None:
    """A row of four lines was 120 points high, and a method's column 70 to 100 wide."""
    with opened(browser, width, scheme) as page:
        page.goto(f"{large}{BOARD}")
        rows = page.locator(".board tbody tr").all()
        names = page.locator(".board tbody th").all()
        assert len(rows) == 60
        heights = [box["height"] for row in rows[:8] if (box := row.bounding_box())]
        widths = [box["width"] for name in names[:8] if (box := name.bounding_box())]
        assert max(heights) < (75 if width == 1400 else 110)
        assert min(widths) > 250
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert accessibility_faults(page) == []


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_keyboard_alone_sorts_turns_the_page_and_opens_a_method(
    browser: Browser, large: str
) -> None:
    with opened(browser, 1400) as page:
        page.goto(f"{large}{BOARD}")
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
        page.keyboard.press("Enter")
        tab_to(page, page.get_by_label("sort by"))
        page.keyboard.type("name")
        tab_to(page, page.get_by_role("button", name="Show"))
        page.keyboard.press("Enter")
        page.wait_for_url("**sort=method**")
        page.locator("#main").focus()  # as after the link that skips
        tab_to(page, page.get_by_role("link", name="Next").first)
        page.keyboard.press("Enter")
        page.wait_for_url("**page=2**")
        row = page.locator(".board tbody th a").first
        name = row.inner_text()
        tab_to(page, row)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", level=1)).to_have_text(name)


@pytest.mark.slow
@needs("chromium", CHROMIUM)
@pytest.mark.parametrize("width", [1400, 400])
def test_places_of_a_closed_season_stand_at_its_top(
    browser: Browser, tmp_path: Path, width: int
) -> None:
    """Long names had pushed the returns out of the window, and the marks of copies."""
    from assistax_board.app import create_app

    service = new_service(tmp_path)
    season = open_season(service)
    for lab in ("institute for assistive robotics and care", "copyist"):
        method = "a recurrent policy over histories with a belief of preferences"
        owner = new_submitter(service, lab)
        declared(service, owner, 1.0, 2.0, request=lab, season=season, method=method)
    work_off(service)
    close_spring(service)
    with serving(create_app(service)) as address, opened(browser, width) as page:
        page.goto(f"{address}/seasons/{season}")
        place = page.locator(".rank").first.bounding_box()
        # Of a window 1,000 high; it was at 1,130. On a telephone the words above take more lines.
        assert place is not None and place["y"] < (600 if width == 1400 else 900)
        for seen in ("td.mean", "th .copy"):
            box = page.locator(seen).first.bounding_box()
            assert box is not None and box["x"] + box["width"] <= width
        page.goto(f"{address}{BOARD}")
        row = page.locator("tr:has(.copy)").bounding_box()
        mark = page.locator(".copy").bounding_box()
        assert row is not None and mark is not None
        assert mark["width"] > 200 and mark["x"] + mark["width"] <= row["x"] + row["width"]
        assert accessibility_faults(page) == []
