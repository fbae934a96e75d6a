"""Every page for every reader: on a telephone and a desk, with a keyboard alone, by axe's rules."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from assistax_board import pages
from assistax_board.app import create_app
from tests.board import running
from tests.board.browser import accessibility_faults, opened
from tests.board.fakes import draft, fail_next_job, new_service, new_submitter, work_off
from tests.board.test_pages_browser import StillFilms, submissions
from tests.board.test_season import open_season
from tests.system import CHROMIUM, needs

pytestmark = [pytest.mark.slow, needs("chromium", CHROMIUM)]
READ = (
    *("/", "/tasks/scratch", "/tasks/arm_assist", "/tasks/scratch/compare"),
    *("/tasks/scratch?search=ego&sort=iqm&show=methods", "/tasks/scratch/heatmap"),
    *("/tasks/scratch/partners?disability=d3", "/partners/scratch/ippo-d1-s0-v1"),
    *("/tasks/gentle_scratch/partners", "/partners/gentle_scratch/person-00042-v1"),
    *("/pairs/scratch/ippo-d1-s0-v1/ippo-d1-s1-v1", "/tasks/scratch/explorer"),
    *("/seasons", "/seasons/5ea5011", "/submit?task=scratch", "/ledger", "/organise", "/docs"),
)
WIDTHS = (400, 1400)
expect.set_options(timeout=60_000)  # waits no longer than it must

# What a pointer can use, and which of it the focus was on; a group of radio buttons is one.
WATCH_THE_FOCUS = """() => {
  const usable = "a[href], button, input, select, textarea, summary, [tabindex]";
  const shown = (one) => one.checkVisibility({visibilityProperty: true}) && !one.disabled;
  window.wanted = [...document.querySelectorAll(usable)].filter(
    (one) => one.tabIndex >= 0 && one.type !== "hidden" && shown(one));
  window.been = new Set();
  window.unseen = new Set();
  const frame = (one) => one && getComputedStyle(one).outlineStyle !== "none";
  document.addEventListener("focusin", ({target}) => {
    window.been.add(target.type === "radio" ? target.name : target);
    if (![target, target.nextElementSibling, target.closest("label")].some(frame))
      window.unseen.add(target);
  });
  return window.wanted.length;
}"""
FAULTS = """() => {
  const text = (one) => one.outerHTML.slice(0, 100);
  const been = (one) => window.been.has(one.type === "radio" ? one.name : one);
  const alone = [...document.querySelectorAll("body *")].filter((one) =>
    getComputedStyle(one).cursor === "pointer"
    && !one.closest("a, button, input, select, summary, label, [tabindex='0']"));
  return [
    ...window.wanted.filter((one) => !been(one)).map((one) => "not reached: " + text(one)),
    ...[...window.unseen].map((one) => "its focus is not seen: " + text(one)),
    ...alone.map((one) => "for a pointer alone: " + text(one)),
  ];
}"""

PLANTED = """() => {
  const main = document.querySelector("main");
  const [fake, faint, trap] = ["b", "a", "a"].map((name) => document.createElement(name));
  main.append(fake, faint, trap);
  for (const one of [fake, faint, trap]) one.textContent = one.href = "/more";
  document.querySelector(".lead").style.color = "#ddd";
  fake.style.cursor = "pointer";
  faint.style.outline = "none";
  faint.addEventListener("keydown", (event) => event.preventDefault());
}"""


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[str], str]]:
    """Serve a season that has closed; yield the address, its pages, and the organiser's token."""
    folder = tmp_path_factory.mktemp("season")
    service = new_service(folder)
    id = open_season(service)
    service.add_references()
    robots = [
        service.submit(new_submitter(service, lab), draft(strength, season=id, licence="MIT"))
        for lab, strength in (("ada", 2.0), ("bob", 6.0))
    ]
    work_off(service)
    service.close_season("spring")
    work_off(service)
    failed = service.submit(new_submitter(service, "eve"), draft(3.0))
    fail_next_job(service)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "run_command", StillFilms())
        with running.serving(create_app(service, films=folder / "films")) as address:
            paths = ["/seasons", f"/seasons/{id}", "/submit", f"/submissions/{failed}"]
            paths += [f"/submissions/{robots[0]}", f"/submissions/{robots[0]}/film"]
            yield address, paths, service.create_token(("organise",))


def faults(page: Page, where: str) -> list[str]:
    """Return everything that keeps somebody out of the page that is shown."""
    found = accessibility_faults(page)
    if page.evaluate("document.documentElement.scrollWidth > innerWidth"):
        found.append("wider than the window")
    return [f"{where}: {one}" for one in found + unreached(page)]


def unreached(page: Page) -> list[str]:
    """Press Tab through a page; return what cannot be used, or whose focus cannot be seen."""
    count = page.evaluate(WATCH_THE_FOCUS)
    page.evaluate("document.activeElement.blur()")
    for _ in range(count + 20):  # a field of a date has several stops
        page.keyboard.press("Tab")
    return page.evaluate(FAULTS)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_every_page_is_everybodys(browser: Browser, address: str, width: int, scheme: str) -> None:
    found = []
    with opened(browser, width, scheme) as page:
        for path in (*READ, *submissions(page, address)):
            page.goto(f"{address}{path}")
            found += faults(page, path)
    assert found == []


@pytest.mark.parametrize("width", WIDTHS)
def test_a_closed_season_and_its_submissions_are_everybodys(
    browser: Browser, season: tuple[str, list[str], str], width: int
) -> None:
    address, paths, _ = season
    found = []
    with opened(browser, width) as page:
        for path in paths:
            page.goto(f"{address}{path}")
            if path.endswith("/film"):
                asking = page.get_by_role("button", name="Film this robot")
                # The second reader finds the film, whose player begins when its script has come.
                expect(asking.or_(page.locator("canvas")).first).to_be_visible()
                if asking.is_visible():
                    asking.press("Enter")
                expect(page.locator("[data-steps]")).to_have_attribute("data-steps", "5")
            found += faults(page, path)
    assert found == []


@pytest.mark.parametrize("width", WIDTHS)
def test_an_organiser_acts_with_the_keyboard_alone(
    browser: Browser, season: tuple[str, list[str], str], width: int
) -> None:
    address, _, token = season
    with opened(browser, width) as page:
        page.goto(f"{address}/organise")
        while not page.locator("#account").evaluate("one => one === document.activeElement"):
            page.keyboard.press("Tab")
        page.keyboard.type(token)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="Failed jobs")).to_be_visible()
        expect(page.get_by_role("row", name="eve mine")).to_contain_text("failed")
        assert faults(page, "/organise") == []


def test_what_keeps_somebody_out_would_be_found(browser: Browser, address: str) -> None:
    with opened(browser) as page:
        page.goto(address)
        page.evaluate(PLANTED)
        found = "\n".join(faults(page, "/"))
    for fault in ("color-contrast", "pointer alone: <b", "not reached: <a", "is not seen: <a"):
        assert fault in found, found
