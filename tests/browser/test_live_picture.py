"""The live picture on the page: its age by the time in the picture itself, and what is said once its service dies."""

import time
from pathlib import Path
from typing import Any

import pytest
from conftest import TIMEOUT_MS, TIMEOUT_S
from live_stack import live_stack

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.services import Service, console_service, video_services

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(300)]

CELL = "extends: lab\nrobots: {fr: {camera: {aspect: 1.3333, source: test, source_right: test}}}\n"
LEFT = "deltaq.picture.videos[0][0]"
STAMPED_MS = """video => {
    const {width, height} = video.canvas;
    const line = video.canvas.getContext("2d").getImageData(0, height - 12, width, 1).data;
    let time = 0;
    for (let bit = 0; bit < 42; bit++) time += line[4 * Math.floor((bit + 0.5) * width / 48)] > 127 ? 2 ** bit : 0;
    return time;
}"""
"""The time in a picture of the test pattern; its band of cells is 24 pixels high."""
LIVE = "deltaq.picture.eyes.length > 0 && deltaq.picture.eyes.every(({fault}) => !fault)"


def wait_for_pictures(folder: Path, count: int) -> None:
    until_s = time.monotonic() + TIMEOUT_S
    while len(list(folder.glob("*.video/fr-*.jpg"))) < count:
        assert time.monotonic() < until_s
        time.sleep(0.1)


def test_the_live_picture_tells_its_age_and_a_dead_one_turns_grey_until_it_is_back(
    chromium: Any, tmp_path: Path
) -> None:
    base = tmp_path / "base.yaml"
    base.write_text(CELL, encoding="utf-8")

    def with_pictures(services: list[Service], file: Path) -> list[Service]:
        cell = load_cell(file)
        return [
            *services,
            *video_services(cell, str(file)),
            console_service(cell, str(file), services, str(tmp_path)),
        ]

    with live_stack(tmp_path, base=base, rewired=with_pictures) as stack:
        page = chromium.new_context(viewport={"width": 1280, "height": 720}, bypass_csp=True).new_page()
        page.set_default_timeout(TIMEOUT_MS)
        page.goto(f"http://127.0.0.1:{stack.cell.console_port}")
        page.wait_for_selector("[data-ready=true]", state="attached")
        page.wait_for_function(LIVE)
        assert page.evaluate(
            "[...document.querySelectorAll('.follower .live canvas')].map(({width}) => width)"
        ) == [640, 640]

        page.get_by_label("Stereo", exact=True).select_option("plain")
        assert page.evaluate("document.querySelectorAll('.follower .live canvas').length") == 1
        # no picture may come between the two looks, so both are in one call
        told_ms, captured_ms = page.evaluate(f"[({STAMPED_MS})({LEFT}), {LEFT}.captured_ms]")
        assert told_ms == pytest.approx(captured_ms, abs=100)
        page.wait_for_function(
            f"{LEFT}.glass_ms > 0 && /^live [0-9]+ ms$/.test(deltaq.picture._age.textContent)"
        )

        # the mark is over the picture of 4:3 in the middle of the wider box, by the camera's view
        page.wait_for_function("""() => {
            const picture = deltaq.picture, T = picture.view.cameraPose(), focus = picture.focus();
            const line = [0, 1, 2].map((k) => focus[k] - T[12 + k]);
            const along = (column) => line[0] * T[column] + line[1] * T[column + 1] + line[2] * T[column + 2];
            const {width, height} = picture.box.getBoundingClientRect();
            const focal = Math.min(height, width * 3 / 4) / 2 / Math.tan(picture.settings.fov_rad / 2);
            return Math.abs(focal * along(4) / along(8) - picture._ring.getAttribute("cx")) < 1
                && Math.abs(focal * along(0) / along(8) + Number(picture._ring.getAttribute("cy"))) < 1;
        }""")

        stack.kill("video-fr")
        page.wait_for_selector(".follower .live[data-fault]")
        page.wait_for_function(
            "/old: [0-9.]+ s .the service of its picture does not run/.test(deltaq.picture._fault.textContent)"
        )
        assert "grayscale" in page.evaluate(f"getComputedStyle({LEFT}.canvas).filter")
        page.screenshot(path=tmp_path / "dead.png")
        stack.launcher.restart("video-fr")
        page.wait_for_function(LIVE)
        assert stack.phase()[0].value == "ready"

        # what was shown is recorded, and shown again
        page.evaluate("deltaq.live.send('record', {action: 'start'})")
        wait_for_pictures(tmp_path, 10)
        page.evaluate("deltaq.live.send('record', {action: 'stop'})")
        page.wait_for_function("!deltaq.live.status.recording?.file")
        page.locator("[data-part=recordings]").click()
        page.locator("[data-recording$='.mcap']").click()
        page.wait_for_function("deltaq.live.replay !== null")
        page.evaluate("deltaq.player.player.seek(1.5)")
        page.wait_for_function(f"{LIVE} && {LEFT}._shownUrl === deltaq.live.replay.picture('fr')?.url")
        page.screenshot(path=tmp_path / "replayed.png")
        told_ms, at_ms = page.evaluate(
            f"[({STAMPED_MS})({LEFT}), 1000 * (deltaq.live.replay.begin_s + deltaq.live.replay.time_s)]"
        )
        assert 0 < at_ms - told_ms < 700
        page.get_by_role("button", name="Back to the live cell").click()
        page.wait_for_function(LIVE)

        page.get_by_label("Picture", exact=True).select_option("model")
        page.wait_for_function(f"document.querySelector('.follower .live').hidden && !{LEFT}._socket")
        page.context.close()
