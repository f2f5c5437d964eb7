"""Robots that are not deltaq's in virtual time: three keep clear of each other, and what they did replays."""

import shutil
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from own_robot import write_cell, write_package
from rewritten import rewrite

from deltaq_cell.cell_model import CellModel
from deltaq_cell.models import RobotModelError
from deltaq_experiments.tracking import panels_of
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.recorder.reader import Recording
from deltaq_testing.oracle import ClearanceOracle
from deltaq_testing.recorded import virtual_cell
from deltaq_testing.replay import replay
from deltaq_testing.virtual_cell.cell import VirtualCell

CYCLES = 120
BETWEEN = np.linspace(0.0, 1.0, 5)[1:]
"""Where between two setpoints the oracle measures, which the gate does not know of."""


@pytest.fixture(scope="module")
def circle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("circle")
    write_package(folder)
    return write_cell(folder, robots=3, model="toy_arm/arm.urdf")


class Attackers:
    """Send every robot, fast, towards the middle of the circle, where all three reach, and now and then away."""

    def __init__(self, stack: VirtualCell, seed: int) -> None:
        self._stack, self._random = stack, np.random.default_rng(seed)
        self._aims: dict[str, np.ndarray] = {}

    def increments(self, cycle: int) -> dict[str, np.ndarray]:
        """(n,) by robot [rad or m]."""
        for name, robot in self._stack.cell.robots.items():
            if cycle % 40 == 0:
                middle = self._random.normal([0.0, 1.4, 0.3], [0.15, 0.2, 0.08])
                away = self._random.uniform(robot.lower, robot.upper)
                self._aims[name] = middle if cycle == 0 or self._random.random() < 0.7 else away
        arms, cycle_s = self._stack.arms, self._stack.cell.description.cycle_s
        most = {name: robot.max_velocity * cycle_s for name, robot in self._stack.cell.robots.items()}
        return {
            name: np.clip(0.2 * (aim - arms[name].q), -most[name], most[name])
            for name, aim in self._aims.items()
        }


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_each_of_three_robots_keeps_clear_of_both_others(circle: Path, seed: int) -> None:
    leaning_in = np.array([0.0, 0.5, 0.2])
    stack = VirtualCell(circle, {f"arm_{number}": leaning_in for number in range(3)})
    attackers = Attackers(stack, seed)
    stop_m = stack.cell.description.gate.stop_distance_m
    oracles = {
        pair: ClearanceOracle(replace(stack.cell, robots={name: stack.cell.robots[name] for name in pair}))
        for pair in combinations(stack.arms, 2)
    }
    nearest = dict.fromkeys(oracles, np.inf)
    bound = set()
    stack.run_until_ready()
    for name in stack.arms:
        stack.acquire(name, "test")
    for cycle in range(CYCLES):
        before = {name: arm.q for name, arm in stack.arms.items()}
        stack.cycle()
        for name, dq in attackers.increments(cycle).items():
            verdict = stack.ask(name, dq)
            assert verdict is not None
            if verdict.pair and any(reason.code is ReasonCode.CLEARANCE for reason in verdict.reasons):
                bound.add(frozenset(body.split("/")[0] for body in verdict.pair))
        for share in BETWEEN:
            q = {name: before[name] + share * (arm.q - before[name]) for name, arm in stack.arms.items()}
            for pair, oracle in oracles.items():
                nearest[pair] = min(nearest[pair], oracle.between_robots({n: q[n] for n in pair}).distance_m)
    assert all(distance >= stop_m for distance in nearest.values()), nearest
    assert any(pair <= set(stack.arms) and len(pair) == 2 for pair in bound), bound  # they did try


@pytest.mark.long
def test_the_nearest_pair_of_any_two_robots_is_found(circle: Path) -> None:
    towards = np.array([0.0, 1.3, 0.2])
    for apart in ("arm_0", "arm_1", "arm_2"):
        cell = CellModel.load(circle)
        start = {name: towards for name in cell.robots if name != apart}
        start[apart] = np.array([np.pi / 2, -1.2, 0.0])
        stack = VirtualCell(circle, start)
        stack.run_until_ready()
        near = stack.sim.nearest()
        assert near is not None
        assert {name.split("/")[0] for name in near.pair} == set(cell.robots) - {apart}


def test_a_stop_and_a_reset_reach_all_three(circle: Path) -> None:
    stack = VirtualCell(circle)
    stack.run_until_ready()
    stack.stop()
    stack.cycle()
    stack.cycle()
    assert {state.phase for state in stack.states.values()} == {Phase.HELD}
    for name in stack.arms:
        stack.reset(name)
    stack.run_until_ready()


def drive(file: Path, cell: Path) -> None:
    with virtual_cell(cell, record=file) as stack:
        stack.run_until_ready()
        attackers = Attackers(stack, 7)
        for name in stack.arms:
            stack.acquire(name, "test")
        for cycle in range(60):
            stack.cycle()
            for name, dq in attackers.increments(cycle).items():
                stack.ask(name, dq)


@pytest.mark.long
def test_a_recording_replays_bit_for_bit_without_the_files_of_the_robots(tmp_path: Path) -> None:
    package = write_package(tmp_path)
    drive(tmp_path / "run.mcap", write_cell(tmp_path, robots=2, model="toy_arm/arm.urdf"))
    shutil.rmtree(package)
    result = replay(tmp_path / "run.mcap")
    assert result.good
    assert result.verdicts > 100
    assert result.fingerprint == result.recorded_fingerprint
    assert result.notices == []
    panels = panels_of(Recording.open(tmp_path / "run.mcap"))
    assert [panel.caption for panel in panels] == [f"Tool of arm_{k}, from where it began" for k in (0, 1)]
    assert max(np.ptp(line.values) for line in panels[0].lines) > 0.05


def test_a_recording_without_hulls_is_refused_with_the_missing_mesh(tmp_path: Path) -> None:
    package = write_package(tmp_path)
    drive(tmp_path / "run.mcap", write_cell(tmp_path, robots=1, model="toy_arm/arm.urdf"))
    old = rewrite(tmp_path / "run.mcap", tmp_path / "old.mcap", without=("hulls.json",))
    assert Recording.open(old).hulls == {}
    shutil.rmtree(package)
    with pytest.raises(
        RobotModelError, match=r"no file 'package://toy_arm/meshes/barrel\.obj'.*set ROS_PACKAGE_PATH"
    ):
        replay(old)


@pytest.mark.long
def test_a_recording_of_shipped_robots_without_hulls_replays_bit_for_bit(tmp_path: Path) -> None:
    with virtual_cell("lab", record=tmp_path / "run.mcap") as stack:
        stack.run_until_ready()
        stack.acquire("fr", "test")
        for _ in range(20):
            stack.cycle()
            stack.ask("fr", np.full(6, 0.002))
    old = rewrite(tmp_path / "run.mcap", tmp_path / "old.mcap", without=("hulls.json",))
    result = replay(old)
    assert result.good
    assert result.fingerprint == result.recorded_fingerprint
