"""Speed and separation: within the band the approach speed falls with the room that is left."""

import numpy as np
import pytest
from gate_bench import (
    FR_BESIDE_GR,
    GR_BESIDE_FR,
    LIMITS,
    PROXIMITY,
    above_the_floor,
    at_rest,
    in_motion,
    one_joint,
    with_room,
)
from gate_rig import CELL, Rig

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.load import CellError, load_cell
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.gate import Contacts, Gate, SlowDown
from deltaq_services.sim.retreat import Violations

BAND_M, SPEED_M_S, STOP_M = 0.4, 0.2, 0.05
BAND = CELL.description.gate.model_copy(
    update={"slow_down_distance_m": BAND_M, "slow_down_speed_m_s": SPEED_M_S}
)
CYCLE_S = CELL.description.cycle_s
DOWN = one_joint("fr", 1, 0.5 * LIMITS["fr"].max_dq[1])
FLOOR = "fr/link_3 structure/floor"


def with_band(folder, distance_m):
    path = folder / "slow.yaml"
    path.write_text(
        f"extends: lab\ngate: {{slow_down_distance_m: {distance_m}, slow_down_speed_m_s: {SPEED_M_S}}}\n",
        encoding="utf-8",
    )
    return path


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_within_the_band_approach_is_slowed_in_proportion_and_departure_is_not(tmp_path, robot):
    rig = Rig(CellModel.load(with_band(tmp_path, BAND_M)))
    model, cycle_s = CELL.robots[robot], CELL.description.cycle_s
    proximity, random = CompiledProximity(CELL), np.random.default_rng(4)
    aim, slowed = np.zeros(model.n), 0
    for cycle in range(150):
        if cycle % 30 == 0:
            aim = random.uniform(-1, 1, model.n) * 0.3 * model.max_velocity * cycle_s
        before = np.array(rig.servers[robot].state.q_cmd)
        verdict = rig.request(tuple(aim), robot=robot, cycle=rig.servers[robot].state.cycle)
        for name, other in CELL.robots.items():
            proximity.place(name, before if name == robot else other.home, np.zeros(other.n))
        rig.cycle()
        if verdict.reasons and verdict.reasons[0].code is ReasonCode.SLOW_DOWN:
            slowed += 1
            reason = verdict.reasons[0]
            assert reason.value > reason.bound
            near = [
                *proximity.approaches(robot, proximity.alone[robot], BAND_M),
                *proximity.approaches(
                    robot, proximity.between[robot, "gr" if robot == "fr" else "fr"], BAND_M
                ),
            ]
            pair = next(item for item in near if " ".join(item.pair) == reason.what)
            share = 1.0 if "structure" in reason.what or reason.what.count(robot + "/") == 2 else 0.5
            room = (pair.distance_m - pair.stop_distance_m) / (BAND_M - pair.stop_distance_m)
            assert reason.bound == pytest.approx(share * SPEED_M_S * room)
            if verdict.scale > 0.0:
                speed = pair.per_joint @ np.array(verdict.dq) / cycle_s
                assert speed == pytest.approx(reason.bound)
    assert slowed > 5


def test_the_shipped_cells_have_no_band():
    for name in ("lab", "lab-4ms", "dawm"):
        assert load_cell(name).gate.slow_down_distance_m is None


def test_a_band_inside_the_stop_distance_is_refused_with_value_and_bound(tmp_path):
    with pytest.raises(CellError, match=r"slow_down_distance_m is 0\.04.*0\.05"):
        load_cell(with_band(tmp_path, 0.04))


def test_the_rate_of_approach_agrees_with_a_small_motion():
    cell = CELL
    proximity, random = CompiledProximity(cell), np.random.default_rng(2)
    checked = 0
    for name, robot in cell.robots.items():
        q = robot.home + random.uniform(-0.05, 0.05, robot.n)
        still = np.zeros(robot.n)
        for other, its in cell.robots.items():
            proximity.place(other, its.home, np.zeros(its.n))
        proximity.place(name, q, still)
        groups = proximity.alone[name]
        before = {near.pair: near for near in proximity.approaches(name, groups, 0.6)}
        step = random.uniform(-1, 1, robot.n) * 1e-5
        proximity.place(name, q + step, still)
        after = {near.pair: near for near in proximity.approaches(name, groups, 0.6)}
        for pair in before.keys() & after.keys():
            lost = before[pair].distance_m - after[pair].distance_m
            mean = (before[pair].per_joint + after[pair].per_joint) @ step / 2
            checked += abs(lost - mean) < 2e-6
    assert checked > 20


def scale(robot, request, others=(), at_most=1.0):
    return SlowDown(PROXIMITY, BAND, CYCLE_S).scale(robot, list(others), robot.brake(), request, at_most)


def floor_loss(dq):
    """How far an increment brings FR's third link nearer to the floor, where FR has just been judged [m]."""
    near = PROXIMITY.approaches("fr", PROXIMITY.alone["fr"], BAND_M)
    return next(item for item in near if " ".join(item.pair) == FLOOR).per_joint @ dq


def test_the_reason_has_the_otherwise_possible_and_the_allowed_speed():
    robot = in_motion("fr", above_the_floor(0.1), 0.08 * DOWN)
    brake, allowed = robot.brake(), SPEED_M_S * 0.1 / (BAND_M - STOP_M)
    assert brake.any()
    for at_most in (1.0, 0.8):
        found, (reason,) = scale(robot, DOWN, at_most=at_most)
        assert (reason.code, reason.what) == (ReasonCode.SLOW_DOWN, FLOOR)
        assert reason.bound == pytest.approx(allowed, rel=1e-3)
        assert reason.value == pytest.approx(floor_loss(brake + at_most * (DOWN - brake)) / CYCLE_S)
        assert floor_loss(brake + found * (DOWN - brake)) / CYCLE_S == pytest.approx(allowed, rel=1e-3)


def test_a_motion_slowed_by_other_limits_is_left_unchanged():
    robot = at_rest("fr", above_the_floor(0.05))
    found, _ = scale(robot, DOWN)
    assert 0.0 < found < 1.0
    assert scale(robot, DOWN, at_most=0.9 * found) == (0.9 * found, [])


def test_motion_not_faster_than_the_brake_is_not_slowed():
    robot = in_motion("fr", above_the_floor(0.01), DOWN)
    brake = robot.brake()
    assert scale(robot, DOWN)[0] == 0.0
    assert floor_loss(brake) > SPEED_M_S * 0.01 / (BAND_M - STOP_M) * CYCLE_S
    assert scale(robot, brake) == (1.0, [])
    assert scale(robot, 0.5 * brake) == (1.0, [])


def test_within_the_stop_distance_approach_is_held_with_one_reason():
    robot = at_rest("fr", above_the_floor(-2e-3))
    found, (reason,) = scale(robot, DOWN)
    assert (found, reason.what, reason.bound) == (0.0, FLOOR, 0.0)
    assert scale(robot, DOWN, at_most=0.0) == (0.0, [])
    assert scale(robot, -DOWN) == (1.0, [])


def test_the_tightest_of_several_bodies_limits_in_any_order():
    here = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
    gr, fr = at_rest("gr", with_room(0.01, "gr", here, 4)), at_rest("fr", FR_BESIDE_GR)
    request = one_joint("gr", 4, 0.5 * LIMITS["gr"].max_dq[4])
    alone, _ = scale(gr, request)
    beside, (reason,) = scale(gr, request, [fr])
    assert beside < alone
    assert set(reason.what.split()) == {"gr/link_3", "fr/link_1"}
    assert reason.bound == pytest.approx(0.5 * SPEED_M_S * 0.01 / (BAND_M - STOP_M), rel=1e-2)


def test_the_gate_reports_the_tighter_of_band_and_limits():
    gate = Gate(PROXIMITY, LIMITS, BAND, Contacts(PROXIMITY, {}), Violations())
    other, request = at_rest("gr", CELL.robots["gr"].home), one_joint("fr", 1, 2 * LIMITS["fr"].max_dv[1])
    for room_m, code in ((0.005, ReasonCode.SLOW_DOWN), (0.1, ReasonCode.ACCELERATION_LIMIT)):
        decision = gate.decide(at_rest("fr", above_the_floor(room_m)), [other], request)
        assert [reason.code for reason in decision.reasons] == [code]
        assert 0.0 < decision.scale <= 0.5 * (1 + 1e-9)
