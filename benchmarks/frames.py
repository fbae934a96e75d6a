"""Frames of the page on which a visitor is the person, in a headless browser."""

import dataclasses
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from assistax_zoo.shell.console import print_json, stdout_is_data

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# Without a graphics processor, as CI has none.
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")


@dataclasses.dataclass(frozen=True)
class FrameTimes:
    """Times of an episode's frames, ms, and the steps that came too late."""

    task: str
    frames: int
    median_ms: float
    p99_ms: float
    frames_a_second: float
    dropped: int
    step_us: float  # one step alone: the person's body, the robot's network and the simulation


def frames(*, task: str = "gentle_scratch", width: int = 1400, json: bool = False) -> None:
    """Measure the frames of an episode that is played in the page, drawn without a GPU.

    Args:
        task: A gentle task.
        width: Of the window, pixels.
        json: Print one JSON document instead of text.
    """
    with stdout_is_data():
        found = measure(task, width)
    if json:
        print_json(dataclasses.asdict(found))
        return
    print(
        f"{found.task}: {found.frames} frames, {found.frames_a_second:.0f} a second, work of one "
        f"{found.median_ms:.1f} ms (99%: {found.p99_ms:.1f} ms), {found.dropped} steps too late, "
        f"a step {found.step_us:.0f} us"
    )


def measure(task: str, width: int) -> FrameTimes:
    """Return the frame times of one episode with a published robot.

    Raises:
        OSError: There is no Chromium here.
    """
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise OSError("there is no Chromium here; apt-get install chromium")
    with tempfile.TemporaryDirectory(prefix="frames-") as folder, sync_playwright() as playwright:
        path = _page(task, Path(folder))
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        try:
            page = browser.new_page(viewport={"width": width, "height": 1000})
            page.goto(path.as_uri())
            page.locator("body.ready").wait_for(timeout=60_000)
            page.locator("#robots input").last.check()
            page.locator("#start").click()
            page.locator("body.playing").wait_for(timeout=60_000)
            while page.evaluate("seat.playing"):
                page.wait_for_timeout(200)
            step = page.evaluate(STEP)
            return _times(task, page.evaluate("seat.frames"), page.evaluate(LATE), step)
        finally:
            browser.close()


LATE = "[seat.recording.dropped, seat.module.one('state', '.step') * seat.header.seconds]"
STEP = """() => {
  seat.module.begin(0, seat.card.wish, seat.header.robots.length - 1);
  const point = seat.pointer.sample(0, seat.cameraNow());
  const begun = performance.now();
  for (let k = 0; k < 500; ++k) {
    seat.module.decide(point);
    seat.module.step(0);
  }
  return (1e3 * (performance.now() - begun)) / 500;
}"""


def _page(task: str, folder: Path) -> Path:
    """Write the page of a task with the robots that it has by default."""
    from evaluation.seat.page import default_robots, network_of, published, write_page
    from zoo.registry import load_registry

    registry, network, path = load_registry(), network_of(task), folder / "page.html"
    names = default_robots(registry, task, network)
    write_page(task, published(registry, names, network), path)
    return path


def _times(task: str, work: list[float], late: list[Any], step: float) -> FrameTimes:
    dropped, seconds = late
    return FrameTimes(
        task=task,
        frames=len(work),
        median_ms=float(np.median(work)),
        p99_ms=float(np.quantile(work, 0.99)),
        frames_a_second=len(work) / (seconds + 0.02 * dropped),
        dropped=int(dropped),
        step_us=step,
    )
