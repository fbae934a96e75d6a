"""Pages in a real browser: read, found with the keyboard, and drawn; nothing keeps anybody out."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from assistax_board import pages
from evaluation.player.episode import Episode, episode_content
from evaluation.player.page import pack
from tests.board import running
from tests.board.board_data import add_care, make_app
from tests.board.browser import accessibility_faults, opened
from tests.board.fakes import new_service, work_off
from tests.board.test_pages import Films
from tests.system import CHROMIUM, needs

pytestmark = [pytest.mark.slow, needs("chromium", CHROMIUM)]
expect.set_options(timeout=60_000)  # waits no longer than it must


def submissions(page: Page, address: str) -> list[str]:
    """Return the page of a scored submission, of one that waits, and of the first's method."""
    page.goto(f"{address}/tasks/scratch")
    links = page.locator(".board tbody a").first, page.locator(".queue a").first
    scored, waiting = (str(link.get_attribute("href")) for link in links)
    return [scored, waiting, f"{scored}/method"]


def test_links_lead_from_board_to_explorer(browser: Browser, address: str) -> None:
    with opened(browser) as page:
        page.goto(f"{address}/tasks/scratch")
        page.get_by_role("link", name="ppo ego").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("ppo ego")
        expect(page.get_by_role("status")).to_contain_text("place 1")
        page.get_by_role("link", name="scratch", exact=True).first.click()
        page.get_by_role("link", name="Cross-play explorer").click()
        expect(page.locator("body")).to_have_attribute("data-matrix", "198x198")
        expect(page.locator("body")).to_have_attribute("data-measures", "8")
        box = page.locator("#matrix").bounding_box()
        assert box
        page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
        expect(page.locator("#tip")).to_contain_text("robot scratch/")
        pair = re.findall(r"(?:robot|human) scratch/([\w-]+)/", page.locator("#tip").inner_text())
        page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
        page.wait_for_url(f"**/pairs/scratch/{pair[0]}/{pair[1]}")


def test_the_explorer_opens_soon_and_is_searched(browser: Browser, address: str) -> None:
    """It is drawn within a second, by the best of five: others may use this machine."""
    milliseconds = []
    with opened(browser) as page:
        for _ in range(5):
            page.goto(f"{address}/tasks/scratch/explorer")
            expect(page.locator("body")).to_have_attribute("data-matrix", "198x198")
            mark = "performance.getEntriesByName('matrix-drawn')[0].startTime"
            milliseconds.append(page.evaluate(mark))
        assert min(milliseconds) < 1000, milliseconds
        expect(page.locator("body")).to_have_attribute("data-measures", "8")
        drawn = [page.locator("#matrix").screenshot()]
        for control, choice in (("order", "disability"), ("measure", "force_mean")):
            page.locator(f"#{control}").select_option(choice)
            drawn.append(page.locator("#matrix").screenshot())
        page.locator("#find").fill("masac-d9-s5")
        drawn.append(page.locator("#matrix").screenshot())
        page.get_by_role("button", name="zoom in").click()
        drawn.append(page.locator("#matrix").screenshot())
        assert len(set(drawn)) == 5


def test_keyboard_alone_opens_a_pair(browser: Browser, address: str) -> None:
    with opened(browser) as page:
        page.goto(f"{address}/tasks/scratch")
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
        page.keyboard.press("Enter")
        tab_to(page, page.get_by_role("link", name="Cross-play explorer"))
        page.keyboard.press("Enter")
        expect(page.locator("body")).to_have_attribute("data-measures", "8")
        tab_to(page, page.locator("#matrix"))
        for key in ("ArrowDown", "ArrowDown", "ArrowRight", "+", "ArrowRight"):
            page.keyboard.press(key)
        expect(page.locator("#told")).to_contain_text("robot scratch/")
        told = re.findall(r"(?:robot|human) scratch/([\w-]+)/", page.locator("#told").inner_text())
        page.keyboard.press("Enter")
        page.wait_for_url(f"**/pairs/scratch/{told[0]}/{told[1]}")


def tab_to(page: Page, target: object) -> None:
    """Press Tab until the focus is there, as a reader without a mouse does."""
    for _ in range(60):
        page.keyboard.press("Tab")
        if target.evaluate("one => one === document.activeElement"):  # ty: ignore
            return
    pytest.fail("the keyboard does not lead there")


LINES = """[...document.querySelectorAll(".board tbody tr")].map((row) => {
  const boxes = [...row.children].map((cell) => cell.getBoundingClientRect());
  const middles = boxes.filter((box) => box.height).map((box) => box.y + box.height / 2);
  middles.sort((a, b) => a - b);
  return 1 + middles.slice(1).filter((y, i) => y - middles[i] > 10).length;
})"""
HEIGHT = "document.querySelector('.board tbody tr').getBoundingClientRect().height"


def test_board_row_is_three_lines_on_telephone(browser: Browser, address: str) -> None:
    """Each method: its place and name, its return and interval, and two figures more."""
    with opened(browser, 400) as page:
        page.goto(f"{address}/tasks/scratch")
        assert page.evaluate(LINES) == [3] * 7
        assert page.evaluate(HEIGHT) < 110
        row = page.get_by_role("row", name="ppo ego").inner_text()
        assert "987" in row and " to " in row and "4 of 4 declared" in row


def test_columns_of_care_stay_within_the_page(browser: Browser, tmp_path: Path) -> None:
    """A row of them is three lines on a telephone too; elsewhere a wide table scrolls by itself."""
    app = make_app(tmp_path)
    add_care(tmp_path)
    with running.serving(app) as address:
        for width in (400, 1010, 1280):
            with opened(browser, width) as page:
                page.goto(f"{address}/tasks/scratch")
                assert page.evaluate("document.documentElement.scrollWidth") <= width
                assert accessibility_faults(page) == []
                row = page.get_by_role("row", name="ppo ego").inner_text()
                assert "10%" in row and ("0.50" in row) == (width > 400)
                if width == 400:
                    assert page.evaluate(LINES) == [3] * 7
                    assert page.evaluate(HEIGHT) < 110


def test_colour_switch_works_with_and_without_scripts(browser: Browser, address: str) -> None:
    context = browser.new_context(java_script_enabled=False, color_scheme="light")
    plain = context.new_page()
    plain.goto(address)
    before = plain.locator("body").screenshot()
    plain.get_by_text("dark", exact=True).click()
    assert plain.locator("body").screenshot() != before
    context.close()
    with opened(browser) as page:
        page.goto(address)
        page.get_by_text("dark", exact=True).click()
        page.goto(f"{address}/seasons")
        shown = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert shown == "rgb(20, 24, 29)"


def test_pages_are_read_without_scripts(browser: Browser, address: str) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"{address}/tasks/scratch/explorer")
    expect(page.locator("#explorer-controls")).to_be_hidden()
    page.get_by_label("robot").select_option("ippo-d2-s3-v1")
    page.get_by_label("human").select_option("masac-d1-s0-v1")
    page.get_by_role("button", name="Open").click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("ippo-d2-s3-v1")
    page.goto(f"{address}/tasks/scratch/partners")
    page.get_by_label("disability").select_option("d4")
    page.get_by_role("button", name="Filter").click()
    expect(page.get_by_text("22 of 198 partners")).to_be_visible()
    context.close()


@pytest.mark.parametrize("scripts", [True, False])
def test_form_submits_with_and_without_scripts(
    browser: Browser, tmp_path: Path, scripts: bool
) -> None:
    service = new_service(tmp_path)
    token = service.create_token(("submit",), submitter="Lab of Ada")
    context = browser.new_context(java_script_enabled=scripts)
    with running.served(service) as server:
        page = context.new_page()
        page.goto(server.address)
        page.get_by_role("link", name="submit", exact=True).click()
        fill_in(page, "not a token")
        expect(page.get_by_role("alert")).to_contain_text("this token is not valid")
        expect(page.get_by_label("Method")).to_have_value("mine & best")
        fill_in(page, token)
        expect(page.get_by_role("status")).to_contain_text("number 1 in the queue")
        work_off(service)
        if not scripts:
            look_again(page)
        expect(page.get_by_role("status")).to_contain_text("scored")
        with page.expect_download() as download:
            page.get_by_role("link", name="Download it").click()
        receipt = json.loads(Path(download.value.path()).read_text())
        assert receipt["content"]["submission"] == service.queries.submissions()[0].id
        page.get_by_role("link", name="scratch", exact=True).last.click()
        expect(page.get_by_role("row", name="mine & best")).to_contain_text("5.5")
    context.close()


def look_again(page: Page) -> None:
    """Load a page anew until it tells of the end: what it shows may be a second old."""
    for _ in range(30):
        page.wait_for_timeout(1100)
        link = page.get_by_role("link", name="reload it")
        if not link.count():
            return
        link.click()


def fill_in(page: Page, token: str) -> None:
    """Fill the form in from the keyboard, and hand in a robot of strength 5."""
    robot = {"name": "robot.onnx", "mimeType": "application/octet-stream", "buffer": b"robot 5.0"}
    page.get_by_label("Robot").set_input_files(robot)
    page.get_by_label("Method").fill("mine & best")
    page.get_by_label("Your token").fill(token)
    page.keyboard.press("Enter")


def still_episode() -> bytes:
    """Return what players load of an episode in which nobody moves."""
    zero, length = np.zeros(6), 6
    about = {"task": "scratch", "robot": "r", "person": "h", "setting": "d1", "version": 1}
    episode = Episode(
        about={**about, "seed": 0, "number": 0},
        poses=np.zeros((length, 16)),
        velocities=np.zeros((length, 16)),
        targets={"itch": np.full((length, 3), 0.5)},
        preferences={},
        force=zero,
        speed=None,
        reward=np.arange(6.0),
        terms={"scratch": np.arange(6.0)},
        stopped=False,
    )
    return pack(episode_content(episode))


class StillFilms(Films):
    """Films whose episode can be played; in place of `pages.run_command`."""

    def __call__(
        self, arguments: Sequence[str], folder: Path, registry: Path | None = None
    ) -> None:
        super().__call__(arguments, folder)
        if arguments[0] == "watch":
            Path(arguments[-1]).write_bytes(still_episode())


@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1280, "light")])
def test_episode_plays_after_its_film(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, width: int, scheme: str
) -> None:
    """The page's policy lets the player run, and nothing of the page keeps anybody out."""
    monkeypatch.setattr(pages, "run_command", StillFilms())
    with running.serving(make_app(tmp_path)) as address, opened(browser, width, scheme) as page:
        page.goto(f"{address}/pairs/scratch/ippo-d1-s0-v1/ippo-d1-s1-v1")
        assert page.locator("canvas").count() == 0
        page.get_by_role("button", name="Film this pair").click()
        player = page.locator("[data-steps]")
        expect(player).to_have_attribute("data-steps", "5")
        expect(page.locator("canvas")).to_be_visible()
        player.focus()
        page.keyboard.press("End")
        expect(page.get_by_text("0.10 of 0.10 s")).to_be_visible()
        expect(page.locator(".episode-now")).to_contain_text("15.0 in the end")
        expect(page.get_by_text("As a film")).to_be_visible()
        assert accessibility_faults(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width
