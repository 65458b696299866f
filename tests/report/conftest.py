"""Runs to look at, and a browser to look with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from massprop_drake import load_scenario, simulate
from massprop_drake.run import Run

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="session")
def failed_run() -> Run:
    """A quiet vehicle whose jet 29 sticks on at 1 s; the estimates start near the truth."""
    return simulate(
        load_scenario(
            "stuck_on_29",
            [
                "duration_s=6",
                "maneuver=[{controller: rhc, axis: +x, start_s: 0.2, end_s: 0.8}]",
                "failures=[{kind: stuck_on, jet: R4R, start_s: 1}]",
                "estimation={start: nominal, std_fraction: 0.001}",
            ],
        )
    )


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Headless Chromium without network; skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"]
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=[*flags, "--disable-background-networking"], timeout=120_000
        )
        yield chromium
        chromium.close()


class Page:
    """A page opened from disk, and what its console said."""

    def __init__(self, browser: Any, path: Path):
        self.page = browser.new_page(viewport={"width": 1000, "height": 700})
        self.page.set_default_timeout(120_000)
        self.said: list[str] = []
        self.page.on("console", lambda message: self.said.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.said.append(f"error: {error}"))
        self.page.on("dialog", lambda dialog: (self.said.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        self.page.context.set_offline(True)
        self.page.goto(path.as_uri())
        self.page.wait_for_function("document.body.dataset.ready === 'yes'")


@pytest.fixture
def opened(browser: Any) -> Iterator[Any]:
    """A function that opens a file in the browser."""
    pages: list[Page] = []

    def open_page(path: Path) -> Page:
        pages.append(Page(browser, path))
        return pages[-1]

    yield open_page
    for page in pages:
        page.page.context.close()
