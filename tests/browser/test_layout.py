"""Where the page's motion controls are: in the same place in every state, reachable at every size."""

from itertools import product

import pytest
from conftest import mine, status

from deltaq_protocol.messages import Phase
from deltaq_services.console.messages import LeaseView

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.timeout(300)]

LONG = (
    "structure/process_pipe_3 2.1 cm from gr/link_6_collision_hull, 5.0 cm are kept, and approaching too fast. "
    * 3
)
HELD = {"phase": Phase.HELD, "text": f"held: {LONG}", "remedy": LONG}
PRESSED = ".jog button, .hold-to-go, [data-mode], [data-frame], [data-hand]"
# of those that can be seen: where they are in the window, by their words
PLACES = """pressed => Object.fromEntries([...document.querySelectorAll(pressed)]
    .filter((button) => button.checkVisibility({visibilityProperty: true}))
    .map((button, k) => [`${k} ${button.ariaLabel ?? button.textContent}`, button.getBoundingClientRect()])
    .map(([name, {x, y, width, height}]) => [name, [x, y, width, height].map(Math.round).join(" ")]))"""
DRIVEN = [("gr", "coupled"), ("gr", "joint"), ("gr", "pose"), ("fr", "decoupled"), ("fr", "follow")]
SIZES = [(1920, 1080), (1440, 900), (1280, 720), (1000, 560), (640, 360)]


def states(mode, **fields):
    """What may become of a robot that this page has control of."""
    yield {}
    yield {"phase": Phase.ENGAGED, "driving": f"{mode} in world axes · {LONG}", "goes_through": 0.2}
    yield HELD
    yield {"lease": LeaseView(holder="Anna", mine=True, wanted_by="Bertram of the other hall", text=LONG)}
    yield {"phase": Phase.OFFLINE, "text": LONG}


SPOILS = (
    "deltaq.wish._refuse('long '.repeat(80))",
    "line.answers = {outcome: 'refused', text: 'long '.repeat(80)};"
    " document.querySelector('[data-mode=joint]').click()",
)
# pressed and let go at once, however slow the page is
CLICK = """button => {
    for (const kind of ["keydown", "keyup"]) button.dispatchEvent(new KeyboardEvent(kind, {key: "Enter"}));
    button.click();
}"""
SCROLL = "top => { for (const box of document.querySelectorAll('.left, .console')) box.scrollTop = top; }"


def test_messages_never_shift_the_motion_controls(alone):
    page = alone()

    def places(doing, given=None):
        page.evaluate(doing, given)
        page.evaluate("deltaq.driven.dispatchEvent(new Event('change'))")
        return page.evaluate(PLACES, PRESSED)

    for (width, height), (robot, mode) in product(SIZES, DRIVEN):
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("name => deltaq.driven.choose(name)", robot)
        page.evaluate("line.answers = true")
        for scrolled in (0, 10_000):
            seen = []
            for fields in states(mode):
                view = mine(**{"mode": mode, "outputs": {"gripper": True}, **fields})
                other = {"phase": fields.get("phase", Phase.READY)}
                told = status(**{robot: view, "fr" if robot == "gr" else "gr": other})
                seen.append(places("status => line.show(status)", told))
                if len(seen) == 1:
                    page.evaluate(SCROLL, scrolled)
                    seen = [places("() => {}")]
            seen += [places(spoil) for spoil in SPOILS]
            assert len(seen[0]) >= 6
            for other in seen[1:]:
                assert {name: at for name, at in other.items() if seen[0].get(name) != at} == {}
                assert other.keys() == seen[0].keys()


def test_at_every_window_size_jog_and_stop_are_within_reach(alone):
    page = alone()
    page.evaluate("status => line.show(status)", status(gr=mine(mode="coupled")))
    jog = page.get_by_role("button", name="Z minus, hold to move", exact=True)
    wide = """[document.documentElement, ...document.querySelectorAll('.console, .left')]
        .map((box) => box.scrollWidth - box.clientWidth)"""
    for width, height in [*SIZES, (390, 844)]:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("line.sent.length = 0")
        jog.click()
        assert page.evaluate("line.sent.some(({type, wish}) => type === 'jog' && wish[2] < 0)")
        assert page.locator("[data-part=stop]").is_visible()
        assert page.evaluate(wide) == [0, 0, 0]


def test_follow_moves_the_robot_only_after_its_button_was_held(alone):
    page = alone()
    page.evaluate("deltaq.driven.choose('fr')")
    page.evaluate("status => line.show(status)", status(fr=mine(mode="decoupled")))
    asked = "line.sent.filter(({mode}) => mode === 'follow').length"
    follow = page.locator("[data-mode=follow]")
    follow.evaluate(CLICK)
    page.keyboard.press("m")
    page.keyboard.press("m")
    assert page.evaluate(asked) == 0
    follow.hover()
    page.mouse.down()
    page.wait_for_function(asked)
    page.mouse.up()
    assert page.evaluate(asked) == 1
