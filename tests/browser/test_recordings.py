"""Recordings on the page, in Chromium before a running cell: one is made, another is shown, and neither is mistaken."""

import pytest
from test_page import take_control

from deltaq_protocol import topics
from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.recorder.reader import Recording
from deltaq_services.recorder.writer import RecordingWriter

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.timeout(300)]

CYCLE_S = 0.012
CYCLES = 500
REFUSED_FROM = 300
NAME = "turned.mcap"
SHOWN = "deltaq.views.find((view) => view.name === 'gr').q"


@pytest.fixture
def turned(served_cell):
    """A recording of six seconds in which gr turns A6 far from where it stands, and is held from 3.6 s on."""
    robot = served_cell.model.robots["gr"]
    file = served_cell.recordings / NAME
    with RecordingWriter(file, served_cell.model.description_message(), "live") as writer:
        for cycle in range(CYCLES):
            at = round(1e9 * CYCLE_S * cycle)
            q = (*robot.home[:-1].tolist(), robot.home[-1] + 0.5 + 0.002 * cycle)
            state = RobotState(
                robot="gr", cycle=cycle, ipoc=cycle, time_s=0.0, q=q, q_cmd=q, tool=robot.tool_pose(robot.home),
                phase=Phase.ENGAGED,
            )  # fmt: skip
            writer.publish(topics.STATE, state, at)
            held = cycle >= REFUSED_FROM
            verdict = Verdict(
                robot="gr", cycle=cycle, seq=cycle, outcome=Outcome.HELD if held else Outcome.ADMITTED,
                reasons=(Reason(code=ReasonCode.POSITION_LIMIT, what="a6"),) if held else (),
            )  # fmt: skip
            writer.publish(topics.VERDICT, verdict, at)
    yield file
    file.unlink()


def open_recording(page, name):
    page.locator("[data-part=recordings]").click()
    page.locator(f"[data-recording='{name}']").click()
    page.wait_for_function("deltaq.live.replay !== null")


def shown_a6(page):
    return page.evaluate(f"{SHOWN}.at(-1)")


@pytest.mark.nightly
def test_scrubbing_a_recording_marks_the_scene_as_recorded(opened, served_cell, turned):
    page = opened()
    take_control(page)
    home = served_cell.model.robots["gr"].home[-1]
    open_recording(page, NAME)

    # named, framed, and nothing to drive with
    banner = page.locator(".replay header")
    assert "RECORDING" in banner.text_content()
    assert NAME in banner.text_content()
    assert page.evaluate("document.documentElement.dataset.replay") == "true"
    assert page.get_by_role("button", name="A6 plus, hold to move").count() == 0, "hidden, not only locked"
    for hidden in (".badge", ".chips", ".age", ".plots", "[data-mode]"):
        assert not page.locator(hidden).first.is_visible(), hidden
    assert page.evaluate("deltaq.live.cannotDrive('gr')") == "a recording is shown"
    ack = page.evaluate("deltaq.live.send('mode', {robot: 'gr', mode: 'joint'})")
    assert (ack["outcome"], "a recording is shown" in ack["text"]) == ("refused", True)
    assert page.evaluate("deltaq.wish.hold('test', {0: 0.1})") is False

    # scrubbed, and to the next refusal
    slide = page.get_by_label("Time of the recording")
    slide.fill("1.2")
    page.wait_for_function(f"home => Math.abs({SHOWN}.at(-1) - home - 0.5 - 0.2) < 0.01", arg=home)
    page.get_by_role("button", name="Next refusal").click()
    assert page.evaluate("deltaq.player.player.time_s") == pytest.approx(REFUSED_FROM * CYCLE_S, abs=1e-6)
    page.wait_for_function("document.querySelector('[data-part=notices]').textContent.includes('gr held')")
    assert page.locator(".verdicts [data-now]").count() == 1
    assert page.get_by_role("button", name="Next refusal").is_disabled()

    # played slowly, with the live cell going on behind it
    slide.fill("0")
    page.get_by_label("Speed of the recording").select_option("0.1")
    frames = page.evaluate("deltaq.live.frame.server_s")
    page.get_by_role("button", name="Play", exact=True).click()
    page.wait_for_function(
        "frames => deltaq.player.player.time_s > 0.05 && deltaq.live.frame.server_s > frames", arg=frames
    )
    at, a6 = page.evaluate("[deltaq.player.player.time_s, " + SHOWN + ".at(-1)]")
    assert 0.0 < at < 6.0
    assert a6 > home + 0.49

    # back: the cell as it is
    page.get_by_role("button", name="Back to the live cell").click()
    page.wait_for_function(f"home => Math.abs({SHOWN}.at(-1) - home) < 0.4", arg=home)
    page.wait_for_function("deltaq.live.cannotDrive('gr') === 'take control of it first'")
    take_control(page)
    assert page.locator(".badge").is_visible()
    assert not banner.is_visible()


@pytest.mark.nightly
def test_stop_while_a_recording_is_shown_stops_the_live_robots(opened, turned):
    page = opened()
    take_control(page)
    open_recording(page, NAME)
    answer = page.locator("[data-part=stop-answer]")
    assert page.evaluate("deltaq.stop.state !== 'ready'") or answer.text_content() == "stops the LIVE robots"
    page.keyboard.press("Escape")
    page.wait_for_function("deltaq.stop.state === 'at_rest'")
    assert answer.text_content() == "every robot is at rest"
    assert page.evaluate("deltaq.live.robot('gr').reason") == "operator_stop"
    assert page.evaluate("deltaq.live.replay !== null"), "the recording is still shown, and still named"
    assert page.locator(".replay header strong").is_visible()


@pytest.mark.nightly
def test_the_cell_is_recorded_from_the_page_and_shown_by_it(opened, served_cell):
    page = opened()
    page.wait_for_function("!deltaq.live.isStale()")
    page.locator("[data-part=recordings]").click()
    page.get_by_role("button", name="Record the cell").click()
    page.wait_for_function("deltaq.live.status.recording.since_s")
    name = page.evaluate("deltaq.live.status.recording.file")
    file = served_cell.recordings / name
    assert page.locator("[data-part=recordings]").text_content() == "● Recording the cell"
    cycles = page.evaluate("deltaq.live.frame.server_s")
    page.wait_for_function("begun => deltaq.live.frame.server_s > begun + 1", arg=cycles)
    page.get_by_role("button", name="End the recording").click()
    page.wait_for_function("name => deltaq.live.status.recording.text === `${name} was recorded`", arg=name)
    recording = Recording.open(file)
    states = [item.message for item in recording.messages((topics.STATE,))]
    assert {state.robot for state in states} == {"fr", "gr"}
    assert recording.notices == [], "it is whole"
    page.locator(f"[data-recording='{name}']").click()
    page.wait_for_function("deltaq.live.replay !== null")
    assert page.evaluate("deltaq.live.replay.length_s") > 0.1


@pytest.mark.nightly
def test_an_unreadable_recording_is_reported_and_the_cell_stays_shown(opened, served_cell):
    (served_cell.recordings / "broken.mcap").write_text("no recording")
    page = opened()
    page.locator("[data-part=recordings]").click()
    page.locator("[data-recording='broken.mcap']").click()
    page.wait_for_function("document.querySelector('.library .answer').textContent.includes('no recording')")
    assert page.evaluate("deltaq.live.replay") is None
    assert not page.locator(".replay header").is_visible()
