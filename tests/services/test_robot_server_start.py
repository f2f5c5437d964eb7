"""A Robot Server does not start on files of a KRC that cannot be safe."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import deltaq_deploy
from deltaq_deploy.launch.private_cell import write_private_cell

KRC = Path(deltaq_deploy.__file__).parent / "krc"
PATIENCE_S = 300.0


def start(folder: Path, *edits: tuple[str, str]) -> subprocess.Popen[str]:
    text = (KRC / "fr_ethernet.xml").read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (folder / "mine_ethernet.xml").write_text(text, encoding="utf-8")
    cell = write_private_cell(folder)
    described = yaml.safe_load(cell.read_text(encoding="utf-8"))
    described["robots"]["fr"]["driver"]["ethernet_xml"] = "mine_ethernet.xml"
    cell.write_text(yaml.safe_dump(described), encoding="utf-8")
    command = [sys.executable, "-m", "deltaq_services.robot_server", "--cell", str(cell), "--robot", "fr"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.long
def test_unsafe_files_end_it_with_status_2_and_every_reason(tmp_path: Path) -> None:
    process = start(tmp_path, ('HOLDON="1"', 'HOLDON="0"'), ("ONLYSEND>FALSE", "ONLYSEND>TRUE"))
    try:
        output, errors = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()  # of one that serves after all nothing is left
        process.wait()
    assert process.returncode == 2
    assert "ready" not in output
    assert "error: the KRC's files are refused:" in errors
    assert "mine_ethernet.xml: CONFIG/ONLYSEND: is TRUE" in errors
    assert [f"RECEIVE/AK.A{i}: HOLDON is 0" in errors for i in range(1, 7)] == [True] * 6
    assert "Traceback" not in errors


@pytest.mark.service
def test_what_makes_an_outage_worse_is_told_and_it_serves(tmp_path: Path) -> None:
    process = start(tmp_path, ('<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL" UNIT="0" />', ""))
    assert process.stdout is not None
    lines = []
    try:
        for line in process.stdout:
            lines.append(line)
            if line.startswith("ready: robot-server-fr"):
                break
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert lines[0].startswith("warning: mine_ethernet.xml: SEND/DEF_Delay: is missing")
    assert lines[-1].startswith("ready")
