"""The console is killed and started again while the robot moves under it, in Chromium before a running cell."""

import json

import pytest
from test_failures import Line, comes_to_rest
from test_page import AT_REST, hold_until_it_moves, take_control

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(300)]


def test_a_killed_console_leaves_the_robot_at_rest_and_the_page_reconnects(opened, served_cell, shared_stack):
    line = Line()
    page = opened(lambda page: page.route_web_socket("**/live**", line.route))
    take_control(page)
    hold_until_it_moves(page)
    shared_stack.kill("console")
    comes_to_rest(served_cell)
    page.wait_for_function("!deltaq.live.connection.isUp && !deltaq.wish.isActive")
    page.locator("[data-part=cover]", has_text="No connection to the console").wait_for()
    assert "no connection" in page.evaluate("deltaq.live.cannotDrive('gr')")
    line.sent.clear()
    assert shared_stack.serve_console() == served_cell.url
    # the old page is never up again: it loads itself anew. Somebody goes on pressing: nothing is held for later
    page.wait_for_function(
        "window.deltaq?.live.connection.isUp && document.documentElement.dataset.stale === 'false'"
    )
    page.wait_for_selector("[data-ready=true]", state="attached")
    page.wait_for_function(f"deltaq.live.robot('gr')?.lease.holder === null && {AT_REST}")
    assert {json.loads(message)["type"] for message in line.sent} == {"ping"}
    assert page.evaluate("deltaq.wish.isActive") is False
