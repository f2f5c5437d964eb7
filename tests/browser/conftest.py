"""A running cell with its console, and Chromium to look at it; both are started once for all tests here."""

import base64
import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from console_bench import ConsoleBench
from small_cell import free_port

from deltaq_protocol.messages import Phase
from deltaq_services.console.messages import ConsoleHello, ConsoleStatus, LeaseView, RobotStatusView

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
TIMEOUT_S, TIMEOUT_MS = 60, 60_000
"""For what has to happen some time; a machine may be busy, and nothing here judges how long it takes."""


SLOW_SCREEN = """
const screen = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => setTimeout(() => screen(draw), 80);
"""
"""Ten pictures a second in place of sixty: without graphics hardware a picture costs a core 20 ms."""


RELEASE = """Object.entries(deltaq.live.status?.robots ?? {}).filter(([, {lease}]) => lease.mine)
    .forEach(([robot]) => deltaq.live.send("lease", {robot, action: "release"}))"""


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
        context = chromium.new_context(viewport={"width": 1000, "height": 560}, bypass_csp=True)
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
    pages = [page for context in contexts for page in context.pages]
    for page in pages:  # or the next test would wait for whoever may come back
        with suppress(Exception):
            page.evaluate(RELEASE)
    errors = [error for page in pages for error in getattr(page, "errors", ())]
    for context in contexts:
        context.close()
    assert not errors


# --- the page alone: a console without a cell serves it, and the test is its line -----------------------------

LINE = """(() => {
    const Real = window.WebSocket;
    const line = window.line = {sent: [], answers: true, status: null, hello: HELLO, sockets: [], urls: []};
    const frame = Uint8Array.from(atob("FRAME"), (one) => one.charCodeAt(0)).buffer;
    class Line {
        constructor(url) {
            Object.assign(this, {bufferedAmount: 0});
            line.urls.push(url);
            line.sockets.push(this);
            setTimeout(() => { this.says(line.hello); this.says(line.status); });
            this.timer = setInterval(() => this.frame(), 60);
        }
        says(message) { this.onmessage?.({data: JSON.stringify(message)}); }
        frame() {
            new DataView(frame).setFloat64(4, Date.now() / 1000, true);
            this.onmessage?.({data: frame.slice(0)});
        }
        send(text) {
            const {type, id, sent_ms} = JSON.parse(text);
            line.sent.push(JSON.parse(text));
            if (type === "ping") this.says({type: "pong", id, sent_ms});
            else if (line.answers) {
                queueMicrotask(() => this.says({type: "ack", id, outcome: "done", text: "", ...line.answers}));
            }
        }
        close() { clearInterval(this.timer); this.onclose?.(); }
    }
    window.WebSocket = new Proxy(Real, {
        construct: (_, [url, ...more]) => url.includes("/live") ? new Line(url) : new Real(url, ...more),
    });
    line.show = (status) => { line.status = status; line.sockets.at(-1).says(status); };
})()"""


@pytest.fixture(scope="session")
def lone_console(last_use):
    return last_use.enter("lone_console", served_alone())


@contextmanager
def served_alone():
    port = free_port()
    command = (sys.executable, "-m", "deltaq_services.console", "--emulated", "--port", str(port))
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}"
    deadline = time.monotonic() + TIMEOUT_S
    try:
        while True:
            assert process.poll() is None
            assert time.monotonic() < deadline
            try:
                urlopen(f"{url}/health").close()
                break
            except URLError:
                time.sleep(0.2)
        yield url
    finally:
        process.terminate()
        process.wait(TIMEOUT_S)


def status(fr=None, gr=None, **fields):
    """What a console says of the lab cell; each robot is ready and free where nothing else is given."""
    robots = {"gr": gr or {}, "fr": fr or {}}
    views = {
        name: RobotStatusView(**{"phase": Phase.READY, "text": "ready", **given})
        for name, given in robots.items()
    }
    return ConsoleStatus(hli=fields.pop("hli", True), robots=views, **fields).model_dump(mode="json")


def mine(**fields):
    """The view of a robot that this page has control of."""
    return {"lease": LeaseView(holder="Anna", mine=True), **fields}


@pytest.fixture
def alone(chromium, lone_console):
    """Opens the page alone, by size and look; its `line.show(status)` says what is known from then on."""
    contexts = []
    bench = ConsoleBench()
    bench.states()
    hello = ConsoleHello(console="one", client="Anna", operator=True, token_needed=False)
    frame = base64.b64encode(bench.core.picture.frame(bench.now_s)).decode()
    line = LINE.replace("HELLO", hello.model_dump_json()).replace("FRAME", frame)

    def open_page(width=1280, height=720, look="dark", **more):
        # the page's policy lets no text be run as a script, which is how playwright waits
        more = {"bypass_csp": True, "color_scheme": look, "reduced_motion": "reduce", **more}
        context = chromium.new_context(viewport={"width": width, "height": height}, **more)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.add_init_script(SLOW_SCREEN)
        page.add_init_script(line)
        page.add_init_script(f"line.status = {json.dumps(status())}")
        page.goto(lone_console)
        page.wait_for_selector("[data-ready=true]", state="attached")
        # a page that stands still for a while has an old picture and a silent line, and would let go of what is held
        page.evaluate("deltaq.live.age_s = () => 0; deltaq.live.connection.pulse = () => {}")
        return page

    yield open_page
    for context in contexts:
        context.close()
