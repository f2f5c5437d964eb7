"""Whole certificates and the search for a share in one call, against the same one by one; to the bit."""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from gate_bench import CELL, HOME, LIMITS, PROXIMITY, at_rest, in_motion, one_joint
from hypothesis import given
from hypothesis import strategies as st
from small_cell import admission_after
from spans import exact_drives

from deltaq_cell.decisions import Decisions
from deltaq_cell.kernel.course import course_points, lay_course
from deltaq_experiments.bench.decisions import stored
from deltaq_services.sim.compiled_certificate import Blend, CompiledCertifier
from deltaq_services.sim.core import Sim
from deltaq_services.sim.tube import Branch, tube

SIM = Sim(CELL, epoch=0)


@contextmanager
def one_by_one(tells=True):
    """The certifier hands over each tube by itself, as where only coal can judge."""
    with patch.object(Decisions, "asks_a_depth", lambda *_: True):
        yield CompiledCertifier(PROXIMITY, tells=tells)


def cornered():
    """Blends of a request and a robot's brake near obstacles, with tubes of others; each good until the next."""
    for situation in stored()[::3]:
        SIM.restore(situation.memory)
        robot = SIM.robots[situation.request.robot].tracker
        others = [item.tracker for name, item in SIM.robots.items() if name != robot.name]
        tubes = [(other.name, tube) for other in others for tube in other.tubes()]
        limits, brake, request = LIMITS[robot.name], robot.brake(), np.array(situation.request.dq)
        scale, _ = limits.scale(brake, request, robot.ahead.dq, robot.ahead.q_cmd)
        yield Blend(robot, limits, brake, request, scale), tubes


def course_of(blend):
    """A blend's courses as the kernel takes them."""
    before, name = blend.robot.before(), blend.robot.name
    drives = before.drives
    tube = PROXIMITY.whole_tube(
        name, before.points, drives.lag, before.first, before.last, drives.tolerance, drives.spread
    )
    return blend.course(PROXIMITY.decisions, tube)


def told(certificate):
    binding, failing = certificate.binding, certificate.failing
    return (
        certificate.holds,
        binding and (binding.nearest.pair, binding.nearest.swept_m.hex(), binding.stop_distance_m),
        binding and [point.tobytes() for point in binding.nearest.points_m],
        failing and (failing.other, failing.groups.numbers.tolist()),
    )


def test_tubes_in_one_call_are_certified_like_single_tubes():
    held = []
    for blend, tubes in cornered():
        for share in (0.0, 1 / 32, 0.5, 1.0):
            asked = blend.robot.name, blend.tube(share * blend.at_most), tubes
            together = CompiledCertifier(PROXIMITY)
            one = told(together.certify(*asked))
            with one_by_one() as single:
                assert told(single.certify(*asked)) == one
            assert together._left == single._left
            held.append(one[0])
    assert {*held} == {True, False}


def test_the_tightest_pair_is_returned_on_request_only():
    for blend, tubes in cornered():
        asked = blend.robot.name, blend.tube(blend.at_most), tubes
        quiet, asking = (CompiledCertifier(PROXIMITY, tells=tells).certify(*asked) for tells in (False, True))
        assert quiet.binding is None
        assert told(quiet)[::3] == told(asking)[::3]


def test_the_share_of_one_call_agrees_with_single_calls():
    shares = []
    for blend, tubes in cornered():
        name, scale = blend.robot.name, blend.at_most
        first = CompiledCertifier(PROXIMITY).certify(name, blend.tube(scale), tubes)
        if first.holds:
            continue
        together = CompiledCertifier(PROXIMITY, tells=False)
        shares.append(together.largest(blend, tubes, scale, first))
        with one_by_one(tells=False) as single:
            assert single.largest(blend, tubes, scale, first) == shares[-1]
        assert together._left == single._left
    assert len(set(shares)) >= 3


def in_flight(q, dq):
    """A robot in motion with an admission that no state has confirmed."""
    robot = in_motion("fr", q, dq)
    state = robot.state
    robot.admitted(admission_after(state, 1.01 * dq, LIMITS["fr"].brake_cycles(1.01 * dq)))
    robot.decide_after(state.cycle + 1)
    return robot


DQ = 3 * one_joint("fr", 0, LIMITS["fr"].max_dv[0])


@pytest.mark.parametrize(
    "robot",
    [
        at_rest("fr", HOME["fr"]),
        at_rest("fr", HOME["fr"], measured=HOME["fr"] + 1e-3),
        in_motion("fr", HOME["fr"], DQ),
        in_flight(HOME["fr"], DQ),
    ],
    ids=["at rest", "off its setpoint", "in motion", "in flight"],
)
@pytest.mark.parametrize("request_", [np.zeros(6), 2 * DQ, -LIMITS["fr"].max_dq, DQ[::-1] * 4])
def test_the_kernel_computes_the_same_trajectory_bit_for_bit(robot, request_):
    blend = Blend(robot, LIMITS["fr"], robot.brake(), request_, 0.9)
    course = course_of(blend)
    for share in (0.9, 0.0, 0.9 / 32, 0.45, 0.71):
        laid, expected = lay_course(course, share), blend.tube(share)
        np.testing.assert_array_equal(laid.points, expected.points)
        drives = expected.drives
        assert (laid.lag, laid.first, laid.last) == (drives.lag, expected.first, expected.last)
        assert (laid.tolerance is drives.tolerance, laid.spread) == (True, drives.spread)


def test_a_brake_beyond_the_allocated_arrays_is_refused():
    robot = at_rest("fr", HOME["fr"])
    blend = Blend(robot, LIMITS["fr"], robot.brake(), 9 * DQ, 0.2)
    course = course_of(blend)
    lay_course(course, 0.2)
    with pytest.raises(IndexError):
        lay_course(course, 1.0)


STEPS = st.lists(st.floats(-0.02, 0.02), min_size=6, max_size=6).map(np.array)


@given(STEPS, st.integers(1, 40), st.integers(-1, 45), st.integers(0, 3))
def test_setpoints_agree_with_the_branch_bit_for_bit(dq, cycles, step, in_path):
    past = HOME["fr"] + np.arange(3)[:, None] * 1e-3
    path = tuple(past[-1] + k * 1e-3 for k in range(1, in_path + 1))
    branch = Branch(dq, cycles, step, path)
    points, moves = course_points(past, np.array(path).reshape(-1, 6), dq, cycles, step)
    shares = np.cumsum((cycles - np.arange(step + 1, cycles if dq.any() else 0)) / cycles)
    to_come = [*past, *path][-1] + shares[:, None] * dq
    np.testing.assert_array_equal(points, np.vstack((past, *path, to_come)))
    np.testing.assert_array_equal(branch.setpoints(past[-1]), points[len(past) :])
    assert moves
    np.testing.assert_array_equal(tube(past, branch, exact_drives(2, 6)).points, points)


def test_a_trajectory_at_rest_does_not_move():
    past = np.repeat(HOME["fr"][None], 3, axis=0)
    assert not course_points(past, past[:0], np.zeros(6), 5, -1)[1]
    assert course_points(past, past[:1] + 1e-9, np.zeros(6), 5, -1)[1]


NEAR_A_LIMIT = st.sampled_from([-1.0, -1.0 + 1e-10, -0.5, 0.0, 0.3, 1.0 - 1e-10, 1.0, 1.0 + 1e-8, 1.5])


@given(*[st.lists(NEAR_A_LIMIT, min_size=6, max_size=6).map(np.array)] * 3, st.floats(-1.001, 1.001))
def test_a_request_keeps_all_limits_exactly_if_each_limit_admits_it_in_full(brake, request_, last, where):
    limits = LIMITS["fr"]
    brake, last_dq = brake * limits.max_dv, last * limits.max_dv
    request_ = last_dq + request_ * limits.max_dv
    q = (limits.upper + limits.lower) / 2 + where * (limits.upper - limits.lower) / 2
    scale, reasons = limits.dynamic_scale(brake, request_, last_dq)
    scale, tighter = limits.position_scale(brake, request_, q, scale)
    assert limits.keeps(brake, request_, last_dq, q) == (not reasons and not tighter)
    assert limits.scale(brake, request_, last_dq, q) == (scale, tighter or reasons)
