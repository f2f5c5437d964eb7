import json
import sys
import tomllib
from pathlib import Path

import pytest
from commands import deltaq
from ran import ran

from deltaq_deploy.launch.program import LaunchError, LaunchInterruptedError, exit_status
from deltaq_protocol.errors import ProtocolError, RefusedError, ServiceUnreachableError
from deltaq_testing.private_cell import write_private_cell


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_private_cell(tmp_path_factory.mktemp("cell")))


def test_the_version_is_the_projects() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    done = deltaq("--version")
    assert (done.returncode, done.stdout) == (0, f"deltaq {project['version']}\n")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (ServiceUnreachableError("gone"), 3),
        (RefusedError("cause_stands", "no"), 1),
        (LaunchError("died"), 1),
        (LaunchInterruptedError("stopped by SIGINT"), 130),
        (ProtocolError("garbled"), 2),
    ],
    ids=lambda value: type(value).__name__,
)
def test_each_error_has_its_documented_exit_status(error: ProtocolError, status: int) -> None:
    assert exit_status(error) == status


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ("status",),
        ("stop",),
        ("reset", "--robot", "fr"),
        ("lease", "--robot", "fr"),
        ("status", "--service", "sim"),
        ("topic", "hz"),
        ("drive", "--robot", "fr"),
        ("recording", "record", "--output", "never-written.mcap"),
        ("dry-run", "--robot", "fr", "--dq", "0,0,0,0,0,0"),
        ("contact",),
        ("io", "--robot", "gr"),
        ("advise", "--robot", "gr"),
        ("camera", "follow", "--distance-m", "1"),
        ("camera", "view", "--distance-m", "1"),
        ("camera", "show"),
        ("fault", "inject", "krc-hiccup", "--robot", "fr"),
    ],
    ids=" ".join,
)
def test_a_cell_that_is_not_running_gives_exit_status_3_and_one_clear_line(
    cell: str, arguments: tuple[str, ...]
) -> None:
    done = deltaq(*arguments, "--cell", cell)
    assert done.returncode == 3
    assert done.stdout == ""
    assert done.stderr.startswith("deltaq: ")
    assert "is the cell up" in done.stderr
    assert ".rs:" not in done.stderr, "where in zenoh's source it happened"
    assert done.stderr.count("\n") == 1
    assert ".rs:" not in done.stderr  # zenoh adds where in its own source it happened


@pytest.mark.by_day(6)
@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("status", "--cell", "labb"), "did you mean 'lab'?"),
        (("status", "--service", "simm"), "no service 'simm' in this cell; it has robot-server-fr"),
        (("up", "--only", "hlii"), "no service 'hlii'"),
        (("reset", "--robot", "rf"), "no robot 'rf' in cell lab; it has fr, gr"),
        (("lease", "--robot", "fr", "--take", "--release"), "choose one of --take and --release"),
        (("topic", "echo", "stat"), "did you mean 'state'?"),
        (("topic", "echo", "admission"), "is in the guarded realm"),
        (("topic", "echo", "lease"), "is a query; those that can be watched are state"),
        (("schema", "stat"), "did you mean 'state'?"),
        (("experiment", "tracing"), "'tracing' is not"),
        (("experiment", "tracking", "--duration-s", "many"), "--duration-s"),
        (("topic", "hz", "--duration-s", "0"), "0.1"),
        (("dry-run", "--robot", "fr", "--dq", "1,x"), "finite numbers"),
        (("io", "--robot", "gr", "gripper=open"), "OUTPUT=on or OUTPUT=off, got 'gripper=open'"),
        (
            ("camera", "view", "--distance-m", "9"),
            "'--distance-m': Input should be less than or equal to 4, got '9'",
        ),
        (("bench", "filters", "--cycles", "5"), "should be greater than or equal to 10, got '5'"),
        (
            ("camera", "view", "--robot", "rf", "--distance-m", "1"),
            "no robot 'rf' in cell lab; it has fr, gr",
        ),
        (("camera", "view", "--target", "gr:1,2"), "--target"),
        (
            ("camera", "view", "--target", "gr", "--target", "-1,2,x"),
            "'-1,2,x' is not a target like gr, gr:0,0,0.04 or",
        ),
        (("camera", "view", "--target", "0,0,1e9"), "focus_m.2: Input should be less than or equal to 100"),
        (("camera", "view", "--target", ""), "leader: String should have at least 1 character"),
        (("io", "--robot", "gr", "=on"), "OUTPUT=on or OUTPUT=off, got '=on'"),
        (("dry-run", "--robot", "fr", "--dq", "nan,0,0,0,0,0"), "finite numbers"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_usage_gives_exit_status_2_and_the_allowed_values(
    arguments: tuple[str, ...], told: str
) -> None:
    done = deltaq(*arguments)
    assert done.returncode == 2
    said = " ".join(done.stderr.replace("│", " ").split())
    assert told in said
    assert said.count(", got ") <= 1
    assert "Traceback" not in done.stderr


def test_a_cell_open_to_other_machines_is_not_started(tmp_path: Path) -> None:
    file = tmp_path / "exposed.yaml"
    file.write_text("extends: lab\ntcp_address: 0.0.0.0\n", encoding="utf-8")
    done = deltaq("up", "--only", "hli", "--cell", str(file))
    assert done.returncode == 2
    assert "lets other machines move its robots" in done.stderr
    assert "anyone_who_connects_may_move_the_robots" in done.stderr


@pytest.mark.long
def test_a_good_cell_passes_its_check() -> None:
    done = deltaq("check", "--cell", "lab", "--json")
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout)["ok"] is True


@pytest.mark.long
def test_a_bad_cell_fails_its_check_with_file_line_and_field(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("extends: lab\ngate:\n  stop_distance_m: -0.1\n", encoding="utf-8")
    done = deltaq("check", "--cell", str(file))
    assert done.returncode == 1
    assert "bad.yaml:3: gate.stop_distance_m:" in done.stdout
    problem = json.loads(deltaq("check", "--cell", str(file), "--json").stdout)["problems"][0]
    assert (problem["line"], problem["field"], problem["value"]) == (3, "gate.stop_distance_m", -0.1)


@pytest.mark.long
def test_the_schema_describes_every_topic_and_the_lines_of_tcp() -> None:
    schema = json.loads(deltaq("schema").stdout)
    assert schema["increment"]["message"]["properties"]["dq"]["type"] == "array"
    assert schema["stop"]["reply"]["title"] == "Done"
    assert schema["json-lines"]["only over TCP"][0]["title"] == "Hello"
    assert list(json.loads(deltaq("schema", "state").stdout)) == ["state"]


def test_the_doctor_reports_its_findings_about_this_machine(cell: str) -> None:
    done = deltaq("doctor", "--cell", cell, "--json")
    report = json.loads(done.stdout)
    assert done.returncode == 0, report
    assert report["fit"] is True
    found = {finding["what"]: finding["verdict"] for finding in report["findings"]}
    assert found["Python"] == "good"
    assert found["ports of hli"] == "good"


@pytest.mark.long
def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from deltaq_deploy.command.app import app;"
        "heavy = {'pinocchio', 'coal', 'matplotlib', 'deltaq_experiments', 'yaml'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = ran([sys.executable, "-c", code])
    assert done.stdout.strip() == "[]"
