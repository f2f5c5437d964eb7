"""`deltaq recording report`: a recording as one page that says what happened, and that carries nothing but itself."""

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from audited import NOTE
from commands import deltaq
from ran import ran

from deltaq_cell.cell_model import CellModel
from deltaq_experiments.run_report.drawing import COLUMNS, timeline
from deltaq_experiments.run_report.figures import figures
from deltaq_experiments.run_report.page import page, write
from deltaq_experiments.run_report.run import RunEvent, RunEventKind, read_run
from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import Command, CommandReply, Plan, ServerState
from deltaq_protocol.messages import (
    NearestPair,
    Outcome,
    Phase,
    Proximity,
    Reason,
    RobotState,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.recorder.reader import UnreadableRecordingError
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_testing.report_page import outline

CYCLE_NS = 12_000_000
CYCLES = 200
NOTED, STOP, RESET, GONE = 10, 100, 150, 170
HOSTILE = "</td><script>alert(1)</script>&\"'"


@pytest.fixture(scope="module")
def cell() -> CellModel:
    return CellModel.load("lab")


def phase_at(cycle: int) -> Phase:
    return Phase.HELD if STOP <= cycle < RESET else Phase.ENGAGED


def record(path: Path, cell: CellModel, what: str = "fr/link_4 structure/pipe_5") -> Path:
    """fr turns A1; it is stopped and reset, its states fail to come for a while, and its KRC falls silent once."""
    robot = cell.robots["fr"]
    with RecordingWriter(path, cell.description_message(), "live") as writer:
        for cycle in range(CYCLES):
            at = cycle * CYCLE_NS
            if GONE <= cycle < GONE + 20:
                continue
            q = (robot.home[0] + 0.001 * cycle, *robot.home[1:].tolist())
            phase, still = phase_at(cycle), (0.0,) * 6
            reason = ReasonCode.OPERATOR_STOP if phase is Phase.HELD else None
            counters = {"admissions": cycle - cycle // 10, "krc_silent": int(cycle > 30)}
            writer.publish(
                topics.SERVER_STATE,
                ServerState(
                    robot="fr", process=1, cycle=cycle, ipoc=cycle, time_s=0.0, q=q, q_cmd=q, dq=still,
                    plan=Plan(dq=still, brake_cycles=1, step=0), epoch=1, sequence=cycle, phase=phase,
                    reason=reason, counters=counters,
                ),
                at,
            )  # fmt: skip
            state = RobotState(
                robot="fr", cycle=cycle, ipoc=cycle, time_s=0.0, q=q, q_cmd=q, tool=robot.tool_pose(np.array(q)),
                phase=phase, reason=reason, gate="code-configuration",
            )  # fmt: skip
            writer.publish(topics.STATE, state, at)
            bound = cycle % 10 == 9
            verdict = Verdict(
                robot="fr", cycle=cycle, seq=cycle, outcome=Outcome.HELD if bound else Outcome.ADMITTED,
                reasons=(Reason(code=ReasonCode.CLEARANCE, what=what),) if bound else (), clearance_m=0.2,
            )  # fmt: skip
            writer.publish(topics.VERDICT, verdict, at)
            if cycle == NOTED:
                writer.publish(topics.AUDIT, NOTE, at)
            if cycle == STOP:
                writer.publish(topics.COMMAND, Command(id=1, kind="stop"), at)
                writer.publish(topics.COMMAND_REPLY, CommandReply(id=1, accepted=True), at)
            distance_m = 0.3 - 0.001 * cycle
            points = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
            pair = NearestPair(pair=("fr/link_4", "structure/pipe_5"), distance_m=distance_m, points_m=points)
            writer.publish(topics.PROXIMITY, Proximity(time_s=0.0, pairs=(pair,)), at)
    return path


@pytest.fixture(scope="module")
def recorded(cell: CellModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("report") / "run.mcap", cell)


class Elements(HTMLParser):
    """Collects what a browser would act upon, and checks that what is opened is closed."""

    VOID = frozenset({"meta", "br", "path", "use", "rect", "line", "stop"})

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.fetched: list[str] = []
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.open += [tag] if tag not in self.VOID else []
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.fetched += [
            value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")
        ]
        self.fetched += [name for name, _ in attrs if name.startswith("on")]

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def elements(html: str) -> Elements:
    found = Elements()
    found.feed(html)
    found.close()
    assert found.open == []
    return found


# --- what cannot be reported --------------------------------------------------------------------------------------


def test_a_recording_without_states_is_reported(cell: CellModel, tmp_path: Path) -> None:
    file = tmp_path / "empty.mcap"
    RecordingWriter(file, cell.description_message(), "live").close()
    with pytest.raises(DeltaqError, match=r"empty\.mcap has no state of any robot"):
        read_run(file)


def test_a_file_other_than_a_recording_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "notes.mcap"
    file.write_text("no recording")
    with pytest.raises(UnreadableRecordingError, match=r"notes\.mcap is no recording"):
        read_run(file)


@pytest.mark.long
def test_a_truncated_recording_is_reported_up_to_its_end_with_a_notice(
    recorded: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[: int(0.9 * recorded.stat().st_size)])
    run = read_run(cut)
    assert run.robots["fr"].time_s.size > 0
    assert len(run.notices) == 1
    assert run.notices[0] in elements(page(run)).text


def test_a_report_never_overwrites_a_file(tmp_path: Path) -> None:
    file = tmp_path / "run.html"
    file.write_text("something dear")
    with pytest.raises(DeltaqError, match="name another file with --output"):
        write(file, "page")
    assert file.read_text() == "something dear"


@pytest.mark.long
def test_a_full_disk_leaves_no_partial_report(tmp_path: Path) -> None:
    file = tmp_path / "run.html"
    code = (
        "import sys, resource, signal; from pathlib import Path\n"
        "from deltaq_experiments.run_report.page import DeltaqError, write\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: write(Path(sys.argv[1]), 'x' * 100_000)\n"
        "except DeltaqError as error: print(error)\n"
    )
    done = ran([sys.executable, "-c", code, str(file)])
    assert "run.html cannot be written: File too large" in done.stdout
    assert not file.exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["missing.mcap"], "missing.mcap cannot be read: No such file"),
        (["run.mcap", "--output", "nowhere/run.html"], "there is no folder nowhere"),
        (["run.mcap", "--output", "run.mcap"], "run.mcap exists already"),
    ],
)
def test_wrong_usage_gives_exit_status_2_and_one_clear_line(
    recorded: Path, arguments: list[str], told: str
) -> None:
    done = deltaq("recording", "report", *arguments, folder=recorded.parent)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr
    assert done.stderr.count("\n") == 1


# --- what is reported ---------------------------------------------------------------------------------------------


def test_figures_agree_with_the_recorded_run(recorded: Path, cell: CellModel) -> None:
    told = figures(read_run(recorded))
    assert (told["cell"], told["source"], told["gate_fingerprints"]) == (
        "lab",
        "live",
        ["code-configuration"],
    )
    assert told["length_s"] == pytest.approx((CYCLES - 1) * 0.012)
    fr, gr = told["robots"]["fr"], told["robots"]["gr"]
    assert (fr["cycles"], fr["missed_cycles"], fr["restarts"]) == (CYCLES - 20, 20, 0)
    assert fr["interval_s"]["median"] == pytest.approx(0.012)
    assert fr["interval_s"]["longest"] == pytest.approx(21 * 0.012)
    assert fr["verdicts"] == {"admitted": 162, "held": 18}
    (group,) = fr["reasons"]
    assert (group["outcome"], group["code"], group["count"]) == ("held", "clearance", 18)
    assert group["first_s"] == pytest.approx(9 * 0.012)
    assert group["limits"] == {"fr/link_4 structure/pipe_5": 18}
    assert fr["admission_rate"] == pytest.approx(0.9, abs=0.01)
    assert told["nearest"]["distance_m"] == pytest.approx(0.3 - 0.001 * (CYCLES - 1))
    joint = fr["joints"][0]
    assert joint["greatest"] - joint["least"] == pytest.approx(0.001 * (CYCLES - 1))
    limit = cell.description_message().robots["fr"].max_velocity[0]
    assert joint["fastest_share"] == pytest.approx(0.001 / 0.012 / limit)
    assert (gr["cycles"], gr["admission_rate"], gr["interval_s"], gr["joints"]) == (0, None, None, [])


def test_events_are_reported_in_the_order_of_time(recorded: Path) -> None:
    events = read_run(recorded).events
    assert [(event.kind, event.robot, event.text) for event in events] == [
        (RunEventKind.NOTE, "fr", NOTE.text),
        (RunEventKind.FAULT, "fr", "krc_silent"),
        (RunEventKind.HOLD, "fr", "held: operator_stop"),
        (RunEventKind.STOP, "", "stop: operator_stop"),
        (RunEventKind.RESET, "fr", "no longer held: engaged"),
        (RunEventKind.GAP, "fr", "no states for 0.25 s"),
    ]
    assert events[1].time_s == pytest.approx(31 * 0.012)


@pytest.mark.long
def test_the_page_has_no_external_address_and_no_script(recorded: Path) -> None:
    html = page(read_run(recorded))
    found = elements(html)
    assert "://" not in html
    assert all(address.startswith("#") for address in found.fetched), found.fetched
    assert not re.search(r"url\((?!#)|@import", html)
    assert not {"script", "link", "iframe", "img", "object", "embed", "base", "form"} & set(found.tags)
    assert found.tags.count("svg") == 3  # timeline, clearance, joints of fr; gr has no states
    assert len(found.ids) == len(set(found.ids))
    assert {address[1:] for address in found.fetched} <= set(found.ids)


@pytest.mark.long
def test_text_of_a_recording_is_escaped_on_the_page(cell: CellModel, tmp_path: Path) -> None:
    file = record(tmp_path / "a<b>&c.mcap", cell, HOSTILE)
    html = page(read_run(file))
    found = elements(html)
    assert "script" not in found.tags
    assert "b" not in found.tags
    assert HOSTILE in found.text
    assert "a<b>&c.mcap" in found.text


@pytest.mark.long
def test_the_same_recording_gives_the_same_page(recorded: Path) -> None:
    assert page(read_run(recorded)) == page(read_run(recorded))


@pytest.mark.nightly
def test_the_size_of_a_page_depends_on_its_width_and_not_on_the_recording(recorded: Path) -> None:
    run = read_run(recorded)
    short = len(timeline(run))
    robot = run.robots["fr"]
    robot.bound_s = np.linspace(0.0, run.length_s, 300_000).tolist()
    run.events += [RunEvent(at, RunEventKind.FAULT, "fr", "krc_silent") for at in robot.bound_s]
    assert len(timeline(run)) < short + 2 * COLUMNS * 200


def test_a_long_curve_keeps_its_extremes() -> None:
    values = np.zeros(100_000)
    values[12_345], values[54_321] = 7.0, -3.0
    at, drawn = outline(np.arange(100_000.0), values)
    assert len(at) <= 1400
    assert (drawn.max(), drawn.min()) == (7.0, -3.0)
    assert at[drawn.argmax()] == 12_345
    assert (np.diff(at) >= 0).all()


@pytest.mark.long
def test_the_verb_writes_the_page_beside_the_recording_and_prints_figures(recorded: Path) -> None:
    def run(*arguments: str) -> str:
        return deltaq("recording", "report", str(recorded), *arguments).stdout

    assert json.loads(run("--json"))["page"] is None
    assert not recorded.with_suffix(".html").exists()
    assert run() == f"{recorded.with_suffix('.html')}\n"
    assert recorded.with_suffix(".html").read_text(encoding="utf-8") == page(read_run(recorded))
