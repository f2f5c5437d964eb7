"""Pictures of the console before a running cell: `python -m studies.console_picture docs/images`.

Start the cell first (`deltaq up --cell lab`), on a computer that does nothing else. An operator is played, who has `fr`
follow, moves the hand of `gr` to and fro by the keyboard until the plots are full, asks the advisor, and puts a pose
where there is no way, and has a routine planned. It needs Chromium and playwright (the
extra `dev`).
"""

import argparse
import itertools
import shutil
import time
import urllib.request
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from deltaq_deploy.launch.program import run_program

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
WIDE: ViewportSize = {"width": 1440, "height": 860}
_PHONE: ViewportSize = {"width": 390, "height": 844}
# keys of the hand's directions, and for how long each is held [ms]: there and back
_WAY = (("KeyF", 2500), ("KeyD", 2500), ("KeyW", 2000), ("KeyR", 2500), ("KeyA", 2500), ("KeyS", 2000))
_PLOTTED_S = 120
_COMPILES_S = 180
"""The camera's law is compiled once after an installation."""


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


# what moves is drawn coarsely without graphics hardware
_FINE = "Object.assign(deltaq.stage.pace, {mayVary: false, finest: 2}), deltaq.stage.frames"
_AS_BEFORE = "Object.assign(deltaq.stage.pace, {mayVary: !deltaq.stage.full, finest: 1})"


def take_pictures(url: str, folder: Path, chromium: str) -> None:
    """Play an operator at the console, and write `console.png` and others named after what they show.

    Args:
        url: of the console.
        folder: to write to.
        chromium: the browser's program.
    """
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = opened(browser, url, WIDE)
        _follow(page)
        _drive(page, folder / "console.png")
        _ask_the_advisor(page)
        save(page, folder / "console-advisor.png")
        _put_a_pose(page)
        save(page, folder / "console-pose.png")
        in_mode(page, "coupled")
        plan_a_routine(page)
        save(page, folder / "console-routine.png")
        page.get_by_role("button", name="Back").click()
        page.locator("[data-part=look]").click()
        page.locator(".opener").click()
        save(page, folder / "console-light.png")
        for robot in ("gr", "fr"):
            page.evaluate("robot => deltaq.live.send('lease', {robot, action: 'release'})", robot)
        page.close()
        save(opened(browser, url, _PHONE), folder / "console-phone.png")
        browser.close()


def opened(browser: Browser, url: str, size: ViewportSize) -> Page:
    """The page of the console, with the cell drawn."""
    # playwright waits by scripts that the page's policy refuses
    page = browser.new_page(viewport=size, color_scheme="dark", bypass_csp=True)
    page.set_default_timeout(_TIMEOUT_MS)
    page.goto(url)
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function("deltaq.live.status?.hli && !deltaq.live.isStale()")
    return page


def take(page: Page, robot: str) -> None:
    """Take control of a robot."""
    page.locator(f"[data-robot={robot}]").click()
    page.get_by_role("button", name="Take control").click()
    page.wait_for_function(
        "robot => deltaq.live.robot(robot)?.lease.mine && deltaq.live.robot(robot).mode", arg=robot
    )


def _follow(page: Page) -> None:
    """Have `fr` follow the hand of `gr` with its camera."""
    take(page, "fr")
    until_s = time.monotonic() + _COMPILES_S
    while page.evaluate("deltaq.live.robot('fr').mode") != "follow":
        if time.monotonic() > until_s:
            raise SystemExit(f"fr does not follow: {page.locator('.card .answer').text_content()}")
        page.locator("[data-mode=follow]").click(delay=1000)  # it is held to begin
        page.wait_for_timeout(2000)


def _drive(page: Page, file: Path) -> None:
    """Take `gr`, move its hand to and fro until the plots are full, and take a picture while it moves."""
    take(page, "gr")
    in_mode(page, "coupled")
    until_s = time.monotonic() + _PLOTTED_S
    for key, held_ms in itertools.cycle(_WAY):
        page.keyboard.down(key)
        page.wait_for_timeout(held_ms / 2)
        is_over = time.monotonic() > until_s
        is_taken = is_over and _taken_in_motion(page, file)
        page.wait_for_timeout(held_ms / 2)
        page.keyboard.up(key)
        if is_taken:
            return


def _taken_in_motion(page: Page, file: Path) -> bool:
    """Take a picture, drawn finely; returns whether `gr` moved and `fr` followed all the while."""
    if page.evaluate("deltaq.live.robot('fr').mode !== 'follow' || !deltaq.live.robot('fr').lease.mine"):
        raise SystemExit("fr follows no more: is the computer busy with something else?")
    begun = page.evaluate(_FINE)
    page.wait_for_function(
        "begun => deltaq.stage.frames > begun + 3 || deltaq.live.robot('gr').phase !== 'engaged'", arg=begun
    )
    page.evaluate(_WATCH)
    _write(page, file)
    page.evaluate(_AS_BEFORE)
    return bool(page.evaluate("deltaq.live.robot('gr').phase === 'engaged' && !window.wentGrey"))


def in_mode(page: Page, mode: str) -> None:
    """Drive `gr` in that mode."""
    page.locator(f"[data-mode={mode}]").click()
    page.wait_for_function("mode => deltaq.live.robot('gr').mode === mode", arg=mode)


def _ask_the_advisor(page: Page) -> None:
    """Have the best option shown."""
    in_mode(page, "advisor")
    page.wait_for_function(
        "document.querySelector('.card-option') && !deltaq.live.robot('gr').search.is_busy"
    )
    page.locator(".card-option").first.hover()
    page.wait_for_function("deltaq.wayPicture.way && !deltaq.wayPicture._shown.runs")


def _put_a_pose(page: Page) -> None:
    """Put the hand's pose into the first tank, where no way leads."""
    in_mode(page, "pose")
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


def plan_a_routine(page: Page) -> None:
    """Have all motions of a routine shown that turns a valve."""
    page.locator("[data-item=valve_1]").click()
    page.locator("[data-routine=turn]").click()
    page.wait_for_function("deltaq.ways.planned")
    page.locator(".routines .forecast").scroll_into_view_if_needed()


def save(page: Page, file: Path) -> None:
    """Save what the page shows once nothing moves any more."""
    is_grey = True
    while is_grey:  # taking it may hold the page up for so long that it shows its data as old
        page.wait_for_function(_SETTLED)
        page.evaluate(_WATCH)
        _write(page, file)
        is_grey = page.evaluate("window.wentGrey")


def _write(page: Page, file: Path) -> None:
    """Write what the page shows now, packed tightly."""
    file.parent.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=file)
    with Image.open(file) as picture:
        picture.convert("RGB").save(file, optimize=True)


def parser_of(program: str, description: str) -> argparse.ArgumentParser:
    """A parser that asks where the console and the browser are."""
    parser = argparse.ArgumentParser(prog=f"python -m studies.{program}", description=description)
    parser.add_argument(
        "--url", default="http://127.0.0.1:7480", help="of the console (default: %(default)s)"
    )
    parser.add_argument(
        "--chromium", default=shutil.which("chromium"), help="the browser (default: %(default)s)"
    )
    return parser


def options_of(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options of the command line, once the console and the browser are found there."""
    options = parser.parse_args()
    if options.chromium is None:
        parser.error("Chromium is not installed; name it with --chromium")
    if shutil.which(options.chromium) is None:
        parser.error(f"--chromium {options.chromium}: no program there")
    try:
        with urllib.request.urlopen(options.url):
            pass
    except OSError as error:
        parser.error(f"no console answers at {options.url} ({error}); start the cell first (`deltaq up`)")
    return options


def main() -> None:
    """Take the pictures that the command line asks for."""
    parser = parser_of("console_picture", "Take pictures of the console before a running cell.")
    parser.add_argument("folder", type=Path, help="folder to write to")
    options = options_of(parser)
    take_pictures(options.url, options.folder, options.chromium)


if __name__ == "__main__":
    run_program(main, "studies.console_picture")
