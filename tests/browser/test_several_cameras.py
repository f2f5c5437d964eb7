"""The console of a cell with two cameras: whose picture is shown, and when another's is."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from conftest import TIMEOUT_MS
from live_stack import live_stack
from pages import steps

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.services import Service, console_service
from deltaq_protocol.blocking import connect
from deltaq_protocol.messages import ViewTarget

pytestmark = [pytest.mark.browser, pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(300)]

PAGE = Path(__file__).parents[2] / "docs/how-to/several-cameras.md"
UNDER_THE_DECK = ViewTarget(focus_m=(-0.55, -2.2, 0.3))


@contextmanager
def following(url: str, robot: str) -> Iterator[None]:
    words = ["-m", "deltaq_controllers.camera_follower", "--url", url, "--robot", robot, "--controller", "qp"]
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True) as follower:
        try:
            assert follower.stdout is not None
            assert any("ready" in line for line in follower.stdout)
            yield
        finally:
            follower.terminate()
            follower.communicate()


def test_the_picture_switches_to_the_camera_with_a_view_unless_one_was_chosen(
    chromium: Any, tmp_path: Path
) -> None:
    (cell_file,) = (step for step in steps(PAGE.read_text(encoding="utf-8")) if step.kind == "write")
    base = tmp_path / cell_file.argument
    base.write_text(cell_file.text, encoding="utf-8")

    def with_console(services: list[Service], file: Path) -> list[Service]:
        return [*services, console_service(load_cell(file), str(file), services)]

    with live_stack(tmp_path, base=base, rewired=with_console) as stack:
        url = stack.cell.hli
        page = chromium.new_context(viewport={"width": 1280, "height": 720}, bypass_csp=True).new_page()
        page.set_default_timeout(TIMEOUT_MS)
        with following(url, "fr"), following(url, "aide"), connect(url, client="test") as cell:
            page.goto(f"http://127.0.0.1:{stack.cell.console_port}")
            shown = "deltaq.picture.view.name"
            both = "Object.values(deltaq.live.status?.robots ?? {}).filter(({sight}) => sight === 'fresh').length === 2"
            page.wait_for_selector("[data-ready=true]", state="attached")
            page.wait_for_function(both)
            # whichever saw its target first
            page.get_by_label("Camera", exact=True).select_option("fr")
            page.get_by_label("Camera", exact=True).select_option("auto")
            assert page.evaluate(shown) == "fr"
            cell.view("fr", targets=[UNDER_THE_DECK])
            page.wait_for_function(f"{shown} === 'aide' && deltaq.live.robot('fr').sight === 'view_hidden'")
            assert page.get_by_label("Camera", exact=True).input_value() == "auto"
            page.get_by_label("Camera", exact=True).select_option("fr")
            assert page.evaluate(shown) == "fr"
            # one that was chosen stays, though the other sees more: as many frames go by as would hand over
            until_s = page.evaluate("deltaq.live.frame.server_s") + 3
            page.wait_for_function("until_s => deltaq.live.frame.server_s > until_s", arg=until_s)
            assert page.evaluate(shown) == "fr"
            page.get_by_label("Camera", exact=True).select_option("auto")
            page.wait_for_function(f"{shown} === 'aide'")
            page.context.close()
