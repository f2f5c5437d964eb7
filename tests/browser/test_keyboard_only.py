"""The page without a mouse or a pad: take control, move a joint, and stop, by keys alone."""

import pytest
from test_page import AT_REST, Q

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]


def tab_to(page, name):
    """Press Tab until the button of that name has the focus."""
    for _ in range(60):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent.trim()") == name:
            return
    pytest.fail(f"no Tab leads to {name}")


@pytest.mark.nightly
def test_the_keyboard_alone_takes_a_robot_moves_a_joint_and_stops(opened):
    page = opened()
    page.wait_for_function("deltaq.live.locked('gr') === ''")
    if page.evaluate("deltaq.live.robot('gr').phase") == "held":
        tab_to(page, "Reset")
        page.keyboard.press("Enter")
        page.wait_for_function("deltaq.live.robot('gr').phase !== 'held'")
    tab_to(page, "Take control")
    page.keyboard.press("Enter")
    page.wait_for_function("deltaq.live.robot('gr').lease.mine")
    tab_to(page, "Joint")
    page.keyboard.press("Enter")
    page.wait_for_function("deltaq.live.robot('gr').mode === 'joint' && deltaq.live.cannotDrive('gr') === ''")
    page.keyboard.press("9")
    page.wait_for_function("document.querySelector('.jog-row[data-chosen]')?.textContent.includes('A6')")
    before = page.evaluate(Q)
    # pressed anew where the picture was old for a moment
    while not page.evaluate(f"before => Math.abs({Q}[8] - before[8]) > 0.02", before):
        page.keyboard.down("ArrowUp")
        page.wait_for_function(
            f"before => Math.abs({Q}[8] - before[8]) > 0.02 || !deltaq.wish.isActive", arg=before
        )
        page.keyboard.up("ArrowUp")
    page.wait_for_function(AT_REST)
    assert page.evaluate(f"before => {Q}.slice(0, 8).every((q, k) => Math.abs(q - before[k]) < 1e-3)", before)
    page.keyboard.press("Escape")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
