"""What an operator is told of each click, whose hand moves the robot, and what to do when the HLI has died."""

import pytest
from conftest import mine, status

from deltaq_protocol.messages import Phase
from deltaq_services.console.messages import LeaseView

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.timeout(300)]


ANSWERS = {
    "{outcome: 'done'}": "Reset: done.",
    "{outcome: 'refused', text: 'robot: its cause stands.'}": "Reset: refused, its cause stands.",
    "{outcome: 'expired', text: 'your browser was 0.62 s late: press again'}": (
        "Reset: not done, your browser was 0.62 s late: press again."
    ),
    "null": "Reset: not confirmed, no answer from the console; press again.",
    "{outcome: 'asked', text: 'asked'}": "Reset: not confirmed, no answer yet; press again.",
}


def test_a_click_is_always_answered_in_words(alone):
    page = alone()
    page.evaluate("status => line.show(status)", status(gr=mine(phase=Phase.HELD, text="held")))
    # in one millisecond for five seconds, as if nothing had come
    page.evaluate("window.setTimeout = ((late) => (act, ms) => late(act, ms === 5000 ? 1 : ms))(setTimeout)")
    for answers, told in ANSWERS.items():
        page.evaluate(f"line.answers = {answers}")
        page.get_by_role("button", name="Reset").click()
        page.locator(".answer", has_text=told).wait_for()


def test_taking_a_robot_shows_a_wait_until_its_driver_is_ready(alone):
    page = alone()
    page.evaluate("line.answers = {outcome: 'asked'}")
    page.evaluate("window.setTimeout = ((late) => (act, ms) => late(act, ms === 5000 ? 0 : ms))(setTimeout)")
    page.get_by_role("button", name="Take control").click()
    page.locator(".answer", has_text="Take control: asked, the robot's driver gets ready.").wait_for()
    id_ = page.evaluate("line.sent.findLast(({type}) => type === 'lease').id")
    page.evaluate("id => line.sockets[0].says({type: 'ack', id, outcome: 'done', text: ''})", id_)
    page.locator(".answer", has_text="Take control: done.").wait_for()


def test_a_request_for_any_robot_stays_on_the_page_until_it_is_answered(
    alone,
):
    page = alone()
    asked = {"lease": LeaseView(holder="Anna", mine=True, wanted_by="Bea")}
    page.evaluate("status => line.show(status)", status(fr=asked, gr=mine()))
    banner = page.locator("[data-part=asks]")
    assert "Bea asks for fr." in banner.text_content()
    page.evaluate("document.querySelector('.left').scrollTop = 10000")
    banner.get_by_role("button", name="Keep it").click()
    (sent,) = page.evaluate("line.sent.filter(({type}) => type === 'lease')")
    assert (sent["robot"], sent["action"]) == ("fr", "refuse")
    assert banner.is_visible()
    page.evaluate("status => line.show(status)", status(fr=mine(), gr=mine()))
    assert banner.text_content() == ""


def test_the_page_names_the_lost_services_and_how_to_start_the_hli(alone):
    page = alone()
    remedy = "No robot can be driven, and control is lost. Start it: deltaq up --cell lab --only hli"
    page.evaluate("status => line.show(status)", status(hli=False, text="no answer", remedy=remedy))
    assert page.locator(".card .phase").text_content() == "the HLI is silent"
    assert page.locator(".card .remedy").text_content() == f"{remedy}. (no answer.)"


def test_a_name_is_asked_for_once_and_kept_in_the_browser(alone):
    page = alone()
    name = page.get_by_label("Your name")
    assert name.get_attribute("data-asked") == "true"
    name.fill("Anna")
    name.press("Enter")
    page.wait_for_function("line.urls.at(-1).includes('name=Anna')")
    page.reload()
    page.wait_for_selector("[data-ready=true]", state="attached")
    assert name.input_value() == "Anna"
    page.wait_for_function("document.querySelector('.who input').dataset.asked === 'false'")
    sessions = page.evaluate("line.urls.map((url) => new URL(url).searchParams.get('session'))")
    assert len(sessions[0]) > 20
    page.evaluate("status => line.show(status)", status(gr=mine()))
    page.wait_for_function("document.querySelector('.who input').disabled")


def test_the_content_security_policy_shows_the_cell_and_runs_no_inline_script(alone):
    page = alone(bypass_csp=False)
    assert page.evaluate("document.fonts.load('14px Roboto').then(({length}) => length)")
    refused = """new Promise((told) => {
        addEventListener('securitypolicyviolation', ({effectiveDirective}) => told(effectiveDirective));
        document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.ran = true'}));
    })"""
    assert page.evaluate(refused).startswith("script-src")
    assert page.evaluate("window.ran") is None
