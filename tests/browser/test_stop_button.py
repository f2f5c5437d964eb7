"""The STOP button: its colours and words in every state, light and dark, also under the pointer."""

import re
from itertools import product

import pytest
from conftest import status

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.timeout(300)]

LEAST_CONTRAST = 4.5
STATES = ("ready", "sending", "asked", "not_confirmed", "not_sent", "stopping", "at_rest")
# every colour that its words stand on, and the colour of each of its words
COLOURS = """() => {
    const button = document.querySelector("[data-part=stop]");
    const {backgroundColor, backgroundImage, opacity} = getComputedStyle(button);
    const behind = backgroundImage === "none" ? [backgroundColor] : backgroundImage.match(/rgba?\\([^)]*\\)/g);
    const words = [...button.children].map((word) => getComputedStyle(word));
    return {behind, words: words.map(({color}) => color), opacities: [opacity, ...words.map((word) => word.opacity)]};
}"""


def rgb(colour):
    *channels, alpha = ([float(number) for number in re.findall(r"[\d.]+", colour)] + [1.0])[:4]
    assert alpha == 1.0, colour
    return channels


def luminance(colour):
    """Relative luminance (WCAG 2.2)."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (x / 255 for x in rgb(colour))
    ]
    return sum(weight * channel for weight, channel in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one, other):
    bright, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def is_red_or_amber(colour):
    red, green, blue = rgb(colour)
    return red > 90 and red > 2 * blue and (red > 2.5 * green or (green > 0.6 * red and green < 0.85 * red))


def test_stop_is_red_or_amber_and_readable_in_every_state_also_under_the_pointer(alone):
    page = alone()
    stop = page.locator("[data-part=stop]")
    worst = {}
    for look, state in product(("light", "dark"), STATES):
        page.emulate_media(color_scheme=look)
        page.wait_for_function("look => document.documentElement.dataset.look === look", arg=look)
        page.evaluate(
            "state => { deltaq.stop.update = () => {}; deltaq.stop.show(state, 'STOP', 'words') }", state
        )
        for way in ("away", "over", "pressed", "focused"):
            page.mouse.move(300, 300) if way == "away" else stop.hover()
            if way == "pressed":
                page.mouse.down()
            elif way == "focused":
                page.mouse.up()
                stop.focus()
            told = page.evaluate(COLOURS)
            assert set(told["opacities"]) == {"1"}
            for behind in told["behind"]:
                assert is_red_or_amber(behind), (look, state, way, behind)
                contrasts = [contrast(behind, word) for word in told["words"]]
                worst[look, state, way] = min(worst.get((look, state, way), 21.0), *contrasts)
    assert min(worst.values()) >= LEAST_CONTRAST, worst


def test_a_stop_without_hli_is_shown_unconfirmed_and_confirmed_later(alone):
    page = alone()
    page.evaluate("line.answers = {outcome: 'asked'}")
    page.locator("[data-part=stop]").click()
    page.evaluate("status => line.show(status)", status(hli=False, stop="asked"))
    page.wait_for_function("deltaq.stop.state === 'not_confirmed'")
    assert page.locator("[data-part=stop-title]").text_content() == "NOT CONFIRMED"
    assert "use the emergency stop" in page.locator("[data-part=stop-answer]").text_content()
    page.evaluate("status => line.show(status)", status(stop="stopping"))
    page.wait_for_function("deltaq.stop.state === 'stopping'")
