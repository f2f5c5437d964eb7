"""How quickly the console stops and starts: `python -m studies.console_figures`, as JSON.

Start the cell first (`deltaq up --cell lab`), on a computer that does nothing else. The page's own clock times it, in
headless Chromium:

- `stop_ms`: from a press of STOP, as the browser stamps it, until the page says that every robot is at rest. A joint
  moves meanwhile, and the page draws it.
- `first_paint_ms`, `usable_ms`: from the page's address until something is drawn, and until a robot can be taken; each
  time in a browser that has nothing of the page in its cache.
- with `--video SECONDS`, in a cell whose camera has the source `test`, while a joint swings: `glass_ms` from the
  capture of a picture until the screen has it, pictures a second, the share of a core that services take, and how much
  of the motion is admitted; the last two also with the drawn picture in place of the live one.

It needs Chromium and playwright (the extra `dev`).
"""

import contextlib
import json
import os
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from deltaq_deploy.launch.program import run_program
from studies.console_picture import FLAGS, WIDE, in_mode, opened, options_of, parser_of, take

ROBOT, JOINT, RAD_S = "gr", 8, 0.5
OPENINGS = 5
SERVICES = ("video", "console", "sim", "hli")

_ROBOT_NOW = f"deltaq.live.frame.robots[deltaq.live.indexOf('{ROBOT}')]"
# the wish is taken up anew where the picture was old for a moment, away from the limit that is nearer
_MOVE = f"""() => {{
    window.moving = setInterval(() => deltaq.wish.isActive || deltaq.stop.state !== "ready"
        || deltaq.wish.hold("figures", {{{JOINT}: {_ROBOT_NOW}.q[{JOINT}] > 0 ? -{RAD_S} : {RAD_S}}}), 30);
    window.stops = [];
    addEventListener("pointerdown", ({{timeStamp}}) => (window.pressed_ms = timeStamp), {{capture: true}});
    const {{show}} = deltaq.stop;
    deltaq.stop.show = (state, ...words) => {{
        show(state, ...words);
        if (state !== "at_rest" || window.pressed_ms === null) return;
        window.stops.push(performance.now() - window.pressed_ms);
        window.pressed_ms = null;
    }};
}}"""
_MOVES = f"""drawn => deltaq.stage.frames > drawn
    && Math.abs({_ROBOT_NOW}.q[{JOINT}] - {_ROBOT_NOW}.rest[{JOINT}]) > 1e-2"""
_GLASS = f"""() => {{
    const [video] = deltaq.picture.videos.flat();
    Object.assign(window, {{glass: [], admitted: []}});
    const look = () => {{
        if (Number.isFinite(video.glass_ms) && video.glass_ms !== glass.at(-1)) glass.push(video.glass_ms);
        requestAnimationFrame(look);
    }};
    look();
    deltaq.live.addEventListener("frame", () => admitted.push({_ROBOT_NOW}.admission));
}}"""
_USABLE = """() => {
    const look = () => window.deltaq?.wish && deltaq.live.status?.hli && deltaq.live.locked() === ""
        ? (window.usable_ms = performance.now()) : setTimeout(look, 5);
    look();
}"""


def stops_ms(page: Page, presses: int) -> list[float]:
    """Times from presses of STOP to rest [ms]."""
    take(page, ROBOT)
    in_mode(page, "joint")
    page.evaluate(_MOVE)
    page.locator("[data-part=stop]").hover()
    for count in range(1, presses + 1):
        page.wait_for_function(_MOVES, arg=page.evaluate("deltaq.stage.frames"))
        page.mouse.down()
        page.mouse.up()
        page.wait_for_function("count => stops.length === count", arg=count)
        page.evaluate("deltaq.scene.robots.forEach(({name: robot}) => deltaq.live.send('reset', {robot}))")
        page.wait_for_function("deltaq.stop.state === 'ready'")
    page.evaluate("clearInterval(moving), deltaq.wish.releaseAll()")
    return list(page.evaluate("stops"))


def _used_s() -> dict[str, float]:
    """Processor time of the cell's services by name [s]."""
    used = dict.fromkeys(SERVICES, 0.0)
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (process / "cmdline").read_bytes().split(b"\0")
            name = next((name for name in SERVICES if f"deltaq_services.{name}".encode() in words), None)
            if name is not None:
                fields = (process / "stat").read_text().rpartition(")")[2].split()
                used[name] += sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return used


def video(page: Page, seconds: float) -> dict[str, object]:
    """The figures of the live picture, and of the drawn one, each for so long."""
    take(page, ROBOT)
    in_mode(page, "joint")
    page.evaluate(_MOVE)
    page.evaluate(_GLASS)
    figures: dict[str, object] = {}
    for shown in ("live", "model"):
        page.get_by_label("Picture", exact=True).select_option(shown)
        page.wait_for_timeout(2000)
        page.evaluate("glass.length = admitted.length = 0")
        before = _used_s()
        page.wait_for_timeout(1000 * seconds)
        after = _used_s()
        glass, admitted = page.evaluate("[glass, admitted.filter(Number.isFinite)]")
        figures[shown] = {
            "cores": {name: round((after[name] - before[name]) / seconds, 3) for name in SERVICES},
            "admitted": round(float(np.mean(admitted)), 4),
        }
        if glass and shown == "live":
            p50, p95 = np.percentile(glass, [50, 95])
            per_s = round(len(glass) / seconds, 1)
            figures["glass_ms"] = {"p50": round(p50), "p95": round(p95), "per_s": per_s}
    page.evaluate("clearInterval(moving), deltaq.wish.releaseAll()")
    return figures


def opening_ms(browser: Browser, url: str) -> tuple[float, float]:
    """First paint, and when a robot can be taken [ms]."""
    with browser.new_context(viewport=WIDE, bypass_csp=True) as context:
        page = context.new_page()
        page.add_init_script(f"({_USABLE})()")
        page.goto(url)
        page.wait_for_function("window.usable_ms")
        first, usable = page.evaluate(
            "[performance.getEntriesByName('first-contentful-paint')[0].startTime, usable_ms]"
        )
        return first, usable


def percentiles(times_ms: list[float]) -> dict[str, float]:
    """Median, 99th percentile and longest [ms]."""
    p50, p99 = np.percentile(times_ms, [50, 99])
    return {"count": len(times_ms), "p50": round(p50), "p99": round(p99), "longest": round(max(times_ms))}


def main() -> None:
    """Measure, and print the figures."""
    parser = parser_of("console_figures", "Time the console before a running cell, in Chromium.")
    parser.add_argument("--presses", type=int, default=100, help="of STOP (default: %(default)s)")
    parser.add_argument(
        "--video", type=float, default=0.0, help="time its live picture for so long [s], and no more"
    )
    options = options_of(parser)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.chromium, args=FLAGS)
        if options.video:
            print(json.dumps(video(opened(browser, options.url, WIDE), options.video), indent=2))
            return
        openings = [opening_ms(browser, options.url) for _ in range(OPENINGS)]
        page = opened(browser, options.url, WIDE)
        stops = stops_ms(page, options.presses)
        page.evaluate(f"deltaq.live.send('lease', {{robot: '{ROBOT}', action: 'release'}})")
        browser.close()
    first, usable = zip(*openings, strict=True)
    figures = {"stop_ms": stops, "first_paint_ms": list(first), "usable_ms": list(usable)}
    print(json.dumps({name: percentiles(times_ms) for name, times_ms in figures.items()}, indent=2))


if __name__ == "__main__":
    run_program(main, "studies.console_figures")
