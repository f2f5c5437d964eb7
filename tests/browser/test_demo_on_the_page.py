"""`deltaq demo` in a browser: what a first visitor sees, and what is left on the page when it ends."""

import re
import signal
import subprocess

import pytest
from commands import PROGRAM
from conftest import SLOW_SCREEN, TIMEOUT_MS
from test_page import Q

from deltaq_testing.private_cell import write_private_cell

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(900)]


@pytest.fixture
def demo(tmp_path):
    """A demonstration that runs, and its console's address."""
    command = [PROGRAM, "demo", "--cell", str(write_private_cell(tmp_path)), "--duration-s", "600"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            told = (re.search(r"the console is at (\S+)", line) for line in running.stderr)
            yield running, next(filter(None, told))[1]
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate()


def test_a_browser_shows_steers_and_stops_the_demonstration(chromium, demo):
    running, url = demo
    page = chromium.new_context(viewport={"width": 1000, "height": 560}, bypass_csp=True).new_page()
    page.set_default_timeout(3 * TIMEOUT_MS)  # two controllers take what the browser would need
    page.add_init_script(SLOW_SCREEN)
    page.goto(url)
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function("deltaq.live.status?.hli && !deltaq.live.isStale()")
    assert page.locator("[data-part=reality]").text_content() == "EMULATED"

    # both robots move, and the camera's picture has the leader's hand in it
    for robot in ("gr", "fr"):
        q = Q.replace("gr", robot)
        before = page.evaluate(q)
        page.wait_for_function(
            f"before => {q}.some((value, k) => Math.abs(value - before[k]) > 0.02)", arg=before
        )
    page.wait_for_function("deltaq.picture.error().angle < deltaq.picture.settings.fov_rad / 2")

    # the controllers have control, and the page says so; the follower takes another view distance from it
    page.locator("[data-robot=fr]").click()
    page.locator(".lease", has_text="has control. It is not a browser at this console.").wait_for()
    wanted_m = 1.3
    page.get_by_role("slider", name="View distance").fill(str(wanted_m))
    page.wait_for_function("wanted => Math.abs(deltaq.picture.error().distance - wanted) < 0.1", arg=wanted_m)

    page.keyboard.press("Escape")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    running.send_signal(signal.SIGINT)
    page.locator("[data-part=cover]", has_text="No connection to the console").wait_for()
    page.context.close()
