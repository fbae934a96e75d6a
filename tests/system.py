"""Tests that need a package of the operating system: skipped without it, but not where it must be there."""

import os
import shutil

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


def needs(package: str, found: object) -> pytest.MarkDecorator:
    """Skip a test whose system package was not found; with REQUIRE_SYSTEM=1, which CI sets, let it fail."""
    required = os.environ.get("REQUIRE_SYSTEM") == "1"
    reason = f"needs {package} (Debian: apt-get install {package})"
    return pytest.mark.skipif(not found and not required, reason=reason)
