"""`deltaq routine`: what it lists without a running cell, and what it refuses."""

import json

import pytest
from commands import deltaq


def test_the_routines_of_a_cell_are_listed_with_their_equipment_and_parameters(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    told = json.loads(deltaq("routine", "list", "--json").stdout)
    (turn,) = [each for each in told["routines"] if each["routine"] == "turn"]
    assert (turn["equipment"], turn["parameters"]) == (["valve_1", "valve_3"], {"quarter_turns": 1.0})
    assert told["equipment"]["gauge_1"] == {"kind": "gauge", "last": None}


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (("resume",), 2, "no routine has been run in cell lab"),
        (("resume", "--cell", "labb"), 2, "did you mean 'lab'"),
        (("run", "turn", "valve_1", "valve_3"), 2, "one item of equipment, got valve_1, valve_3"),
        (("run", "turn", "valve_1", "quarter_turns=x"), 2, "NAME=NUMBER, got 'quarter_turns=x'"),
        (("run", "turn", "valve_1", "--robot", "g"), 2, "no robot 'g' in cell lab; it has fr, gr"),
        (("run", "turn", "valve_1", "--url", "tcp/127.0.0.1:9"), 3, "127.0.0.1:9"),
    ],
)
def test_a_wrong_word_is_refused_before_anything_moves(monkeypatch, tmp_path, words, status, message):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    done = deltaq("routine", *words)
    assert done.returncode == status
    assert message in " ".join(done.stderr.replace("\u2502", " ").split())
