"""Figures of the console before a running cell: `python -m deltaq_experiments.console_figures --cell lab`.

It starts the emulated cell and its console, plays an operator in headless Chromium, and prints one JSON object:

- `stop_ms`: from a press of STOP to the telegram that the Robot Server answers with the brake, a robot moving and the
  page drawing. The press is Chromium's stamp of the pointer event, the telegram's the Robot Server's, of clocks of
  this machine.
- `stop_in_browser_ms`: how much of that passes until the page's handler runs.
- `pictures_s`: pictures of the cell drawn in a second while a robot moves, in a window of 1440 by 860 pixels.
- `client_kB_s`: what one client and the console send each other over the live WebSocket, both ways.
- `server_core`: the console's share of a core with one client, and with four.
- `admitted`, with `--admission`: increments admitted whole, of the two of each cycle that the scripted leader and the
  camera follower send, with the page open and without.

It needs Chromium and playwright (the extra `dev`), and nothing else that listens on the cell's ports.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from playwright.sync_api import Page, ViewportSize, WebSocket, sync_playwright
from playwright.sync_api import TimeoutError as BrowserTimeoutError
from websockets.sync.client import connect as open_websocket

from deltaq_cell.load import load_cell
from deltaq_experiments.console_picture import FLAGS
from deltaq_experiments.last_lines import LastLines
from deltaq_launch.cell_connection import connect
from deltaq_launch.launcher import Launcher
from deltaq_launch.program import run_program
from deltaq_launch.services import cell_services, console_service, demo_controllers
from deltaq_protocol.blocking import BlockingCell
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotState

DRIVEN = "gr"
PRESSES = 24
MEASURED_S = 10.0
_WIDE: ViewportSize = {"width": 1440, "height": 860}
_TIMEOUT_MS = 60_000
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_STOP_WITHIN_S = 5.0
_COMPILED_WITHIN_S = 180.0
_LEAD_IN_S = 10.0
"""For the follower to be at its start."""
_TURNS = 3

# the wish is taken up anew where the picture was old for a moment; the direction turns, so that motion goes on
_MOVE = """() => {
    let sign = 1;
    window.moving = setInterval(() => {
        deltaq.wish.release("figures");
        sign = -sign;
    }, 1500);
    window.holding = setInterval(() => deltaq.wish.isActive
        || deltaq.wish.hold("figures", {[deltaq.driven.length() - 1]: 0.4 * sign}), 30);
    deltaq.presses = [];
    window.addEventListener("pointerdown", (event) =>
        event.isTrusted && deltaq.presses.push([
            performance.timeOrigin + event.timeStamp, performance.now() - event.timeStamp]), {capture: true});
}"""
_MOVES = """name => {
    const {q, rest} = deltaq.live.frame.robots[deltaq.live.indexOf(name)];
    return q.some((value, k) => Math.abs(value - rest[k]) > 1e-3);
}"""


class Watched:
    """The newest states of a robot, kept as they come, on a thread of their own.

    Args:
        cell: connection that the thread uses alone.
        robot: name of the robot.
    """

    def __init__(self, cell: BlockingCell, robot: str) -> None:
        self._came = threading.Condition()
        self._held_s: float | None = None
        threading.Thread(target=self._watch, args=(cell, robot), daemon=True).start()

    def _watch(self, cell: BlockingCell, robot: str) -> None:
        with contextlib.suppress(ServiceUnreachableError):  # the cell has ended
            for state in cell.states(robot):
                self._take(state)

    def _take(self, state: RobotState) -> None:
        with self._came:
            if state.phase is not Phase.HELD:
                self._held_s = None
            elif self._held_s is None:
                self._held_s = state.time_s
                self._came.notify_all()

    def held_s(self) -> float:
        """Time of the telegram that was first answered with the brake [s of the monotonic clock]; waits for it.

        Raises:
            TimeoutError: the robot is not held.
        """
        with self._came:
            if not self._came.wait_for(lambda: self._held_s is not None, _STOP_WITHIN_S):
                raise TimeoutError(f"no brake within {_STOP_WITHIN_S:g} s of a press of STOP")
            assert self._held_s is not None
            return self._held_s


class Traffic:
    """Bytes of the live WebSocket, both ways."""

    def __init__(self, page: Page) -> None:
        self.count = 0
        page.on("websocket", self._opened)

    def _opened(self, socket: WebSocket) -> None:
        if "/live" in socket.url:
            socket.on("framereceived", self._passed)
            socket.on("framesent", self._passed)

    def _passed(self, payload: str | bytes) -> None:
        self.count += len(payload)


def figures(cell: str, chromium: str, presses: int = PRESSES) -> dict[str, object]:
    """Start the cell, play an operator, and measure.

    Args:
        cell: name or file of the cell.
        chromium: the browser's program.
        presses: of STOP.

    Raises:
        LaunchError: a service does not come up.
        TimeoutError: STOP was pressed, and no brake came.
    """
    description = load_cell(cell)
    services = cell_services(description, cell)
    console = console_service(description, cell, services)
    with ExitStack() as stack:
        launcher = stack.enter_context(Launcher([*services, console], LastLines(), signals_raise=True))
        launcher.start()
        server = launcher.children["console"].pid
        url = console.endpoint
        assert url is not None  # a console has one
        watched = Watched(stack.enter_context(connect(description, "figures")), DRIVEN)
        browser = stack.enter_context(sync_playwright()).chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport=_WIDE)
        traffic = Traffic(page)
        _drive(page, url)
        began_s, busy_s = time.monotonic(), processor_s(server)
        begun, bytes_begun = page.evaluate("deltaq.stage.frames"), traffic.count
        page.wait_for_timeout(1000 * MEASURED_S)
        took_s = time.monotonic() - began_s
        pictures = (page.evaluate("deltaq.stage.frames") - begun) / took_s
        kilobytes = (traffic.count - bytes_begun) / 1000.0 / took_s
        one = (processor_s(server) - busy_s) / took_s
        stops, in_browser = zip(*(_stop_ms(page, watched) for _ in range(presses)), strict=True)
        with _onlookers(url, 3):
            began_s, busy_s = time.monotonic(), processor_s(server)
            page.wait_for_timeout(1000 * MEASURED_S)
            four = (processor_s(server) - busy_s) / (time.monotonic() - began_s)
        browser.close()
    return {
        "presses": presses,
        "stop_ms": {"median": statistics.median(stops), "longest": max(stops), "all": sorted(stops)},
        "stop_in_browser_ms": {"median": statistics.median(in_browser), "longest": max(in_browser)},
        "pictures_s": pictures,
        "client_kB_s": kilobytes,
        "server_core": {"one_client": one, "four_clients": four},
    }


def admission(cell: str, chromium: str) -> dict[str, float]:
    """The loop's admission rate with the page open and without, in turns.

    Args:
        cell: name or file of the cell.
        chromium: the browser's program.

    Raises:
        LaunchError: a service or a controller does not come up.
    """
    description = load_cell(cell)
    services = cell_services(description, cell)
    console = console_service(description, cell, services)
    admitted = {"page_open": 0, "without": 0}
    with ExitStack() as stack:
        started = [*services, console, *demo_controllers(description)]
        launcher = Launcher(started, LastLines(), signals_raise=True)
        stack.enter_context(launcher).start(_COMPILED_WITHIN_S)
        running = stack.enter_context(connect(description, "figures"))
        browser = stack.enter_context(sync_playwright()).chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport=_WIDE)
        page.set_default_timeout(_TIMEOUT_MS)
        page.wait_for_timeout(1000 * _LEAD_IN_S)
        for _ in range(_TURNS):
            for turn in admitted:
                page.goto("about:blank" if turn == "without" else str(console.endpoint))
                if turn == "page_open":
                    page.wait_for_selector("[data-ready=true]", state="attached")
                page.wait_for_timeout(1000)
                before = running.status().gate["admitted"]
                page.wait_for_timeout(1000 * MEASURED_S)
                admitted[turn] += running.status().gate["admitted"] - before
        browser.close()
    decided = 2 * _TURNS * MEASURED_S / description.cycle_s
    return {turn: count / decided for turn, count in admitted.items()}


def processor_s(pid: int) -> float:
    """Processor time that a process has used so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S


def _drive(page: Page, url: str) -> None:
    page.set_default_timeout(_TIMEOUT_MS)
    page.goto(url)
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function("deltaq.live.status?.hli && !deltaq.live.isStale()")
    page.locator(f"[data-robot={DRIVEN}]").click()
    page.get_by_role("button", name="Take control").click()
    page.wait_for_function("name => deltaq.live.cannotDrive(name) === ''", arg=DRIVEN)
    page.evaluate(_MOVE)
    page.wait_for_function(_MOVES, arg=DRIVEN)


def _stop_ms(page: Page, watched: Watched) -> tuple[float, float]:
    """Press STOP while the robot moves; then everything is reset, and moves again.

    Returns:
        Time to the brake, and how much of it passed in the browser [ms].
    """
    page.wait_for_function(_MOVES, arg=DRIVEN)
    page.locator("[data-part=stop]").hover()
    page.mouse.down()
    held_s = watched.held_s()
    page.mouse.up()
    pressed_ms, in_browser_ms = page.evaluate("deltaq.presses.at(-1)")
    pressed_s = pressed_ms / 1000.0 - (time.time() - time.monotonic())
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    names = page.evaluate("deltaq.scene.robots.map(({name}) => name)")
    for name in names:
        page.evaluate("robot => deltaq.live.send('reset', {robot})", name)
    page.wait_for_function("deltaq.live.status.stop === 'none'")
    return 1000.0 * (held_s - pressed_s), in_browser_ms


@contextmanager
def _onlookers(url: str, count: int) -> Iterator[None]:
    """Clients that read what they are sent, and draw nothing."""
    address = f"{url.replace('http', 'ws', 1)}/live"
    with ExitStack() as stack:
        for _ in range(count):
            socket = stack.enter_context(open_websocket(address))
            threading.Thread(target=lambda socket=socket: [None for _ in socket], daemon=True).start()
        yield


def main() -> None:
    """Measure, and print the figures as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_experiments.console_figures",
        description="Figures of the console before a running cell, as JSON.",
    )
    parser.add_argument("--cell", default="lab", help="name or file of the cell (default: %(default)s)")
    parser.add_argument("--presses", type=int, default=PRESSES, help="of STOP (default: %(default)s)")
    parser.add_argument("--admission", action="store_true", help="the admission rate only")
    parser.add_argument(
        "--chromium", default=shutil.which("chromium"), help="the browser (default: %(default)s)"
    )
    options = parser.parse_args()
    if options.chromium is None:
        parser.error("Chromium is not installed; name it with --chromium")
    if shutil.which(options.chromium) is None:
        parser.error(f"--chromium {options.chromium}: no program there")
    try:
        if options.admission:
            found: dict[str, object] = {"admitted": admission(options.cell, options.chromium)}
        else:
            found = dict(figures(options.cell, options.chromium, options.presses))
    except (DeltaqError, BrowserTimeoutError) as error:
        raise SystemExit(
            f"{error}\nnothing was measured: is the machine too busy to draw and to move robots?"
        ) from error
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.console_figures")
