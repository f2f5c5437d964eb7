"""Options of the advisor, a pose to drag, and a robot taken over, in Chromium before a running cell."""

import numpy as np
import pytest
from test_page import AT_REST, Q

from deltaq_deploy.launch.cell_connection import connect

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

SEARCH = "deltaq.live.robot('gr').search"
TIP = """(() => {
    // the tip of the arrow along z, in the window
    const {gizmo, stage} = deltaq;
    gizmo.root.updateMatrixWorld(true);
    const at = gizmo.root.localToWorld(gizmo.root.position.clone().set(0, 0, 0.9)).project(stage.camera);
    const box = stage.canvas.getBoundingClientRect();
    return [box.left + (at.x + 1) / 2 * box.width, box.top + (1 - at.y) / 2 * box.height];
})()"""


def in_mode(page, mode, robot="gr"):
    """Take a robot, whichever way it was driven before, and drive it in a mode."""
    page.locator(f"[data-robot={robot}]").click()
    page.wait_for_function("robot => deltaq.live.locked(robot) === ''", arg=robot)
    page.get_by_role("button", name="Take control").click()
    page.wait_for_function(
        "robot => (deltaq.live.robot(robot).lease.mine && deltaq.live.robot(robot).mode)"
        " || ['refused', 'expired', 'not_sent'].includes(document.querySelector('.answer').dataset.outcome)",
        arg=robot,
    )
    assert page.evaluate("robot => deltaq.live.robot(robot).lease.mine", robot), page.locator(
        ".answer"
    ).first.text_content()
    page.locator(f"[data-mode={mode}]").click()
    page.wait_for_function("([robot, mode]) => deltaq.live.robot(robot).mode === mode", arg=[robot, mode])


def hold(page, button, option):
    """Hold a button; its wish is taken up anew if the picture was old for a moment."""
    button.scroll_into_view_if_needed()
    button.hover()
    page.mouse.down()
    page.evaluate(
        "option => { window.pressing = setInterval(() => deltaq.wish.isActive"
        " || deltaq.wish.hold('test', {option}), 50); }",
        option,
    )


def tip_at_rest(page):
    """Where the tip is once the gizmo and the page around it stand still for three pictures."""
    return page.evaluate(
        f"""async () => {{
            for (let last = [], count = 0; ; ) {{
                await new Promise(requestAnimationFrame);
                const tip = {TIP};
                count = tip.every((value, k) => value === last[k]) ? count + 1 : 0;
                if (count === 3) return tip;
                last = tip;
            }}
        }}"""
    )


def give_back(page, robot="gr"):
    """Release a robot, for whoever comes next."""
    page.evaluate("robot => deltaq.live.send('lease', {robot, action: 'release'})", robot)
    page.wait_for_function("robot => !deltaq.live.robot(robot).lease.holder", arg=robot)


def let_go(page):
    page.evaluate("clearInterval(window.pressing); deltaq.wish.release('test')")
    page.mouse.up()
    page.wait_for_function(f"!deltaq.wish.isActive && {AT_REST}")


@pytest.mark.nightly
def test_an_option_is_previewed_approached_while_held_and_cancelled(opened):
    page = opened()
    in_mode(page, "advisor")
    page.wait_for_function(f"document.querySelector('.card-option') && !{SEARCH}.is_busy")
    before = page.evaluate(Q)
    ways = page.evaluate("deltaq.ways.of('gr', 'advisor').map(({rank, points}) => [rank, points.length])")
    rank = next(rank for rank, points in ways if points > 1)
    card = page.locator(f"[data-option='{rank}']")
    assert "joint travel" in card.text_content()

    # a ghost where it leads, and nothing moves
    card.hover()
    page.wait_for_function(f"deltaq.wayPicture.way?.rank === {rank}")
    assert page.evaluate(Q) == pytest.approx(before, abs=1e-4)

    # it goes while the button is held, and rests when it is let go
    hold(page, card.locator(".hold-to-go"), rank)
    page.wait_for_function(f"{SEARCH}.way === {rank} && {SEARCH}.driven > 0.02")
    let_go(page)
    page.wait_for_function(f"{SEARCH}.driven < 1")
    assert page.evaluate(Q) != pytest.approx(before, abs=1e-3)
    assert card.locator(".hold-to-go").text_content() == "Hold to continue"

    # held again it goes on, to the end, and stays there however long it is held
    hold(page, card.locator(".hold-to-go"), rank)
    page.wait_for_function(f"{SEARCH}.arrived")
    card.get_by_text("The robot is here").wait_for()
    let_go(page)
    option = page.evaluate("rank => deltaq.ways.of('gr', 'advisor').find((way) => way.rank === rank).q", rank)
    assert page.evaluate(Q) == pytest.approx(option, abs=2e-3)

    page.get_by_role("button", name="Cancel").click()
    page.wait_for_function(f"{SEARCH}.way === null")
    assert page.evaluate(AT_REST)

    # of two criteria that are chosen the front is shown
    page.get_by_label("Trade off").select_option("travel")
    page.get_by_label("against").select_option("compliance")
    page.get_by_role("button", name="Look again").click()
    page.wait_for_function(f"{SEARCH}.trade_off && !{SEARCH}.is_busy")
    page.wait_for_function(
        "document.querySelector('.advisor .doing').textContent.includes('Pareto front of “joint travel”')"
    )
    scores = page.evaluate(
        "deltaq.ways.of('gr', 'advisor').map(({costs}) => [costs.travel, costs.compliance])"
    )
    assert len(scores) > 1
    assert scores == sorted(scores)

    # hands that may leave their pose are offered what they could not keep it on the way to
    leaves = page.get_by_label("Hands may leave their pose on the way, and return")
    assert not leaves.is_checked()
    leaves.check()
    page.get_by_label("Trade off").select_option("")
    page.get_by_role("button", name="Look again").click()
    page.wait_for_function(f"{SEARCH}.hands_may_leave && !{SEARCH}.is_busy")
    assert leaves.is_checked()
    page.wait_for_function("deltaq.ways.of('gr', 'advisor').some(({hands_leave}) => hands_leave)")
    give_back(page)


@pytest.mark.nightly
def test_a_non_redundant_arm_is_offered_paths_on_which_its_hand_leaves(opened):
    page = opened()
    in_mode(page, "advisor", "fr")
    assert page.locator("[data-mode=self-motion]").is_hidden()
    # its driver says that the hand may leave: without that there is nothing to offer
    page.wait_for_function(
        "deltaq.live.robot('fr').search?.hands_may_leave && !deltaq.live.robot('fr').search.is_busy"
    )
    assert page.get_by_label("Hands may leave their pose on the way, and return").is_checked()
    page.wait_for_function("deltaq.ways.of('fr', 'advisor').some(({hands_leave}) => hands_leave)")
    told = page.locator(".card-option", has_text="The hand leaves its pose on the way and returns to it.")
    told.first.wait_for()
    give_back(page, "fr")


@pytest.mark.nightly
def test_a_dragged_pose_is_previewed_and_approached_on_command(opened, served_cell):
    page = opened()
    in_mode(page, "pose")
    page.wait_for_function("deltaq.gizmo.root.visible")
    before = page.evaluate(Q)
    hand = page.evaluate("Array.from(deltaq.gizmo.T)")
    x, y = tip_at_rest(page)
    page.mouse.move(x, y)
    page.mouse.down()
    assert page.evaluate("deltaq.gizmo.isHeld")
    page.mouse.move(x, y + 40, steps=4)
    page.mouse.up()
    dragged = page.evaluate("Array.from(deltaq.gizmo.T)")
    assert dragged[14] < hand[14] - 0.02
    assert dragged[:14] == pytest.approx(hand[:14], abs=1e-9), "along z, and not else"
    page.wait_for_function("document.querySelector('.forecast').textContent.startsWith('Forecast: clear')")
    page.wait_for_function("document.querySelector('.pose').textContent.includes('first step: admitted')")
    assert page.evaluate("deltaq.wayPicture.way?.clear") == 1
    assert page.evaluate(Q) == pytest.approx(before, abs=1e-4), "shown, and not gone to"

    hold(page, page.locator(".pose .hold-to-go"), 1)
    page.wait_for_function(f"{SEARCH}?.arrived")
    let_go(page)
    there = served_cell.model.robots["gr"].forward(np.array(page.evaluate(Q)))[:3, 3]
    assert there == pytest.approx(dragged[12:15], abs=2e-3)
    give_back(page)


@pytest.mark.nightly
def test_an_unreachable_or_blocked_pose_is_reported_and_not_approached(opened, served_cell):
    page = opened()
    in_mode(page, "pose")
    page.wait_for_function("deltaq.gizmo.root.visible")
    field = page.get_by_label("x of the hand in mm")
    field.fill("9000")
    field.press("Enter")
    page.wait_for_function("document.querySelector('.forecast').textContent.includes('out of reach')")
    assert page.locator(".pose .hold-to-go").is_disabled()
    tank = next(body for body in served_cell.model.structure if "tank" in body.name)
    for axis, value in zip("xyz", tank.placement.translation, strict=True):
        field = page.get_by_label(f"{axis} of the hand in mm")
        field.fill(str(round(1000 * value)))
        field.press("Enter")
    page.wait_for_function("deltaq.wayPicture.way?.clear < 1")
    assert "clear for" in page.locator(".forecast").text_content()
    assert page.evaluate("deltaq.wayPicture._shown.blocked.root.visible")
    page.get_by_role("button", name="Back", exact=True).click()
    page.wait_for_function("deltaq.wayPicture.way === null")
    give_back(page)


@pytest.mark.nightly
def test_the_slider_of_the_view_distance_moves_a_camera_that_follows(opened):
    page = opened()
    in_mode(page, "decoupled", "fr")
    follow = page.locator("[data-mode=follow]")
    follow.hover()
    page.mouse.down()  # held to begin
    page.wait_for_function("deltaq.live.robot('fr').mode === 'follow'")
    page.mouse.up()
    slider = page.get_by_role("slider", name="View distance")
    slider.scroll_into_view_if_needed()
    for value in (1.2, 0.9):
        slider.fill(str(value))
        page.wait_for_function("value => deltaq.live.robot('fr').view_distance_m === value", arg=value)
        page.wait_for_function("value => Math.abs(deltaq.picture.error().distance - value) < 0.03", arg=value)
    slider.press("ArrowRight")
    page.wait_for_function("deltaq.live.robot('fr').view_distance_m === 0.95")
    assert "0.95 m" in page.locator(".field", has=slider).text_content()
    give_back(page, "fr")


@pytest.mark.nightly
def test_holding_a_button_takes_a_robot_from_another_client(opened, served_cell):
    with connect(served_cell.model.description, "night shift") as outside, outside.lease("gr"):
        page = opened()
        page.locator("[data-robot=gr]").click()
        page.wait_for_function("deltaq.live.robot('gr').lease.outside")
        words = page.locator(".lease").text_content()
        assert "night shift has control" in words
        assert "not a browser at this console" in words
        button = page.get_by_role("button", name="Hold to take over")
        button.hover()
        page.mouse.down()
        page.mouse.up()
        assert page.evaluate("deltaq.live.robot('gr').lease.holder") == "night shift", "a click is not enough"
        page.mouse.down()
        page.wait_for_function("deltaq.live.robot('gr').lease.mine")
        page.mouse.up()
        assert "You have control" in page.locator(".lease").text_content()
        page.locator(".opener").click()
        page.wait_for_function(
            "[...document.querySelectorAll('.log li')].some((line) => line.textContent.includes('from night shift'))"
        )
        give_back(page)


def test_a_routine_is_shown_before_it_starts_and_goes_on_after_a_stop_and_a_reset(opened):
    page = opened()
    in_mode(page, "joint")
    page.locator("[data-item=valve_1]").click()
    page.locator("[data-routine=turn]").click()
    page.wait_for_function("deltaq.ways.planned?.routine === 'turn'")
    (way,) = page.evaluate("deltaq.ways.planned.ways")
    assert len(way["points"]) > 50
    assert "the gate would now admit: admitted" in page.locator(".routines .forecast").text_content()
    assert page.evaluate("!deltaq.live.robot('gr').routine"), "nothing moves yet"

    routine = "deltaq.live.robot('gr').routine"
    page.get_by_role("button", name="Hold to start").hover()
    page.mouse.down()
    page.wait_for_function(f"{routine}?.step === 5")
    page.mouse.up()
    page.evaluate("deltaq.live.send('stop')")
    page.wait_for_function(f"{routine}.end === 'held'")
    page.get_by_role("button", name="Reset all").click()
    page.wait_for_function("Object.values(deltaq.live.status.robots).every(({phase}) => phase === 'ready')")
    page.get_by_role("button", name="Resume").click()
    page.wait_for_function(f"{routine}.step > 6")
    page.get_by_role("button", name="Give up").click()
    page.wait_for_function(f"{routine}.end === 'aborted'")
