"""A server of pages on the loopback, and a real browser in front of it."""

import contextlib
from collections.abc import Generator
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from tests.system import CHROMIUM

AXE = Path(__file__).parent / "vendor" / "axe-4.14.1.min.js"
# Quiet, and without a call to anywhere.
_FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


@contextlib.contextmanager
def browsing() -> Generator[Browser]:
    """Yield a headless browser."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(_FLAGS))
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def opened(browser: Browser, width: int = 1280, scheme: str = "light") -> Generator[Page]:
    """Yield a window; an error of a script or a refusal by the policy fails the test at its end."""
    complaints: list[str] = []
    context = browser.new_context(
        viewport={"width": width, "height": 1000},
        color_scheme="dark" if scheme == "dark" else "light",
    )
    page = context.new_page()
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
    try:
        yield page
        assert complaints == []
    finally:
        context.close()


def accessibility_faults(page: Page) -> list[str]:
    """Return what axe finds on a page, from "serious" on, with the places."""
    # Evaluated by the browser's debugger, which the page's policy does not bind.
    page.evaluate(AXE.read_text(encoding="utf-8"))
    report = page.evaluate("axe.run({resultTypes: ['violations']})")
    return [
        f"{violation['id']}: {violation['nodes'][0]['html'][:120]}"
        for violation in report["violations"]
        if violation["impact"] in ("serious", "critical")
    ]
