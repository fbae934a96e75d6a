"""Tests that need a package of the operating system: skipped where it may be missing."""

import os
import shutil

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


def needs(package: str, there: object) -> pytest.MarkDecorator:
    """Skip a test whose system package is missing; let it fail under CI's REQUIRE_SYSTEM=1."""
    required = os.environ.get("REQUIRE_SYSTEM") == "1"
    reason = f"needs {package} (Debian: apt-get install {package})"
    return pytest.mark.skipif(not there and not required, reason=reason)
