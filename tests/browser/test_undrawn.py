"""STOP and words go on where the cell cannot be fetched or drawn; tried in Chromium before a robot that moves."""

import pytest
from test_page import AT_REST, hold_until_it_moves, take_control

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

NO_WEBGL = """
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    return kind.startsWith("webgl") ? null : context.call(this, kind, ...rest);
};
"""


def without_a_description(page):
    page.route("**/scene.json", lambda route: route.fulfill(status=500, body="no"))


def without_three_js(page):
    page.route("**/vendor/three.js", lambda route: route.abort())


def without_webgl(page):
    page.add_init_script(NO_WEBGL)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            without_a_description,
            "/scene.json could not be loaded: the console answers 500. Its log says why.",
        ),
        pytest.param(without_three_js, "Failed to fetch"),
        pytest.param(without_webgl, "This browser has no WebGL 2"),
    ],
)
def test_a_page_without_graphics_says_why_and_still_stops_a_robot(opened, spoil, words):
    page = opened(spoil, ready="undrawn")
    told = page.locator(".undrawn")
    assert words in told.text_content()
    assert "STOP works" in told.text_content()
    assert page.evaluate("deltaq.live.cannotDrive('gr')") == "the cell cannot be shown"
    driving = opened()
    take_control(driving)
    hold_until_it_moves(driving)
    page.locator("[data-part=stop]").dispatch_event("pointerdown")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    assert page.locator("[data-part=stop-answer]").text_content() == "every robot is at rest"
    page.locator(".chip[data-phase=held]", has_text="gr").wait_for()
    page.locator(".undrawn dt:text-is('gr') + dd", has_text="held: a client pressed stop").wait_for()
    driving.wait_for_function(AT_REST)
