"""The configuration advisor: what it proposes holds the hands, is clear and distinct, and can be driven to."""

from functools import cache
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import NOT_LOOKED_FOR, Option, Progress, advise
from deltaq_controllers.advisor.exact import (
    FINE,
    LEAP,
    LIMIT_SHARE,
    ExactClearance,
    HandsKept,
    HandsMoved,
    MotionValidator,
)
from deltaq_controllers.advisor.path_planner import NoPathError, PathPlanner, Tree
from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_controllers.advisor.search import (
    DISTINCT,
    METHODS,
    Pool,
    descend,
    feasible,
    reduced_gradient,
    search,
)
from deltaq_controllers.criteria.table import CriterionError
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array
from studies.advised_starts import CELLS, starts

CELL = CellModel.load("dawm")
DAWM = CELL.robots["dawm"]
TRACKER = ConstraintTracker(DAWM)
EXACT = ExactClearance(CELL, "dawm")


def problem(q: Array = DAWM.home, **weights: float) -> AdvisorProblem:
    return AdvisorProblem(CELL, "dawm", TRACKER.hands(q), weights or None, TRACKER)


def out_of_reach() -> AdvisorProblem:
    poses = TRACKER.hands(DAWM.home)
    poses[:, 0, 3] += 5.0
    return AdvisorProblem(CELL, "dawm", poses, None, TRACKER)


@pytest.fixture(scope="module")
def options() -> list[Option]:
    return advise(problem(), DAWM.home, generator=np.random.default_rng(4), options=4, exact=EXACT)


def test_the_gradient_over_the_free_joints_agrees_with_finite_differences() -> None:
    task = problem(travel=1.0, manipulability=0.5)
    starts = feasible(task, np.random.default_rng(2), 32, 64, 50)
    q, energy = task.try_best(starts)
    q = q[np.isfinite(energy)][:8]
    gradient = reduced_gradient(task, q)
    for joint in range(5):
        offset = 1e-6 * np.eye(5)[joint]
        ahead, behind = (task.follow(q[:, TRACKER.base] + sign * offset, q)[1] for sign in (1, -1))
        np.testing.assert_allclose(gradient[:, joint], (ahead - behind) / 2e-6, atol=2e-4)


def test_starts_reach_with_both_hands_far_more_often_than_uniform_draws() -> None:
    task = problem(np.random.default_rng(3).uniform(DAWM.lower, DAWM.upper))
    generator = np.random.default_rng(4)
    even = generator.uniform(task.lower, task.upper, (8192, 5))
    both = np.logical_and.reduce(
        [
            branches.fitted(np.zeros(6), DAWM.lower[arm.joints], DAWM.upper[arm.joints])[1].any(axis=1)
            for arm, branches in zip(TRACKER.arms, TRACKER.solve(even, task.poses), strict=True)
        ]
    )
    starts = feasible(task, generator, 128, 64, 1000)
    assert len(starts) > 3 * both.sum()
    reached = [branches.exists.any(axis=1) for branches in TRACKER.solve(starts, task.poses)]
    assert all(hand.all() for hand in reached)


def test_a_trial_beyond_a_limit_out_of_reach_or_in_collision_is_rejected() -> None:
    task = problem()
    base = np.tile(DAWM.home[TRACKER.base], (2, 1))
    base[1, 0] = DAWM.upper[0] + 0.01
    _, energy = task.try_best(base)
    assert np.isfinite(energy).tolist() == [True, False]
    assert not len(out_of_reach().try_all(base).q)
    into_floor = DAWM.home.copy()
    into_floor[[4, 12]] = DAWM.lower[[4, 12]]
    into_floor[[2, 10]] = DAWM.lower[[2, 10]]
    assert EXACT.measure(into_floor).room_m < 0
    assert np.isinf(task.energies(into_floor[None])[0])


def test_descent_never_climbs_and_ends_where_the_gradient_is_small() -> None:
    task = problem(travel=1.0)
    generator = np.random.default_rng(5)
    q, energy = task.try_best(feasible(task, generator, 32, 64, 40))
    q, energy = q[np.isfinite(energy)][:10], energy[np.isfinite(energy)][:10]
    lower_q, lower = descend(task, q, energy, generator, 25)
    assert np.all(lower <= energy)
    assert lower.min() < energy.min() - 1e-3
    assert np.linalg.norm(reduced_gradient(task, lower_q[lower.argmin()][None])) < 1e-2


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_configurations_that_hold_the_hands(method: str) -> None:
    task = problem()
    pool = search(task, np.random.default_rng(6), method, effort=0.3)
    assert len(pool.q) >= 3
    assert np.all(np.diff(pool.energy) >= 0)
    for q, energy in zip(pool.q[:20], pool.energy[:20], strict=True):
        assert np.abs(TRACKER.hands(q) - task.poses).max() < 1e-9
        assert np.all((q >= DAWM.lower) & (q <= DAWM.upper))
        assert task.energies(q[None])[0] == pytest.approx(energy)
    assert pool.best < task.energies(DAWM.home[None])[0] - 0.015


@pytest.mark.nightly
def test_one_seed_is_one_search() -> None:
    first, second = (search(problem(), np.random.default_rng(7), effort=0.3) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)


@pytest.mark.long
def test_options_are_ranked_distinct_clear_and_listed_with_their_limits(options: list[Option]) -> None:
    assert len(options) == 4
    energies = [option.energy for option in options]
    assert energies == sorted(energies)
    here = problem().energies(DAWM.home[None])[0]
    assert options[0].energy < here
    for number, option in enumerate(options):
        for better in options[:number]:
            assert np.abs(option.q - better.q).max() > DISTINCT
        assert option.clearance == EXACT.measure(option.q)
        assert option.clearance.room_m > 0
        assert option.energy == pytest.approx(sum(option.costs[name] for name in problem().weights))
        assert option.energy_here == pytest.approx(here)
        joint = DAWM.joint_names.index(option.nearest_limit)
        extent = DAWM.upper[joint] - DAWM.lower[joint]
        room = min(option.q[joint] - DAWM.lower[joint], DAWM.upper[joint] - option.q[joint])
        assert option.limit_share == pytest.approx(room / extent)
        assert not option.hands_move


def test_every_option_has_a_path_that_keeps_the_hands_still_and_everything_clear(
    options: list[Option],
) -> None:
    poses = TRACKER.hands(DAWM.home)
    for option in options:
        assert option.path is not None, option.no_path
        np.testing.assert_array_equal(option.path[0], DAWM.home)
        np.testing.assert_allclose(option.path[-1], option.q, atol=1e-6)
        steps = np.abs(np.diff(option.path, axis=0))
        assert steps[:, TRACKER.base].max() <= FINE + 1e-9
        assert steps.max() <= LEAP * FINE + 1e-9
        for q in option.path:
            assert np.abs(TRACKER.hands(q) - poses).max() < 1e-9
            assert np.all((q >= DAWM.lower - 1e-12) & (q <= DAWM.upper + 1e-12))
            assert EXACT.measure(q).room_m > 0


STARTS = {robot: starts(CellModel.load(CELLS[robot]), robot, 3, seed=4711) for robot in ("gr", "dawm")}
"""Configurations at random, some of which are near limits, bodies and singularities."""


@pytest.mark.nightly
@pytest.mark.parametrize("robot", ["dawm", "gr"])
def test_from_almost_every_start_some_option_is_better_and_can_be_driven_to(robot: str) -> None:
    better = 0
    for found in answers(robot):
        assert len(found) == 5
        assert all(option.path is not None for option in found)
        assert min(np.abs(a.q - b.q).max() for a, b in combinations(found, 2)) > DISTINCT
        better += found[0].energy < 0.99 * found[0].energy_here
    assert better >= len(STARTS[robot]) - 1


@pytest.mark.long
def test_a_search_without_improvement_continues_with_a_bound_that_never_rises() -> None:
    (boxed_in,) = starts(CELL, "dawm", 1, seed=901)
    done: list[float] = []

    def go_on(progress: Progress) -> bool:
        done.extend([progress.done] * (progress.doing == "searching"))
        return True

    task = problem(boxed_in)
    found = advise(task, boxed_in, generator=np.random.default_rng(0), exact=EXACT, go_on=go_on)
    assert found[0].energy < 0.99 * found[0].energy_here
    assert all(later > earlier for earlier, later in pairwise(done))
    assert 0.5 < done[-1] < 1.0, "more than one turn"


@cache
def answers(robot: str) -> list[list[Option]]:
    return [advised_from(robot, q) for q in STARTS[robot]]


def advised_from(robot: str, q: Array, **asked: Any) -> list[Option]:
    cell = CellModel.load(CELLS[robot])
    tracker = ConstraintTracker(cell.robots[robot])
    may_leave = asked.pop("hands_may_leave", False)
    task = AdvisorProblem(cell, robot, tracker.hands(q), None, tracker, None, may_leave)
    return advise(task, q, generator=np.random.default_rng(17), **asked)


@pytest.mark.nightly
@pytest.mark.parametrize("robot", STARTS)
def test_an_option_keeps_a_fiftieth_of_the_range_from_limits_if_the_start_does(robot: str) -> None:
    model = CellModel.load(CELLS[robot]).robots[robot]
    extent = model.upper - model.lower
    for q, found in zip(STARTS[robot], answers(robot), strict=True):
        least = np.minimum(LIMIT_SHARE, np.minimum(q - model.lower, model.upper - q) / extent)
        for option in found:
            assert (np.minimum(option.q - model.lower, model.upper - option.q) / extent >= least - 1e-9).all()


@pytest.mark.long
def test_a_start_that_is_best_is_an_option_that_needs_no_motion() -> None:
    (best, *_) = advised_from("dawm", DAWM.home)
    again = advised_from("dawm", best.q, effort=0.2)
    assert again[0].energy == pytest.approx(best.energy, abs=2e-3)
    assert again[0].path is not None


@pytest.mark.long
def test_hands_that_may_leave_get_more_marked_options() -> None:
    gr = CellModel.load("lab").robots["gr"]
    found = advised_from("gr", gr.home, hands_may_leave=True, effort=0.3)
    leaving = [option for option in found if option.hands_leave]
    assert leaving
    assert all(option.hands_move for option in leaving)
    for option in found:
        np.testing.assert_allclose(gr.forward(option.q), gr.forward(gr.home), atol=1e-9)
        share = np.minimum(option.q - gr.lower, gr.upper - option.q) / (gr.upper - gr.lower)
        assert share.min() >= LIMIT_SHARE - 1e-9
        if option.path is not None:
            off_m = max(np.linalg.norm((gr.forward(q) - gr.forward(gr.home))[:3, 3]) for q in option.path)
            assert (off_m > 0.01) == option.hands_leave


@pytest.mark.long
def test_a_non_redundant_arm_is_offered_its_other_branches() -> None:
    (q,) = starts(CellModel.load("lab"), "fr", 1, seed=3)
    found = advised_from("fr", q, hands_may_leave=True)
    assert sum(option.hands_leave for option in found) >= 2
    (here,) = [option for option in found if not option.hands_leave]
    np.testing.assert_array_equal(here.q, q)
    assert here.path is not None
    assert len(here.path) == 1


@pytest.mark.nightly
def test_a_trade_off_is_a_pareto_front_of_reachable_options() -> None:
    names = ("travel", "self_clearance")
    found = advised_from("dawm", DAWM.home, trade_off=names)
    costs = np.array([[option.costs[name] for name in names] for option in found])
    assert len(found) >= 3
    assert np.all(np.diff(costs[:, 0]) > 0)
    assert np.all(np.diff(costs[:, 1]) < 0)
    assert all(option.path is not None for option in found)


def test_an_invalid_trade_off_is_refused() -> None:
    with pytest.raises(CriterionError, match="no criterion 'travle'"):
        advised_from("dawm", DAWM.home, trade_off=("travle", "speed"), effort=0.1)
    elsewhere = DAWM.home + 0.1
    with pytest.raises(AdvisorError, match="with the hands in place"):
        advise(problem(), elsewhere, generator=np.random.default_rng(0), trade_off=("travel", "speed"))


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("joint", [0, 4], ids=["the torso", "an arm"])
def test_a_path_to_other_hand_poses_moves_the_hands_and_is_clear(joint: int) -> None:
    elsewhere = DAWM.home.copy()
    elsewhere[joint] -= 0.3
    found = advise(
        problem(), elsewhere, generator=np.random.default_rng(8), options=2, effort=0.2, exact=EXACT
    )
    assert all(option.hands_move for option in found)
    paths = [option.path for option in found if option.path is not None]
    assert paths
    for path, option in zip(paths, found, strict=False):
        np.testing.assert_array_equal(path[0], elsewhere)
        np.testing.assert_allclose(path[-1], option.q, atol=1e-9)
        assert np.abs(np.diff(path, axis=0)).max() <= FINE + 1e-9
        assert all(EXACT.measure(q).room_m > 0 for q in path)


@pytest.mark.nightly
def test_a_detour_is_found_if_the_straight_path_is_blocked() -> None:
    task = problem()
    space = HandsKept(TRACKER, task.poses)
    ground = MotionValidator(DAWM, space, EXACT, DAWM.home[None], wider=1.0)
    ways = PathPlanner(DAWM, space, EXACT, np.random.default_rng(9), DAWM.home)
    found = 0
    for q in search(task, np.random.default_rng(10), effort=0.5).q[:60]:
        if ground.straight(DAWM.home[None], q[None])[0]:
            continue
        try:
            path = ways.to(q)
        except NoPathError:
            continue
        found += 1
        assert np.abs(TRACKER.hands(path[len(path) // 2]) - task.poses).max() < 1e-9
        np.testing.assert_allclose(path[-1], q, atol=1e-6)
        if found == 2:
            return
    pytest.fail("no way round was found")


@pytest.mark.parametrize(("robot", "room_m"), [("dawm", 0.0), ("dawm", 0.02), ("gr", 0.0)])
def test_a_pair_that_keeps_its_distance_is_reported_as_measured(robot: str, room_m: float) -> None:
    cell = CELL if robot == "dawm" else CellModel.load("lab")
    exact, model = ExactClearance(cell, robot), cell.robots[robot]
    q = model.home + np.random.default_rng(15).normal(size=(100, model.n)) * 0.5
    keeps = [exact.keeps(one[None], room_m) for one in q]
    assert keeps == [exact.measure(one).room_m > room_m for one in q]
    assert 10 < sum(keeps) < 90
    assert not exact.keeps(q, room_m)
    assert exact.keeps(q[keeps], room_m)
    assert exact.tightest(q[:9]).room_m == min(exact.measure(one).room_m for one in q[:9])


def test_a_tree_is_cut_at_a_blocked_edge() -> None:
    ground = MotionValidator(DAWM, HandsMoved(DAWM), EXACT, DAWM.home[None], wider=1.0)
    tree, through = Tree(DAWM.home, ground), DAWM.home.copy()
    through[[2, 4, 10, 12]] = DAWM.lower[[2, 4, 10, 12]]
    near = DAWM.home - 0.05
    (good,) = tree.add(near[None], np.array([0]))
    (bad,) = tree.add(through[None], np.array([0]))
    (beyond,) = tree.add(through[None] + 0.01, np.array([bad]))
    assert tree.holds(good)
    assert not tree.holds(beyond)
    assert tree.nearest(through[None])[0] == good
    assert tree.near(through, 4).tolist() == [good, 0]
    assert tree.branch(good) == [0, good]


def test_a_cancelled_search_returns_the_options_so_far() -> None:
    told: list[Progress] = []

    def go_on(progress: Progress) -> bool:
        told.append(progress)
        return len(told) < 5

    task = problem()
    found = advise(task, DAWM.home, generator=np.random.default_rng(11), options=3, exact=EXACT, go_on=go_on)
    assert found
    assert all(option.path is None and option.no_path for option in found)
    searching = [progress for progress in told if progress.doing == "searching"]
    assert len(searching) == 5
    assert searching[-1].done < 0.2


@pytest.mark.long
def test_progress_grows_and_reports_the_least_energy_and_the_options_so_far() -> None:
    told: list[Progress] = []
    found = advise(
        problem(),
        DAWM.home,
        generator=np.random.default_rng(12),
        options=3,
        effort=0.5,
        exact=EXACT,
        go_on=lambda progress: told.append(progress) is None,
    )
    searching = [progress for progress in told if progress.doing == "searching"]
    assert 0.0 < searching[-1].done <= 1.0
    assert all(later.done > earlier.done for earlier, later in pairwise(searching))
    assert all(later.energy <= earlier.energy for earlier, later in pairwise(searching))
    assert all(later.trials >= earlier.trials for earlier, later in pairwise(searching))
    (checked,) = [progress for progress in told if progress.doing == "checking"]
    assert {option.no_path for option in checked.options} == {NOT_LOOKED_FOR}
    for progress in told[told.index(checked) :]:
        assert [option.energy for option in progress.options] == [option.energy for option in found]
    assert list(told[-1].options) == found


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_hands_out_of_reach_give_no_option_and_no_error(method: str) -> None:
    found = advise(
        out_of_reach(), DAWM.home, generator=np.random.default_rng(13), method=method, effort=0.1, exact=EXACT
    )
    assert found == []


def test_an_unknown_method_is_refused_by_name() -> None:
    with pytest.raises(AdvisorError, match="no method 'anealing'; there are annealing, shotgun, genetic"):
        search(problem(), np.random.default_rng(0), "anealing")


def test_invalid_poses_are_refused() -> None:
    poses = TRACKER.hands(DAWM.home)
    with pytest.raises(AdvisorError, match=r"shape \(2, 4, 4\), got \(1, 4, 4\)"):
        AdvisorProblem(CELL, "dawm", poses[:1], None, TRACKER)
    with pytest.raises(AdvisorError, match="proper rotation matrices"):
        AdvisorProblem(CELL, "dawm", 2 * poses, None, TRACKER)


def test_a_non_redundant_robot_is_refused() -> None:
    lab = CellModel.load("lab")
    fr = lab.robots["fr"]
    with pytest.raises(AdvisorError, match="'fr' is not redundant"):
        AdvisorProblem(lab, "fr", fr.forward(fr.home)[None])
    with pytest.raises(AdvisorError, match="no robot 'xy'; it has fr, gr"):
        AdvisorProblem(lab, "xy", fr.forward(fr.home)[None])


def test_a_pool_keeps_its_best_distinct_members() -> None:
    pool = Pool(np.empty((0, 2)))
    pool.add(np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 1.0]]), np.array([2.0, 1.0, 3.0]))
    pool.add(np.array([[5.0, 5.0]]), np.array([np.inf]))
    assert pool.best == 1.0
    np.testing.assert_array_equal(pool.q[pool.distinct(9)], [[0.1, 0.0], [0.0, 1.0]])
