"""Another robot as the master, in Chromium before a running cell: a controller moves it, and it leads the hand."""

import pytest
from test_page import Q
from test_paths import in_mode, let_go

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(300)]

Q_MASTER = Q.replace("'gr'", "'fr'")


@pytest.fixture
def moved(served_cell, shared_stack):
    """Has a controller swing A1 of fr, for ever."""
    yield lambda: shared_stack.launcher.restart("mover")
    shared_stack.launcher.stop_service("mover")


def test_a_robot_that_a_controller_moves_leads_the_hand_while_the_button_is_held(opened, moved):
    page = opened()
    in_mode(page, "coupled")
    page.get_by_label("Master", exact=True).select_option("fr")
    page.wait_for_function("deltaq.live.robot('gr').master === 'fr'")
    moved()
    before, master = page.evaluate(Q), page.evaluate(Q_MASTER)
    page.wait_for_function(f"before => Math.abs({Q_MASTER}[0] - before[0]) > 0.05", arg=master)
    assert page.evaluate(Q) == pytest.approx(before, abs=1e-4)

    button = page.get_by_role("button", name="Hold to be led")
    button.scroll_into_view_if_needed()
    button.hover()
    page.mouse.down()
    page.evaluate(
        "window.pressing = setInterval(() => deltaq.wish.isActive"
        " || deltaq.wish.hold('test', {led: true}), 50)"
    )
    page.wait_for_function("deltaq.live.robot('gr').driving.includes('fr leads')")
    page.wait_for_function(
        f"before => {Q}.some((value, k) => Math.abs(value - before[k]) > 0.05)", arg=before
    )
    let_go(page)
    page.wait_for_function("deltaq.live.robot('gr').driving.includes('fr is not coupled')")
