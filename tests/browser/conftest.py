"""A running cell with its console, and Chromium to look at it; both are started once for all tests here."""

import os
import shutil
from contextlib import contextmanager

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
TIMEOUT_MS = 60_000
"""For what has to happen some time; a machine may be busy, and nothing here judges how long it takes."""


SLOW_SCREEN = """
const screen = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => setTimeout(() => screen(draw), 80);
"""
"""Ten pictures a second in place of sixty: without graphics hardware a picture costs a core 20 ms."""


class ServedCell:
    """A cell that runs, and where its console is."""

    def __init__(self, cell, url, recordings):
        self.model = cell
        self.url = url
        self.recordings = recordings


@pytest.fixture(scope="module")
def served_cell(shared_stack):
    stack = shared_stack.renewed()
    return ServedCell(stack.model, stack.serve_console(), stack.recordings)


@contextmanager
def started_chromium(playwright):
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=os.environ.get("DELTAQ_CHROMIUM", CHROMIUM), args=FLAGS
        )
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def chromium(last_use):
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: the page was not looked at")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: the page was not looked at"
    )
    return last_use.enter("chromium", started_chromium(playwright))


@pytest.fixture
def opened(chromium, served_cell):
    """Opens pages of the console; each in a browser of its own, closed with the test."""
    contexts = []

    def open_page(prepare=lambda page: None, ready="true"):
        # small, so that a machine without graphics draws it quickly
        context = chromium.new_context(viewport={"width": 1000, "height": 560})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.errors = []
        page.on("pageerror", lambda error: page.errors.append(error))
        page.add_init_script(SLOW_SCREEN)
        prepare(page)
        page.goto(served_cell.url)
        page.wait_for_selector(f"[data-ready={ready}]", state="attached")
        page.wait_for_function("deltaq.live.status?.hli")
        return page

    yield open_page
    errors = [error for context in contexts for page in context.pages for error in page.errors]
    for context in contexts:
        context.close()
    assert not errors
