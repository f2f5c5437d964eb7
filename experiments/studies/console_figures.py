"""How quickly the console stops and starts: `python -m studies.console_figures`, as JSON.

Start the cell first (`deltaq up --cell lab`), on a computer that does nothing else. The page's own clock times it, in
headless Chromium:

- `stop_ms`: from a press of STOP, as the browser stamps it, until the page says that every robot is at rest. A joint
  moves meanwhile, and the page draws it.
- `first_paint_ms`, `usable_ms`: from the page's address until something is drawn, and until a robot can be taken; each
  time in a browser that has nothing of the page in its cache.

It needs Chromium and playwright (the extra `dev`).
"""

from __future__ import annotations

import json

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from deltaq_deploy.launch.program import run_program
from studies.console_picture import FLAGS, WIDE, in_mode, opened, options_of, parser_of, take

ROBOT, JOINT, RAD_S = "gr", 8, 0.5
OPENINGS = 5

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
    options = options_of(parser)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.chromium, args=FLAGS)
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
