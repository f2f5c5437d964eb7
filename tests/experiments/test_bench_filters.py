"""`deltaq bench filters`: what it measures, and what it says of filters that are none."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from ran import ran

from deltaq import GateError
from deltaq_experiments.bench.filter_scenes import Distances, drawn_scene
from deltaq_experiments.bench.filters import DrivenArm, FilterRow, Follower, compare, named
from studies.filters_compared import OTHERS, slowed

OWN = """
def half(q, dq):
    return 0.5 * dq

def short(q, dq):
    return dq[:3]

def nan(q, dq):
    return dq * float("nan")

def raises(q, dq):
    raise ZeroDivisionError("of its own")

class Whole:
    def __init__(self, scene):
        self.n = len(scene.lower)
        assert scene.obstacles and scene.cycle_s == 0.004

    def start(self, q):
        assert q.shape == (self.n,)

    def __call__(self, q, dq):
        q[:] = 0
        return list(dq)

number = 7
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def compared(names: list[str], cycles: int = 12, ideal: bool = False) -> dict[str, FilterRow]:
    rows = {name: FilterRow() for name in names}
    filters = {name: OTHERS.get(name) or named(name) for name in names}
    list(compare(filters, drawn_scene(0), rows, cycles, 0, ideal))
    return rows


@pytest.mark.long
def test_an_arm_without_a_filter_touches_bodies_and_the_gate_keeps_it_clear():
    rows = compared(["none", "threshold", "gate"], cycles=500)
    assert rows["none"].contacts >= 2
    assert rows["none"].depth_m > 0.01
    assert rows["threshold"].contacts >= 1
    assert rows["gate"].contacts == 0
    assert rows["none"].kept == pytest.approx(rows["none"].asked)
    assert rows["gate"].kept > 0.9 * rows["gate"].asked
    assert rows["none"].false_holds == 0
    assert rows["gate"].false_holds < 0.02 * rows["gate"].cycles


def test_a_filter_of_ones_own_is_slower_by_what_it_withholds(own):
    rows = compared(["none", "own.py:half", "own.py:Whole"])
    assert rows["own.py:half"].false_holds == rows["own.py:half"].cycles > 100
    assert rows["own.py:half"].kept < 0.6 * rows["own.py:half"].asked
    assert rows["own.py:Whole"].kept == rows["none"].kept


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("short", r"own.py:short: must have shape \(6,\), got shape \(3,\); return one increment for each joint"),
        ("nan", r"own.py:nan: must be finite, got \[nan"),
        ("raises", r"own.py:raises: must not raise, got ZeroDivisionError: of its own \(own.py:12\); correct it"),
        ("number", r"filter: must be none, gate, FILE.py:NAME .*, got own.py:number; name a function \(q, dq\)"),
        ("absent", r"filter: must be none, .* got own.py:absent: own.py has nothing .* 'absent'; name a function"),
    ],
)  # fmt: skip
def test_what_is_no_filter_is_refused(own, name, text):
    with pytest.raises(GateError, match=text):
        compared([f"own.py:{name}"])


@pytest.mark.parametrize("name", ["gone.py:filter", "no.such.module:filter", "gate2", ":x", "own.py:"])
def test_a_name_that_leads_nowhere_is_refused(own, name):
    with pytest.raises(GateError, match=r"filter: must be none, gate, FILE.py:NAME"):
        named(name)


def test_distances_change_with_the_joints_as_their_gradients_say():
    scene = drawn_scene(0)
    distances, rng = Distances(scene), np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(scene.lower, scene.upper)
        near = np.flatnonzero(np.abs(distances.measure(q)) < 0.5)
        gradients = distances.gradients(q, near)
        moved = 1e-6 * np.eye(len(q))
        change = np.array([distances.measure(q + e)[near] - distances.measure(q - e)[near] for e in moved]).T
        smooth = np.abs(gradients - change / 2e-6).max(axis=1) < 1e-3
        assert smooth.mean() > 0.8  # the nearest points of a cylinder's rim and of edges jump


def test_clear_is_what_all_measured_distances_say():
    scene = drawn_scene(0)
    distances, rng = Distances(scene), np.random.default_rng(2)
    found = []
    for q in rng.uniform(scene.lower, scene.upper, (60, len(scene.lower))):
        room_m = (distances.measure(q) - distances.least_m).min()
        for more_m in (0.0, 0.05, max(room_m - 1e-5, 0.0), max(room_m + 1e-5, 0.0)):
            found.append(distances.clear(q, more_m))
            assert found[-1] == (room_m > more_m)
    assert 20 < sum(found) < 220


def test_drives_stop_no_faster_than_their_limits_unless_they_are_ideal():
    scene = drawn_scene(0)
    change = scene.max_acceleration * scene.cycle_s**2
    for ideal in (False, True):
        arm = DrivenArm(scene, scene.q, ideal)
        arm.dq = 0.9 * scene.max_velocity * scene.cycle_s
        stop = arm.stop(arm.dq)[-1] - arm.q
        dq = arm.dq
        arm.move(np.zeros(6))
        np.testing.assert_allclose(arm.dq, 0.0 * dq if ideal else dq - change, atol=1e-12)
        travelled = dq.copy()
        while not ideal and arm.dq.any():
            travelled += arm.dq
            arm.move(np.zeros(6))
        assert ideal or (np.abs(travelled) <= np.abs(stop) + change).all()


def test_a_path_is_done_in_its_own_time_without_a_filter():
    scene = drawn_scene(0)
    for path in scene.paths:
        arm, follower = DrivenArm(scene, path[0], False), Follower(path)
        for _ in path[1:]:
            before = arm.q
            arm.move(arm.possible(follower.wish(arm.q)))
            follower.moved(arm.q - before)
        assert follower.at == pytest.approx(len(path) - 1)
        np.testing.assert_allclose(arm.q, path[-1], atol=1e-9)


@pytest.mark.service
def test_the_command_compares_a_file_of_ones_own(own):
    command = [Path(sys.executable).with_name("deltaq"), "bench", "filters", "none", "own.py:half"]
    command += ["--scenes", "1", "--cycles", "10", "--json"]
    done = ran(command, cwd=own, env=os.environ)
    told = json.loads(done.stdout)
    assert (told["robot"], list(told["filters"])) == ("kr16", ["none", "own.py:half"])
    assert told["filters"]["none"]["speed_kept_percent"] == 100.0
    refused = ran([*command[:3], "own.py:nan"], cwd=own, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.splitlines()[-1].startswith("deltaq: own.py:nan: must be finite")
    assert "Traceback" not in refused.stderr


def test_servos_scale_is_one_at_its_threshold_and_a_thousandth_before_contact():
    assert [slowed(np.array([d]), 0.02) for d in (0.05, 0.02, 0.0, -0.01)] == [1.0, 1.0, 0.0, 0.0]
    assert slowed(np.array([1e-9]), 0.02) == pytest.approx(0.001, rel=1e-5)
