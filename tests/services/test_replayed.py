"""A recording as the console shows it: even steps, what was not admitted, and nothing of another cell."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from audited import NOTE
from ran import ran

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.messages import (
    NearestPair,
    Outcome,
    Phase,
    Proximity,
    Reason,
    RobotState,
    ToolPose,
    Verdict,
    ViewTarget,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.recorder.reader import UnreadableRecordingError
from deltaq_services.recorder.replayed import (
    NO_STATE,
    PERIOD_S,
    EmptyReplayError,
    OtherCellRecordedError,
    replayed,
)
from deltaq_services.recorder.writer import RecordingWriter

CYCLE_S = 0.012
CYCLES = 250
GAP = range(100, 160)


@pytest.fixture(scope="module")
def cell() -> CellModel:
    return CellModel.load("lab")


@pytest.fixture(scope="module")
def recorded(cell: CellModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fr turns A1; for a while no states come; from cycle 200 on every increment is held."""
    file = tmp_path_factory.mktemp("replayed") / "run.mcap"
    robot = cell.robots["fr"]
    with RecordingWriter(file, cell.description_message(), "live") as writer:
        for cycle in range(CYCLES):
            at = round(1e9 * CYCLE_S * cycle)
            q = (robot.home[0] + 0.001 * cycle, *robot.home[1:].tolist())
            if cycle not in GAP:
                state = RobotState(
                    robot="fr", cycle=cycle, ipoc=cycle, time_s=0.0, q=q, q_cmd=q,
                    tool=robot.tool_pose(robot.home), phase=Phase.ENGAGED,
                )  # fmt: skip
                writer.publish(topics.STATE, state, at)
            reasons = (
                (Reason(code=ReasonCode.CLEARANCE, what="fr/link_4 structure/tank_1"),)
                if cycle >= 200
                else ()
            )
            outcome = Outcome.HELD if reasons else Outcome.ADMITTED
            verdict = Verdict(
                robot="fr", cycle=cycle, seq=cycle, outcome=outcome, reasons=reasons, clearance_m=0.1
            )
            writer.publish(topics.VERDICT, verdict, at)
            if cycle == 100:
                writer.publish(topics.AUDIT, NOTE, at)
            if cycle % 10 == 0:
                pair = NearestPair(
                    pair=("fr/link_4", "structure/tank_1"), distance_m=0.3, points_m=((0, 0, 0), (0, 0, 1))
                )
                writer.publish(topics.PROXIMITY, Proximity(time_s=0.0, pairs=(pair,)), at)
    return file


def test_a_recording_of_another_cell_is_refused(recorded: Path) -> None:
    with pytest.raises(OtherCellRecordedError, match=r"run\.mcap has read cell lab .*, and here it is dawm"):
        replayed(recorded, str(CellModel.load("dawm").identity))


def test_recordings_without_states_and_other_files_are_refused(cell: CellModel, tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "empty.mcap", cell.description_message(), "live").close()
    with pytest.raises(EmptyReplayError, match="nothing to show"):
        replayed(tmp_path / "empty.mcap", str(cell.identity))
    (tmp_path / "notes.mcap").write_text("notes")
    with pytest.raises(UnreadableRecordingError):
        replayed(tmp_path / "notes.mcap", str(cell.identity))


def test_robots_and_their_silence_are_given_at_even_steps(recorded: Path, cell: CellModel) -> None:
    told = replayed(recorded, str(cell.identity))
    fr, gr = told["robots"]["fr"], told["robots"]["gr"]
    steps = len(fr["q"])
    assert (steps - 1) * PERIOD_S == pytest.approx(CYCLE_S * CYCLES, abs=2 * PERIOD_S)
    for step in range(1, 20):
        cycle = (step * PERIOD_S) // CYCLE_S
        assert fr["q"][step][0] == pytest.approx(cell.robots["fr"].home[0] + 0.001 * cycle, abs=1.1e-3)
    assert NO_STATE in fr["phase"], "the gap"
    assert fr["phase"][0] != NO_STATE
    assert fr["phase"][-1] != NO_STATE
    assert set(gr["phase"]) == {NO_STATE}
    assert set(gr["q"]) == {None}


def test_repeated_verdicts_are_one_line_beside_the_notes(recorded: Path, cell: CellModel) -> None:
    told, line = replayed(recorded, str(cell.identity))["verdicts"]
    assert (told["robot"], told["outcome"], told["text"]) == ("fr", "note", NOTE.text)
    assert told["time_s"] == pytest.approx(100 * CYCLE_S)
    assert (line["robot"], line["outcome"], line["code"], line["count"]) == ("fr", "held", "clearance", 50)
    assert line["time_s"] == pytest.approx(200 * CYCLE_S)
    assert line["until_s"] == pytest.approx(249 * CYCLE_S)


def test_a_long_recording_has_longer_steps(recorded: Path, cell: CellModel) -> None:
    told = replayed(recorded, str(cell.identity), most_ticks=30)
    q = told["robots"]["fr"]["q"]
    assert told["period_s"] == pytest.approx(4 * PERIOD_S)
    assert len(q) <= 31
    assert (len(q) - 1) * told["period_s"] == pytest.approx(CYCLE_S * CYCLES, abs=2 * told["period_s"])
    assert q[5][0] == pytest.approx(
        cell.robots["fr"].home[0] + 0.001 * 5 * told["period_s"] / CYCLE_S, abs=2e-3
    )


@pytest.mark.long
def test_the_process_prints_it_and_errors_are_one_line(recorded: Path, cell: CellModel) -> None:
    def run(file: Path) -> subprocess.CompletedProcess[str]:
        command = ["-m", "deltaq_services.recorder.replayed", str(file), "--identity", str(cell.identity)]
        return ran([sys.executable, *command], check=False)

    assert json.loads(run(recorded).stdout) == json.loads(json.dumps(replayed(recorded, str(cell.identity))))
    missing = run(recorded.with_name("missing.mcap"))
    assert (missing.returncode, missing.stdout) == (2, "")
    assert missing.stderr.count("\n") == 1


def test_the_recorded_target_of_a_camera_is_shown_at_its_place(cell: CellModel, tmp_path: Path) -> None:
    half_turn = ToolPose(position=(1.0, 2.0, 3.0), quaternion_wxyz=(0.0, 0.0, 0.0, 1.0))
    looked = [
        ViewTarget(leader="gr"),
        ViewTarget(leader="gr", aim_offset_m=(0.1, 0.0, 0.04)),
        None,
        ViewTarget(leader="nobody"),
        ViewTarget(focus_m=(-0.4, 0.7, 1.3)),
    ]
    with RecordingWriter(tmp_path / "run.mcap", cell.description_message(), "live") as writer:
        for cycle, target in enumerate(looked):
            for name, at in (("gr", None), ("fr", target)):
                q = tuple(cell.robots[name].home.tolist())
                state = RobotState(
                    robot=name, cycle=cycle, ipoc=cycle, time_s=0.0, q=q, q_cmd=q,
                    tool=half_turn, phase=Phase.ENGAGED, target=at,
                )  # fmt: skip
                writer.publish(topics.STATE, state, round(1e9 * PERIOD_S * cycle))
    robots = replayed(tmp_path / "run.mcap", str(cell.identity))["robots"]
    told = robots["fr"]["focus"]
    assert told[-5:] == [[1.0, 2.0, 3.04], [0.9, 2.0, 3.04], None, None, [-0.4, 0.7, 1.3]]
    assert set(robots["gr"]["focus"]) == {None}
