"""Steps, typed targets and what the page draws beside them, on the page alone."""

import math

import numpy as np
import pinocchio as pin
import pytest
from conftest import mine, status

from deltaq_cell.cell_model import CellModel

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.timeout(300)]


def test_the_browser_places_links_where_pinocchio_does(alone):
    page = alone()
    generator = np.random.default_rng(3)
    for robot in CellModel.load("lab").robots.values():
        data = robot.model.createData()
        drawn = generator.uniform(robot.lower, robot.upper, (20, robot.n))
        placed = page.evaluate(
            """([name, drawn]) => {
                const {kinematics} = deltaq.views.find((view) => view.name === name);
                return drawn.map((q) => kinematics.place(q).map((T) => Array.from(T)));
            }""",
            [robot.name, drawn.tolist()],
        )
        for q, told in zip(drawn, placed, strict=True):
            pin.forwardKinematics(robot.model, data, q)
            for index, columns in enumerate(told, start=1):
                expected = data.oMi[index].homogeneous
                np.testing.assert_allclose(np.reshape(columns, (4, 4)).T, expected, atol=1e-6)


AXES = "deltaq.axes.map(({visible, matrix}) => visible && Array.from(matrix.elements))"
JOGGED = """status => {
    line.show(status);
    if (!deltaq.wish.hold("test", {0: 0.1})) return false;
    for (const action of deltaq.stage._before) action(performance.now()); // what goes ahead of a picture
    return [AXES, Array.from(deltaq.views.find(({name}) => name === "gr").toolPose(0))];
}""".replace("AXES", AXES)
"""In one turn of the page, in which nothing can let the hand go: jog it, and look at its axes and its pose."""


def test_jogging_a_hand_draws_the_jog_axes_at_it(alone):
    page = alone()
    assert page.evaluate(AXES) == [False]
    for frame in ("world", "tool"):
        told = status(gr=mine(mode="coupled", frame=frame))
        [drawn], hand = page.wait_for_function(JOGGED, arg=told).json_value()
        expected = hand if frame == "tool" else [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *hand[12:]]
        assert drawn == pytest.approx(expected, abs=1e-3)
        page.evaluate("status => line.show(status)", status(gr=mine(mode="joint")))
        page.wait_for_function("!deltaq.axes[0].visible")


def test_shown_and_hidden_plots_survive_a_reload(alone):
    page = alone()
    shown = "[...document.querySelectorAll('.plot:not([hidden]) b')].map((title) => title.textContent)"
    usual = page.evaluate(shown)
    assert "Clearance" in usual
    choice = page.get_by_label("Show or hide a plot")
    choice.select_option("gr A1")
    choice.select_option("Clearance")
    wanted = [title for title in usual if title != "Clearance"] + ["gr A1"]
    assert page.evaluate(shown) == wanted
    page.wait_for_function(
        "[...document.querySelectorAll('.plot')].find((plot) => plot.textContent.startsWith('gr A1'))"
        ".querySelector('output').textContent.match(/[0-9]/)")  # fmt: skip
    page.reload()
    page.wait_for_selector("[data-ready=true]", state="attached")
    assert page.evaluate(shown) == wanted


def test_until_the_cell_is_drawn_the_page_says_that_it_is_loading(alone):
    page = alone()
    loading = page.get_by_text("The cell is loading")
    assert loading.is_hidden()
    page.evaluate("delete document.querySelector('.console').dataset.ready")
    assert loading.is_visible()


PRESS_TWICE = """name => {
    const show = () => deltaq.driven.dispatchEvent(new Event("change"));
    show();
    const button = [...document.querySelectorAll(".jog button")].find(({ariaLabel}) => ariaLabel === name);
    for (const _ of [1, 2]) button.dispatchEvent(new KeyboardEvent("keydown", {key: "Enter"}));
    show();
    return document.querySelector(".jog .why").textContent;
}"""
SENT = "kind => line.sent.filter(({type}) => type === kind)"


STEPS = [
    ("joint", "A6 minus, press to step", 8, -math.radians(1)),
    ("joint", "E2 plus, press to step", 1, 0.005),
    ("coupled", "Z plus, press to step", 2, 0.005),
    ("coupled", "turn X minus, press to step", 3, -math.radians(1)),
]


def test_in_steps_one_press_moves_once_by_one_degree_or_five_millimetres(alone):
    page = alone()
    page.evaluate("status => line.show(status)", status(gr=mine(mode="joint")))
    page.locator("[data-steps=true]").click()
    for mode, button, index, size in STEPS:
        page.evaluate("status => line.show(status)", status(gr=mine(mode=mode)))
        page.wait_for_function("performance.now() >= (deltaq.wish._stepsUntil ?? 0)")
        page.evaluate("line.sent.length = 0")
        assert "one at a time" in page.evaluate(PRESS_TWICE, button)
        (jog,) = page.evaluate(SENT, "jog")
        moved = [rate * jog["cycles"] * page.evaluate("deltaq.scene.cycle_s") for rate in jog["wish"]]
        assert moved == pytest.approx([size if k == index else 0.0 for k in range(len(moved))])


def test_joint_home_and_saved_positions_fill_the_request_without_motion(alone):
    page = alone()
    page.evaluate("status => line.show(status)", status(gr=mine(mode="pose")))
    page.get_by_text("Home, saved positions, joints").click()
    home = page.evaluate("deltaq.driven.scenery.home")
    a6 = page.get_by_label("A6 in °")
    a6.fill("12")
    a6.press("Enter")
    page.wait_for_function("line.sent.some(({type}) => type === 'reach_joints')")
    asked = page.evaluate(SENT, "reach_joints")[-1]["q"]
    assert asked == pytest.approx([*home[:8], math.radians(12)], abs=1e-5)
    page.get_by_label("Name of this position").fill("above the tank")
    page.get_by_role("button", name="Save", exact=True).click()
    place = page.get_by_label("Go to a saved position")
    for count, name in enumerate(("home", "above the tank"), start=2):
        place.select_option(name)
        page.wait_for_function(
            "count => line.sent.filter(({type}) => type === 'reach_joints').length === count", arg=count
        )
        assert page.evaluate(SENT, "reach_joints")[-1]["q"] == pytest.approx(home, abs=1e-5)
    angle = page.get_by_label("C of the hand in °")
    angle.fill("170")
    angle.press("Enter")
    page.wait_for_function("line.sent.some(({type}) => type === 'reach')")
    assert not page.evaluate("line.sent.some(({type}) => type === 'jog')")
