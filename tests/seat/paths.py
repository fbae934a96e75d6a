"""Recorded pointer paths: what a test's hand does in the page. No person played these."""

from collections.abc import Callable
from math import cos, sin
from pathlib import Path

from playwright.sync_api import Page, expect

# At a time in s: place on the picture from -1 to 1, and whether the button is held down.
PointerPath = Callable[[float], tuple[float, float, bool]]


def waves(time: float) -> tuple[float, float, bool]:
    """Move the hand, or the head, in slow waves."""
    return 0.1 * sin(0.9 * time), 0.1 * cos(0.7 * time), False


def meal(time: float) -> tuple[float, float, bool]:
    """Look ahead, and open the mouth for half of each four seconds."""
    return 0.02 * sin(time), 0.0, time % 4.0 > 2.0


PATHS = {"gentle_scratch": waves, "gentle_feeding": meal}
# Of the other tasks: these are played once each.
MORE_PATHS = {"gentle_bath": waves, "gentle_lift": waves, "gentle_brushing": meal}
CONSENT = "#save input"


def open_page(page: Page, file: Path) -> None:
    """Open a page of the seat and wait until it can be played."""
    page.goto(file.as_uri())
    expect(page.locator("body")).to_have_class("ready", timeout=60_000)


def play(page: Page, path: PointerPath, word: str = "") -> None:
    """Play one episode along a pointer path, saying a word each two seconds."""
    page.locator("#start").click()
    expect(page.locator("#start")).to_have_text("Stop", timeout=30_000)
    box = page.locator("#stage").bounding_box()
    assert box
    held, said = False, 0.0
    while page.evaluate("seat.playing"):
        time = page.evaluate("seat.module.one('state', '.step')") / 50.0
        x, y, holds = path(time)
        centre = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(centre[0] + x * box["width"] / 2, centre[1] - y * box["height"] / 2)
        if holds != held:
            (page.mouse.down if holds else page.mouse.up)()
            held = holds
        if word and time > said + 2.0:
            page.keyboard.press(word)
            said = time
        page.wait_for_timeout(40)
    page.mouse.up()
    expect(page.locator("#start")).to_contain_text("Start")


def save(page: Page, folder: Path) -> Path:
    """Save the episode that was played, and return its log."""
    for box in page.locator(CONSENT).all():
        box.check()
    with page.expect_download() as download:
        page.locator("#download").click()
    log = folder / download.value.suggested_filename
    download.value.save_as(log)
    return log
