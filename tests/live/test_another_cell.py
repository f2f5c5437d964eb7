"""A SIM that was started from another description of the cell than everybody else, as processes over zenoh."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from live_stack import TIMEOUT_S, live_stack

from deltaq_cell.identity import content_identity
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import OtherCellError, Where, connect
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode

# tests/services/test_cell_mismatch.py holds it by day, without processes
pytestmark = [pytest.mark.live, pytest.mark.nightly]


def test_a_gate_that_has_read_another_cell_moves_nothing_and_everybody_says_so(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"

    def rewired(services, file):
        other.write_text(f"extends: {file}\n", encoding="utf-8")
        return [
            replace(
                service,
                arguments=tuple(str(other) if a == str(file) else a for a in service.arguments),
            )
            if service.name == "sim"
            else service
            for service in services
        ]

    with live_stack(tmp_path, moving=True, rewired=rewired) as stack:
        file = tmp_path / "private.yaml"
        ours = content_identity(load_cell(file))
        other.write_text(f"extends: {file}\ngate: {{stop_distance_m: 0.06}}\n", encoding="utf-8")
        theirs = content_identity(load_cell(other))
        stack.launcher.restart("sim")
        stack.wait_until_at_rest()
        where = Where(stack.cell.hli, stack.cell.cell)
        with connect(where, "test") as running:
            deadline = time.monotonic() + TIMEOUT_S
            while not (status := running.status()).mismatches:
                assert time.monotonic() < deadline
            (said,) = status.mismatches
            assert str(theirs) in said
            assert str(ours) in said
            assert status.robots["fr"].phase is Phase.HELD
            assert status.robots["fr"].counters["supervision_of_another_cell"] > 0
            assert status.hli["signs_of_life_of_another_cell"] > 0
            with pytest.raises(RefusedError, match=theirs.content) as refused:
                running.reset("fr")
            assert refused.value.code is ReasonCode.CELL_MISMATCH
        with (
            pytest.raises(OtherCellError, match=f"{ours.content}.*, and here it is .* {theirs.content}"),
            connect(load_cell(other), "test"),
        ):
            pass
        other.write_text(f"extends: {file}\n", encoding="utf-8")
        stack.launcher.restart("sim")
        stack.reset()
        stack.wait_until_moving()
