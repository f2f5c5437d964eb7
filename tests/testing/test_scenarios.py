"""Scenario files: what is refused, what is run, and the reports of it."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from typer.testing import CliRunner

from deltaq_deploy.command.app import app
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.scenario.model import ScenarioError, dumped, load_scenario, parse_scenario
from deltaq_testing.scenario.page import junit_xml
from deltaq_testing.scenario.run import Runner

CONTROLLERS = """
import math

STEP = math.radians(20) * 0.012
HOME = math.radians(-118)

class Turn:
    def __init__(self):
        self.began_s = None

    def __call__(self, state):
        self.began_s = state.time_s if self.began_s is None else self.began_s
        return [STEP if state.time_s - self.began_s < 0.5 else 0.0, 0, 0, 0, 0, 0]

def stands(state):
    return [0.0] * len(state.q)

def fails(state):
    raise ValueError("3 is no good")

def nowhere(time_s):
    return [0.0] * 6
"""
SCENARIO = """
controller: turn.py:Turn
duration_s: 1.0
faults:
  - {fault: link_cut, at_s: 0.2, for_s: 0.1}
expect:
  reasons: []
  ends_at: {from_home: [0.1760, 0, 0, 0, 0, 0], within: 0.01}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "turn.py").write_text(CONTROLLERS)
    (tmp_path / "cut.yaml").write_text(SCENARIO)
    return tmp_path


def changed(folder, *changes, name="changed.yaml"):
    text = SCENARIO
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    (folder / name).write_text(text)
    return folder / name


def invoke(*words):
    return CliRunner().invoke(app, ["fault", *map(str, words)])


@pytest.mark.by_day(6)
@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("at_s: 0.2", "at_s: -1", "5: faults.0.at_s: should be greater than or equal to 0, got -1"),
        ("at_s: 0.2", "at_s: soon", "5: faults.0.at_s: should be a valid number, got 'soon'"),
        ("at_s: 0.2", "at_s: 1", "at_s must be less than duration_s, 1, got 1"),
        ("for_s: 0.1", "for_s: 0", "5: faults.0.for_s: should be greater than 0, got 0"),
        ("for_s: 0.1", "fors: 1", "5: faults.0.fors: not a field here; did you mean 'for_s'?"),
        ("link_cut", "link_cutt", "5: faults.0.fault: no fault 'controller-hli-cutt'; did you mean 'contr"),
        ("link_cut", "recorder_dead", "recorder-dead does not exist in virtual time"),
        ("duration_s: 1.0", "duration_s: 1e9", "3: duration_s: should be less than or equal to 3600, got 1000000000.0"),
        ("duration_s: 1.0", "duration_s: .nan", "3: duration_s:"),
        ("controller: turn.py:Turn", "", "give one of controller and command, and not both"),
        ("turn.py:Turn", "turn.py", "2: controller: should match pattern"),
        ("reasons: []", "reasons: [boredom]", "7: expect.reasons.0: should be 'position_limit', "),
        ("within: 0.01", "q: [1], within: 0.01", "give one of q and from_home, and not both"),
        ("expect:", "seed: -1\nexpect:", "seed: should be greater than or equal to 0, got -1"),
        ("expect:", "recover_at_s: 2\nexpect:", "recover_at_s must be less than duration_s, 1, got 2"),
        ("expect:", "  - {fault: link_lossy, at_s: 0.25}\nexpect:", "must start at 0.3 s or later: the link"),
        ("controller: turn.py:Turn", "[", "not YAML"),
    ],
)  # fmt: skip
def test_a_bad_field_is_named_with_line_value_and_bound_before_any_run(folder, before, after, told):
    file = changed(folder, (before, after))
    result = invoke("run", file)
    assert isinstance(result.exception, DeltaqError)
    assert told in str(result.exception)
    assert "changed.yaml:" in str(result.exception)


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("turn.py:Turn", "turn.py:Trun", "turn.py:Trun: turn.py has nothing that is called 'Trun'"),
        ("turn.py:Turn", "gone.py:Turn", "gone.py:Turn: there is no file "),
        ("turn.py:Turn", "gone.at_all:Turn", "cannot be imported: ModuleNotFoundError: No module named 'gone'"),
        ("turn.py:Turn", "turn.py:STEP", "a controller is a function of a state"),
        ("controller:", "cell: nowhere\ncontroller:", "nowhere"),
        ("controller:", "robot: r2\ncontroller:", "no robot 'r2' in cell lab; it has fr, gr"),
        ("controller:", "others: {r2: 'turn.py:stands'}\ncontroller:", "no robot 'r2' in this cell; it has fr, gr"),
        ("[0.1760, 0, 0, 0, 0, 0]", "[0.1]", "expect.ends_at.from_home: must have 6 joints, got 1"),
        ("controller: turn.py:Turn", "command: [/nowhere]", "/nowhere cannot be started: No such file"),
    ],
)  # fmt: skip
def test_a_missing_file_of_a_scenario_is_reported_in_a_line(folder, before, after, told):
    result = invoke("run", changed(folder, (before, after)))
    assert isinstance(result.exception, DeltaqError)
    assert told in str(result.exception)
    assert "\n" not in str(result.exception)


def test_a_missing_scenario_file_is_reported():
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: cannot be read: No such file or directory"):
        load_scenario(Path("nowhere.yaml"))


@pytest.mark.long
def test_a_planted_bug_fails_its_expectation_only_under_the_fault(folder):
    result = invoke("run", folder / "cut.yaml", "--json")
    assert result.exit_code == 1
    (told,) = json.loads(result.stdout)["scenarios"]
    assert [check["what"] for check in told["checks"] if not check["good"]] == ["ends at"]
    well = changed(folder, ("faults:\n  - {fault: link_cut, at_s: 0.2, for_s: 0.1}\n", ""))
    assert invoke("run", well).exit_code == 0


@pytest.mark.long
def test_every_expectation_can_fail(folder):
    tracking = "{reference: turn.py:nowhere, max: 0.1, rms: 0.1, final: 0.1}"
    file = changed(
        folder,
        ("link_cut, at_s: 0.2, for_s: 0.1", "controller_dead, at_s: 0.2, for_s: 0.1"),
        ("reasons: []", "reasons: []\n  phase: engaged\n  rested_within_cycles: 0\n  tracking: " + tracking),
    )  # fmt: skip
    outcome = Runner(folder).run(load_scenario(file), "all")
    assert {check.what for check in outcome.checks if not check.finding} == {
        "rested", "held for", "phase", "ends at", "tracking, max", "tracking, rms", "tracking, final",
    }  # fmt: skip


def test_an_error_of_a_controller_fails_the_scenario_with_its_line(folder):
    outcome = Runner(folder).run(load_scenario(changed(folder, ("turn.py:Turn", "turn.py:fails"))), "fails")
    ended = outcome.checks[0].finding
    assert not ended
    assert re.fullmatch(r"the controller raised ValueError: 3 is no good \(turn.py:\d+\)", ended.told)


@pytest.mark.long
def test_an_operator_recovers_the_robot(folder):
    scenario = load_scenario(
        changed(
            folder,
            ("link_cut, at_s: 0.2, for_s: 0.1", "controller_dead, at_s: 0.2, for_s: 0.1"),
            ("expect:", "recover_at_s: 0.5\nexpect:\n  phase: engaged"),
            ("reasons: []", "reasons: [controller_lost]"),
        )
    )
    assert Runner(folder).run(scenario, "back").good
    alone = scenario.model_copy(update={"recover_at_s": None})
    assert not Runner(folder).run(alone, "left alone").good


def test_a_scenario_survives_a_round_trip(folder):
    scenario = load_scenario(folder / "cut.yaml")
    assert parse_scenario(dumped(scenario), "again") == scenario


@pytest.mark.long
def test_junit_counts_failures_and_no_character_breaks_it(folder):
    junit = folder / "report.xml"
    junit.write_text("of the run before")
    invoke("run", folder / "cut.yaml", changed(folder, ("link_cut", "krc_duplicating")), "--junit", junit)
    one, other = ET.parse(junit).getroot()
    assert (one.get("tests"), one.get("failures")) == ("5", "1")
    assert other.get("failures") == "0"
    (failure,) = one.iter("failure")
    assert failure.get("message").endswith("at most 0.01 were allowed")
    outcome = Runner(folder).run(load_scenario(folder / "cut.yaml"), "a\x00<&\ud800")
    assert ET.fromstring(junit_xml([outcome]).encode())[0].get("name") == "a?<&?"


class _Addresses(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.tags = [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.found += [
            value for name, value in attrs if name in ("src", "href") and not value.startswith("#")
        ]


@pytest.mark.long
def test_the_page_is_self_contained_and_escapes_its_texts(folder):
    name = "<script>.yaml"
    (folder / name).write_text(SCENARIO)
    page = folder / "report.html"
    result = invoke("run", folder / name, "--html", page)
    assert result.exit_code == 1
    text = page.read_text()
    parser = _Addresses()
    parser.feed(text)
    assert parser.found == []
    assert "script" not in parser.tags
    assert "svg" in parser.tags
    assert "&lt;script&gt;.yaml" in text
    assert "a1 is 0.0" in text


@pytest.mark.long
def test_an_unwritable_report_is_reported(folder):
    result = invoke("run", folder / "cut.yaml", "--junit", folder / "gone" / "report.xml")
    assert str(result.exception).endswith("report.xml: cannot be written: No such file or directory")


@pytest.mark.nightly
def test_a_search_finds_the_fault_writes_it_and_the_file_fails_again(folder):
    search = "search: {faults: [krc_duplicating, link_cut], most: 2, longest_s: 0.12}\nexpect:"
    file, found = (
        changed(folder, ("expect:", search), ("duration_s: 1.0", "duration_s: 0.7")),
        folder / "found.yaml",
    )
    result = invoke("search", file, "--examples", 5, "--output", found)
    assert result.exit_code == 1
    (entry,) = load_scenario(found).faults
    assert entry.fault == "controller-hli-cut"
    assert entry.for_s < 0.1
    assert invoke("run", found).exit_code == 1


@pytest.mark.nightly
def test_a_search_without_findings_reports_its_number_of_schedules(folder):
    search = "search: {faults: [krc_duplicating], most: 1}\nexpect:"
    file = changed(folder, ("expect:", search), ("duration_s: 1.0", "duration_s: 0.7"))
    result = invoke("search", file, "--examples", 3)
    assert result.exit_code == 0
    assert result.stdout == "changed.yaml: no schedule failed; 3 were drawn with seed 0\n"
