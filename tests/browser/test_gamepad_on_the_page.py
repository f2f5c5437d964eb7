"""A gamepad at the console: plugged in, driven with, and pulled out, in Chromium before a running cell."""

import re

import pytest
from test_page import AT_REST, Q, take_control

from deltaq_protocol.pad_layout import PAD_LAYOUT, PadFunction

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

PLACE = {control.function: control.standard for control in PAD_LAYOUT}
# a pad in the place of those that the browser knows
PAD = """(() => {
    const pads = [null];
    Object.defineProperty(navigator, "getGamepads", {value: () => pads});
    const tell = (kind) => window.dispatchEvent(Object.assign(new Event(kind), {gamepad: {index: 0}}));
    const button = (pressed) => ({pressed, value: Number(pressed)});
    window.pad = {
        stand(held, axes) {
            const buttons = Array.from({length: 17}, (_, k) => button(held.includes(k)));
            pads[0] = {id: "a pad", mapping: "standard", index: 0, connected: true, axes, buttons};
        },
        plug() { this.stand([], [0, 0, 0, 0]); tell("gamepadconnected"); },
        unplug() { pads[0] = null; tell("gamepaddisconnected"); },
    };
})()"""


def stand(page, held=(), axes=(0, 0, 0, 0)):
    page.evaluate("([held, axes]) => pad.stand(held, axes)", [[PLACE[what] for what in held], list(axes)])


def press(page, what):
    stand(page, [what])
    page.wait_for_function("place => deltaq.gamepad._before?.[place]", arg=PLACE[what])
    stand(page)
    page.wait_for_function("place => !deltaq.gamepad._before[place]", arg=PLACE[what])


@pytest.mark.nightly
def test_a_gamepad_drives_the_hand_and_unplugging_it_stops_the_robot(opened):
    page = opened(lambda page: page.add_init_script(PAD))
    pad = page.locator(".pad")
    assert "No gamepad" in pad.text_content()
    page.evaluate("pad.plug()")
    page.wait_for_function("document.querySelector('.pad').dataset.plugged === 'true'")
    take_control(page)
    press(page, PadFunction.MODE)
    page.wait_for_function("deltaq.live.robot('gr').mode === 'decoupled'")
    before, seen = page.evaluate(Q), page.locator("[data-part=follower] output").text_content()
    assert re.fullmatch(r"[0-9.]+°  [0-9.]+ m", seen)

    # pressed anew where the picture was old for a moment
    page.evaluate(
        """place => { window.pushing = setInterval(
            () => pad.stand(deltaq.gamepad._armed ? [place] : [], [0, -1, 0, 0]), 40); }""",
        PLACE[PadFunction.MOVE],
    )
    page.wait_for_function(
        f"before => {Q}.some((value, k) => Math.abs(value - before[k]) > 0.02)", arg=before
    )
    page.locator(".pad [data-lit]").first.wait_for()
    page.wait_for_function(
        "seen => document.querySelector('[data-part=follower] output').textContent !== seen", arg=seen
    )
    page.evaluate("clearInterval(window.pushing); pad.unplug()")
    page.wait_for_function("!deltaq.wish.isActive")
    page.wait_for_function(AT_REST)
    assert "No gamepad" in pad.text_content()
