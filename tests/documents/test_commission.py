"""The commissioning guide: its commands run against the emulated controller, and its tables are the code's."""

import os
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from emulated import emulator
from ran import ran

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.prepare import refuse_unreal
from deltaq_emulator.catalogue import Code
from deltaq_emulator.settings import KrcSettings
from deltaq_testing.private_cell import write_private_cell
from deltaq_testing.virtual_cell.cell import VirtualCell

GUIDE = (Path(__file__).parents[2] / "docs" / "how-to" / "commission.md").read_text(encoding="utf-8")
BLOCKS = re.findall(
    r"<!-- not run: tests/documents/test_commission.py runs it beside an emulated controller -->\n```sh\n(.*?)^```",
    GUIDE,
    re.MULTILINE | re.DOTALL,
)
BIN = Path(sys.executable).parent


@pytest.mark.service
def test_the_commands_of_the_guide_run_unchanged(tmp_path: Path) -> None:
    cell = write_private_cell(tmp_path).rename(tmp_path / "my-cell.yaml")
    lines = [line for block in BLOCKS for line in block.splitlines() if line]
    assert len(lines) == 5
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    with emulator(cell, "fr"):
        for line in lines:
            done = ran(shlex.split(line), cwd=tmp_path, env=environment, check=False)
            # a busy machine may give the telegrams a problem to report; nothing else may be wrong
            listens = "sniff" in line or "echo" in line
            assert done.returncode in ((0, 1) if listens else (0,)), done.stderr
            assert "Traceback" not in done.stderr
            if listens:
                assert '"telegrams": 0' not in done.stdout
    assert {file.name for file in (tmp_path / "krc-files").iterdir()} == {"fr_ethernet.xml", "deltaq_fr.src"}
    first = (tmp_path / "krc-first" / "deltaq_fr.src").read_text()
    assert "ST_SETPARAM(hAxis, 2, -5)" in first
    assert "ST_SETPARAM(hAxis, 14, 5)" in first


def test_the_cells_of_the_guide_have_the_described_fields(tmp_path: Path) -> None:
    real, emulated = re.findall(r"^```yaml\n(.*?)^```", GUIDE, re.MULTILINE | re.DOTALL)
    (tmp_path / "my-cell.yaml").write_text(real)
    (tmp_path / "my-cell-emulated.yaml").write_text(emulated)
    # gr is still where the shipped cell has it: the guide speaks of fr
    refuse_unreal(load_cell(tmp_path / "my-cell.yaml"), tmp_path / "my-cell.yaml", ["fr"])
    driver = load_cell(tmp_path / "my-cell-emulated.yaml").robots["fr"].driver
    assert (driver.address, driver.krc_address, driver.port) == ("127.0.0.1", None, 49152)  # type: ignore[union-attr]


def test_every_numbered_message_of_the_emulated_controller_is_explained() -> None:
    explained = set(re.findall(r"^\| (KSS\d+)[^|]*\|[^|]+\|[^|]+\|$", GUIDE, re.MULTILINE))
    assert {code for code in Code if code.startswith("KSS")} <= explained


@pytest.mark.long
def test_a_correction_clamped_at_five_degrees_holds_the_robot_as_documented(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = KrcSettings.load().model_copy(update={"correction_limit_deg": 5.0})
    monkeypatch.setattr(KrcSettings, "load", lambda: settings)
    cell = VirtualCell("lab")
    cell.run_until_ready()
    cell.acquire("fr", "guide")
    home = cell.cell.robots["fr"].home[0]
    step = np.array([np.deg2rad(0.05), 0, 0, 0, 0, 0])
    for _ in range(400):
        cell.cycle()
        cell.ask("fr", step)
        state = cell.states["fr"]
        if state.phase == "held":
            break
    assert (state.phase, state.reason) == ("held", "tracking_error")
    assert np.rad2deg(state.q[0] - home) == pytest.approx(5.0, abs=0.01)
