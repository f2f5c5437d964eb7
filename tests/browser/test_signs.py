"""What the page draws and plots for the operator, on the page alone."""

import pytest
from conftest import mine, status

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.timeout(300)]

AXES = "deltaq.axes.map(({visible, matrix}) => visible && Array.from(matrix.elements))"


@pytest.mark.parametrize("frame", ["world", "tool"])
def test_while_a_hand_is_jogged_the_axes_that_it_is_jogged_along_are_drawn_at_it(alone, frame):
    page = alone()
    page.evaluate("status => line.show(status)", status(gr=mine(mode="coupled", frame=frame)))
    assert page.evaluate(AXES) == [False]
    # pressed anew where the picture was old for a moment
    page.evaluate("setInterval(() => deltaq.wish.isActive || deltaq.wish.hold('test', {0: 0.1}), 20)")
    page.wait_for_function("deltaq.axes[0].visible")
    (drawn,) = page.evaluate(AXES)
    hand = page.evaluate("Array.from(deltaq.views.find(({name}) => name === 'gr').toolPose(0))")
    expected = hand if frame == "tool" else [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *hand[12:]]
    assert drawn == pytest.approx(expected, abs=1e-3)
    page.evaluate("status => line.show(status)", status(gr=mine(mode="joint")))
    page.wait_for_function("!deltaq.axes[0].visible")


def test_a_plot_is_shown_or_hidden_as_chosen_also_when_the_page_is_loaded_again(alone):
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
    page.route("**/scene.json", lambda route: None)
    page.reload(wait_until="commit")
    loading.wait_for()
