"""Pictures of the console before a running cell: `python -m deltaq_experiments.console_picture docs/images`.

Start the cell first (`deltaq up --cell lab`). An operator is played, who takes `gr`, moves its hand by the keyboard for
a while and lets go, asks the advisor, and puts a pose where there is no way. It needs Chromium and playwright (the
extra `dev`).
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

# the page itself is put together without SwiftShader, which draws only the 3D view
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
_TIMEOUT_MS = 60_000
_WIDE: ViewportSize = {"width": 1440, "height": 860}
_PHONE: ViewportSize = {"width": 390, "height": 844}
# keys of the hand's directions, and for how long each is held [ms]
_WAY = (("KeyF", 2500), ("KeyD", 2500), ("KeyW", 2000))


_SETTLED = """() => deltaq.stage.isFinest() && !deltaq.live.isStale()
    && document.querySelector(".age").dataset.stale === "false"
"""
_WATCH = """() => {
    window.wentGrey = false;
    for (const shown of [document.querySelector(".age"), document.documentElement]) {
        new MutationObserver(() => (window.wentGrey ||= shown.dataset.stale === "true"))
            .observe(shown, {attributeFilter: ["data-stale"]});
    }
}"""


def take_pictures(url: str, folder: Path, chromium: str) -> None:
    """Play an operator at the console, and write `console.png` and others named after what they show.

    Args:
        url: of the console.
        folder: to write to.
        chromium: the browser's program.
    """
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = _opened(browser, url, _WIDE)
        _drive(page)
        _save(page, folder / "console.png")
        _ask_the_advisor(page)
        _save(page, folder / "console-advisor.png")
        _put_a_pose(page)
        _save(page, folder / "console-pose.png")
        _in_mode(page, "coupled")
        page.locator("[data-part=look]").click()
        page.locator(".opener").click()
        _save(page, folder / "console-light.png")
        page.evaluate("deltaq.live.send('lease', {robot: 'gr', action: 'release'})")
        page.close()
        _save(_opened(browser, url, _PHONE), folder / "console-phone.png")
        browser.close()


def _opened(browser: Browser, url: str, size: ViewportSize) -> Page:
    page = browser.new_page(viewport=size, color_scheme="dark")
    page.set_default_timeout(_TIMEOUT_MS)
    page.goto(url)
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function("deltaq.live.status?.hli && !deltaq.live.isStale()")
    return page


def _drive(page: Page) -> None:
    """Take `gr`, and move its hand by the keyboard."""
    page.locator("[data-robot=gr]").click()
    page.get_by_role("button", name="Take control").click()
    page.wait_for_function("deltaq.live.robot('gr').lease.mine && deltaq.live.robot('gr').mode")
    _in_mode(page, "coupled")
    for key, held_ms in _WAY:
        page.keyboard.down(key)
        page.wait_for_timeout(held_ms)
        page.keyboard.up(key)


def _in_mode(page: Page, mode: str) -> None:
    page.locator(f"[data-mode={mode}]").click()
    page.wait_for_function("mode => deltaq.live.robot('gr').mode === mode", arg=mode)


def _ask_the_advisor(page: Page) -> None:
    """Have the best option shown."""
    _in_mode(page, "advisor")
    page.wait_for_function(
        "document.querySelector('.card-option') && !deltaq.live.robot('gr').search.is_busy"
    )
    page.locator(".card-option").first.hover()
    page.wait_for_function("deltaq.wayPicture.way && !deltaq.wayPicture._shown.runs")


def _put_a_pose(page: Page) -> None:
    """Put the hand's pose into the first tank, where no way leads."""
    _in_mode(page, "pose")
    page.wait_for_function("deltaq.gizmo.root.visible")
    tank = page.evaluate(
        "deltaq.scene.structure.find(({name}) => name.includes('tank')).T_world.slice(12, 15)"
    )
    for axis, place in zip("xyz", tank, strict=True):
        field = page.get_by_label(f"{axis} of the hand in mm")
        field.fill(f"{1000 * place:.0f}")
        field.press("Enter")
    page.wait_for_function(
        "deltaq.wayPicture.way?.clear < 1 && document.querySelector('.pose').textContent.includes('first step')"
    )
    page.locator(".pose h2").click()


def _save(page: Page, file: Path) -> None:
    """Save what the page shows once nothing moves any more, packed tightly."""
    file.parent.mkdir(parents=True, exist_ok=True)
    is_grey = True
    while is_grey:  # taking it may hold the page up for so long that it shows its data as old
        page.wait_for_function(_SETTLED)
        page.evaluate(_WATCH)
        page.screenshot(path=file)
        is_grey = page.evaluate("window.wentGrey")
    with Image.open(file) as picture:
        picture.convert("RGB").save(file, optimize=True)


def main() -> None:
    """Take the pictures that the command line asks for."""
    parser = argparse.ArgumentParser(description="Take pictures of the console before a running cell.")
    parser.add_argument("folder", type=Path, help="folder to write to")
    parser.add_argument(
        "--url", default="http://127.0.0.1:7480", help="of the console (default: %(default)s)"
    )
    parser.add_argument(
        "--chromium", default=shutil.which("chromium"), help="the browser (default: %(default)s)"
    )
    options = parser.parse_args()
    if options.chromium is None:
        parser.error("Chromium is not installed; name it with --chromium")
    take_pictures(options.url, options.folder, options.chromium)


if __name__ == "__main__":
    main()
