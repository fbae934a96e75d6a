"""A browser plays recorded pointer paths, saves, and Python replays the logs."""

import functools
import json
import re
import threading
from collections.abc import Generator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from assistax_zoo.shell.main import run
from evaluation.people.log import LogError
from evaluation.people.replaying import MOST_OFF, SCRIPT_OFF, replay_log
from evaluation.seat.page import default_robots, network_of, published, write_page
from tests.board.browser import accessibility_faults, browsing, opened
from tests.seat.paths import CONSENT, MORE_PATHS, PATHS, open_page, play, save
from tests.system import CHROMIUM, needs
from zoo.registry import load_registry

pytestmark = [pytest.mark.slow, needs("chromium", CHROMIUM)]
WIDTHS = (400, 1400)


@pytest.fixture(scope="module")
def browser() -> Generator[Browser]:
    with browsing() as browser:
        yield browser


@pytest.fixture(scope="module", params=PATHS)
def task(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, bool], Path]:
    """Pages of each task, with robots by name and blind."""
    folder, registry, made = tmp_path_factory.mktemp("pages"), load_registry(), {}
    for task in PATHS:
        network = network_of(task)
        robots = published(registry, default_robots(registry, task, network), network)
        for study in (False, True):
            made[task, study] = folder / f"{task}-{study}.html"
            write_page(task, robots, made[task, study], study=study)
    return made


def scrolls_sideways(page: Page) -> bool:
    return page.evaluate("document.documentElement.scrollWidth > innerWidth")


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("robot", [0, 1, 2])
def test_an_episode_is_saved_and_replays(
    browser: Browser,
    files: dict[tuple[str, bool], Path],
    task: str,
    robot: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with opened(browser, 1400) as page:
        open_page(page, files[task, False])
        page.locator("#robots input").nth(robot).check()
        play(page, PATHS[task], word="1")
        path = save(page, tmp_path)
    log = json.loads(path.read_text())
    assert replay_log(path, load_registry()).off < SCRIPT_OFF
    assert run(["people", str(tmp_path), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert "people/" in capsys.readouterr().out
    log["words"] = log["words"][:-4] + "AQEB"
    path.write_text(json.dumps(log))
    with pytest.raises(LogError):
        replay_log(path, load_registry())


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("task", MORE_PATHS)
def test_logs_of_every_other_task_replay(browser: Browser, task: str, tmp_path: Path) -> None:
    registry, network, place = load_registry(), network_of(task), tmp_path / "page.html"
    robots = published(registry, default_robots(registry, task, network), network)
    write_page(task, robots, place, study=False)
    with opened(browser, 1400) as page:
        open_page(page, place)
        page.locator("#robots input").last.check()  # the network
        play(page, MORE_PATHS[task], word="1")
        path = save(page, tmp_path)
    assert replay_log(path, registry).off < MOST_OFF


def test_a_study_hides_names_and_plays_all_in_one_order(
    browser: Browser, files: dict[tuple[str, bool], Path], task: str, tmp_path: Path
) -> None:
    with opened(browser, 1400) as page:
        open_page(page, files[task, True])
        assert "gru" not in page.locator("main").inner_text()
        expect(page.locator("#robots")).to_contain_text("robot A")
        play(page, PATHS[task])
        log = json.loads(save(page, tmp_path).read_text())
        assert log["study"]["blind"] and log["study"]["block"] == 1
        assert log["robot"]["name"] == log["study"]["order"][0]
        names = page.evaluate("seat.header.robots.map((one) => one.name)")
        assert sorted(log["study"]["order"]) == sorted(names)
        assert page.evaluate("[seat.study.turn, seat.start]") == [1, log["start"]]
        expect(page.locator("#start")).to_have_text(re.compile("Start robot [ABC]"))


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_for_everybody(
    browser: Browser, files: dict[tuple[str, bool], Path], task: str, width: int
) -> None:
    asked: list[str] = []
    with opened(browser, width) as page:
        page.on("request", lambda request: asked.append(request.url))
        open_page(page, files[task, False])
        assert accessibility_faults(page) == []
        assert not scrolls_sideways(page)
        page.locator("#start").click()
        expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
        assert accessibility_faults(page) == []
        assert not scrolls_sideways(page)
    elsewhere = [url for url in asked if not url.startswith(("blob:", "data:"))]
    assert elsewhere == [files[task, False].as_uri()]


def test_a_keyboard_alone_plays_and_saves(
    browser: Browser, files: dict[tuple[str, bool], Path], task: str, tmp_path: Path
) -> None:
    with opened(browser, 1400) as page:
        open_page(page, files[task, False])
        to(page, "#start")
        page.keyboard.press("Enter")
        expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
        before = page.evaluate("Array.from(seat.pointer.sample(0, seat.cameraNow()))")
        page.keyboard.down("ArrowRight")
        page.wait_for_timeout(700)
        page.keyboard.up("ArrowRight")
        after = page.evaluate("Array.from(seat.pointer.sample(0, seat.cameraNow()))")
        assert max(abs(a - b) for a, b in zip(after, before, strict=True)) > 0.05
        page.keyboard.press("1")
        expect(page.locator("#said")).to_have_text(
            f"you said: {page.evaluate('seat.header.asked[0]')}"
        )
        expect(page.locator("#result")).to_be_visible(timeout=60_000)
        for box in range(3):
            to(page, f"{CONSENT} >> nth={box}")
            page.keyboard.press("Space")
        to(page, "#download")
        with page.expect_download() as download:
            page.keyboard.press("Enter")
        download.value.save_as(tmp_path / "log.json")
    log = json.loads((tmp_path / "log.json").read_text())
    assert log["device"]["kind"] == "keyboard"
    assert log["steps"] <= 1000


def test_a_finger_moves_the_hand(browser: Browser, files: dict[tuple[str, bool], Path]) -> None:
    with opened(browser, 400) as page:
        open_page(page, files["gentle_scratch", False])
        page.locator("#start").click()
        expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
        box = page.locator("#stage").bounding_box()
        assert box
        at = {"clientX": box["x"] + 0.6 * box["width"], "clientY": box["y"] + 0.4 * box["height"]}
        page.dispatch_event("#stage", "pointermove", {"pointerType": "touch", **at})
        page.wait_for_timeout(1500)
        aim = page.locator("#aim").evaluate("(one) => new DOMMatrix(one.style.transform)")
        assert (
            abs(aim["e"] - 0.6 * box["width"]) < 3.0 and abs(aim["f"] - 0.4 * box["height"]) < 3.0
        )
        assert page.evaluate("seat.pointer.used") == "touch"


def test_a_static_host_without_special_headers_suffices(
    browser: Browser, files: dict[tuple[str, bool], Path]
) -> None:
    file = files["gentle_feeding", False]
    handler = functools.partial(SimpleHTTPRequestHandler, directory=str(file.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with opened(browser, 1400) as page:
            page.goto(f"http://127.0.0.1:{server.server_port}/{file.name}")
            expect(page.locator("body")).to_have_class("ready", timeout=60_000)
        server.shutdown()


def test_a_browser_that_cannot_draw_is_told(
    browser: Browser, files: dict[tuple[str, bool], Path]
) -> None:
    with opened(browser, 400) as page:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        open_page(page, files["gentle_feeding", False])
        expect(page.locator("#missing")).to_be_visible()
        expect(page.locator("#start")).to_be_disabled()


def test_late_steps_are_counted(browser: Browser, files: dict[tuple[str, bool], Path]) -> None:
    with opened(browser, 400) as page:
        open_page(page, files["gentle_scratch", False])
        page.locator("#start").click()
        expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
        before = page.evaluate("seat.recording.dropped")
        page.evaluate(
            "() => { const end = performance.now() + 1500; while (performance.now() < end); }"
        )
        page.wait_for_timeout(500)
        assert page.evaluate("seat.recording.dropped") - before >= 60


def test_escape_stops_and_nothing_is_offered(
    browser: Browser, files: dict[tuple[str, bool], Path]
) -> None:
    with opened(browser, 400) as page:
        open_page(page, files["gentle_scratch", False])
        page.locator("#start").click()
        expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
        page.keyboard.press("Escape")
        expect(page.locator("#start")).to_have_text("Start")
        expect(page.locator("#result")).to_be_hidden()


def to(page: Page, selector: str, most: int = 60) -> None:
    """Press the tabulator until something has the focus."""
    wanted = page.locator(selector)
    for _ in range(most):
        if wanted.evaluate("(one) => one === document.activeElement"):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{selector} cannot be reached by the tabulator")
