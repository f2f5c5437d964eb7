"""What goes wrong between an operator and the console, tried in Chromium before a running cell, in motion."""

import pytest
from test_page import AT_REST, hold_until_it_moves, take_control

from deltaq_deploy.launch.cell_connection import connect

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

STANDS_CYCLES = 10
ASLEEP_CYCLES = 150
HOUR_MS = 3_600_000


class Line:
    """The page's live WebSocket, which can be cut: then nothing passes, nobody is told, and no new one is had."""

    def __init__(self):
        self.is_cut = False
        self.sent = []

    def route(self, websocket):
        if self.is_cut:
            websocket.close()
            return
        server = websocket.connect_to_server()

        def to_server(message):
            if not self.is_cut:
                self.sent.append(message)
                server.send(message)

        websocket.on_message(to_server)
        server.on_message(lambda message: None if self.is_cut else websocket.send(message))

    def commands(self, kind):
        return [message for message in self.sent if f'"type":"{kind}"' in message]


def release(page):
    page.evaluate("deltaq.live.send('lease', {robot: 'gr', action: 'release'})")
    page.wait_for_function("!deltaq.live.robot('gr').lease.mine")


def comes_to_rest(served_cell, cycles=STANDS_CYCLES):
    """Until the robot's setpoint has stood still for so many cycles, as somebody else sees it."""
    with connect(served_cell.model.description, "bystander") as bystander:
        still, before = 0, None
        for state in bystander.states("gr"):
            still = still + 1 if before == state.q_cmd else 0
            before = state.q_cmd
            if still == cycles:
                return


@pytest.mark.nightly
@pytest.mark.parametrize("lost_s", [2, 9])
def test_a_lost_network_stops_the_robot_and_no_old_command_is_executed_afterwards(
    opened, served_cell, lost_s
):
    line = Line()
    page = opened(lambda page: page.route_web_socket("**/live**", line.route))
    take_control(page)
    hold_until_it_moves(page)
    line.is_cut = True
    since = page.evaluate("performance.now()")
    comes_to_rest(served_cell)
    page.wait_for_function("document.documentElement.dataset.stale === 'true' && !deltaq.wish.isActive")
    # somebody goes on pressing while the line is down
    page.wait_for_function(
        "([since, lost_ms]) => performance.now() > since + lost_ms", arg=[since, 1000 * lost_s]
    )
    assert page.evaluate("deltaq.live.cannotDrive('gr')") != ""
    page.evaluate("clearInterval(window.pressing)")
    page.mouse.up()
    line.sent.clear()
    line.is_cut = False
    page.wait_for_function(
        "deltaq.live.connection.isUp && document.documentElement.dataset.stale === 'false'"
    )
    page.wait_for_function(AT_REST)
    assert line.commands("jog") == []
    assert page.evaluate("deltaq.wish.isActive") is False
    # a page that comes back in time has kept control; before the console's first word after that nothing is known
    page.wait_for_function(f"deltaq.live.robot('gr')?.lease.mine === {'true' if lost_s < 5 else 'false'}")
    if lost_s > 5:
        take_control(page)
    release(page)


@pytest.mark.nightly
def test_a_stop_pressed_without_network_is_sent_on_reconnection_even_from_another_page(
    opened,
):
    line = Line()
    page = opened(lambda page: page.route_web_socket("**/live**", line.route))
    line.is_cut = True
    page.wait_for_function("!deltaq.live.connection.isUp")
    page.keyboard.press("Escape")
    assert page.locator("[data-part=stop-title]").text_content() == "NOT SENT"
    assert "use the emergency stop" in page.locator("[data-part=stop-answer]").text_content()
    # the page is loaded anew, as after the console was started again: nobody has heard the press yet
    page.reload(wait_until="commit")
    page.locator("[data-part=stop-title]", has_text="NOT SENT").wait_for()
    line.is_cut = False
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    take_control(page)
    release(page)


@pytest.mark.nightly
def test_a_page_that_loses_focus_stops_commanding_motion(opened, served_cell):
    page = opened()
    take_control(page)
    hold_until_it_moves(page)
    page.evaluate(
        "clearInterval(window.pressing); deltaq.wish.isActive || deltaq.wish.hold('test', {0: 0.1})"
    )
    devtools = page.context.new_cdp_session(page)
    devtools.send("Emulation.setFocusEmulationEnabled", {"enabled": False})
    other = page.context.new_page()
    other.goto("about:blank")
    other.bring_to_front()
    page.wait_for_function("!document.hasFocus() && !deltaq.wish.isActive")
    comes_to_rest(served_cell)
    other.close()
    page.bring_to_front()
    page.wait_for_function(AT_REST)
    assert page.evaluate("deltaq.wish.isActive") is False, "it has to be pressed anew"
    release(page)


@pytest.mark.nightly
def test_a_page_suspended_in_motion_brings_the_robot_to_rest(opened, served_cell):
    page = opened()
    take_control(page)
    hold_until_it_moves(page)
    devtools = page.context.new_cdp_session(page)
    devtools.send("Debugger.enable")
    # not one line of the page runs from here on, and nothing is let go by it
    devtools.send("Debugger.pause")
    comes_to_rest(served_cell, ASLEEP_CYCLES)
    devtools.send("Debugger.resume")
    devtools.send("Debugger.disable")
    page.evaluate("clearInterval(window.pressing); deltaq.wish.releaseAll()")
    page.wait_for_function("!deltaq.live.isStale()")
    page.wait_for_function(AT_REST)
    page.wait_for_function("document.documentElement.dataset.stale === 'false'")
    release(page)


@pytest.mark.nightly
@pytest.mark.parametrize("ahead_ms", [HOUR_MS, -HOUR_MS])
def test_a_browser_clock_an_hour_off_changes_nothing(opened, ahead_ms):
    def set_clock(page):
        page.add_init_script(
            f"""const origin = performance.timeOrigin + {ahead_ms};
            Object.defineProperty(performance, "timeOrigin", {{get: () => origin}});"""
        )

    page = opened(set_clock)
    off_ms = page.evaluate("deltaq.live.connection.now() - 1000 * deltaq.live.frame.server_s")
    assert abs(off_ms - ahead_ms) < HOUR_MS / 60
    page.wait_for_function("!deltaq.live.isStale()")
    take_control(page)
    hold_until_it_moves(page)
    page.keyboard.press("Escape")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    page.evaluate("clearInterval(window.pressing)")
    release(page)
