"""Each gain halved and doubled: what is tried, what the page says, and that the command writes both."""

from __future__ import annotations

from pathlib import Path

import pytest

from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_experiments.gain_sensitivity import PAGE, PICTURE, Errors, main, page, variants


def test_each_gain_is_halved_and_doubled_while_all_others_stay() -> None:
    usual = QpGains()._asdict()
    tried = list(variants())
    assert [(name, factor) for name, factor, _ in tried] == [
        (name, factor) for name in usual for factor in (0.5, 2.0)
    ]
    for name, factor, gains in tried:
        assert gains._asdict() == usual | {name: factor * usual[name]}


def test_the_page_has_median_and_worst_of_angle_and_distance() -> None:
    three = [Errors(0.5, 3.0), Errors(0.1, 1.0), Errors(0.2, 2.0)]
    worse = [Errors(1.5, 30.0)] * 3
    text = page(
        range(200, 203),
        {"tracking": three, "attack": three},
        [("room", 0.5, {"tracking": three, "attack": worse})],
    )
    assert "| as they are |  | 0.2; 0.5 | 2; 3 | 0.2; 0.5 | 2; 3 |" in text
    assert "| `room` | 0.5 | 0.2; 0.5 | 2; 3 | 1.5; 1.5 | 30; 30 |" in text
    assert "Seeds 200 to 202" in text


@pytest.mark.nightly
def test_the_command_writes_page_and_picture_and_a_gain_makes_a_difference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--root", str(tmp_path), "--seeds", "1", "--gain", "angle_share"]) == 0
    halved, doubled = capsys.readouterr().out.splitlines()
    assert halved.split("|")[3:] != doubled.split("|")[3:]
    assert halved in (tmp_path / PAGE).read_text(encoding="utf-8")
    assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")
