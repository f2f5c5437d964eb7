"""I2: what is certified really keeps its distance, as dense samples of an oracle show."""

import numpy as np
import pytest
from gate_bench import CELL, LIMITS, PROXIMITY
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spans import exact_drives

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_experiments.bench.decisions import stored
from deltaq_services.sim.certificate import HALVINGS, Certificate, Certifier, Suspects, largest
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_services.sim.core import Sim
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tube import Branch, Span, tube
from deltaq_testing.oracle import ClearanceOracle

LAG = 6


@pytest.fixture(scope="module")
def cell():
    return CellModel.load("lab")


@pytest.fixture(scope="module")
def proximity(cell):
    return CompiledProximity(cell)


@pytest.fixture(scope="module")
def oracle(cell):
    return ClearanceOracle(cell)


def at_rest(q):
    return tube(np.tile(q, (LAG, 1)), Branch(np.zeros_like(q), 1, 1), exact_drives(LAG, q.size))


def moving(cell, name, q, dq):
    cycle_s = cell.description.cycle_s
    cycles = Limits.of(cell.robots[name].description, cycle_s).brake_cycles(dq)
    history = q - dq * np.arange(LAG - 1, -1, -1)[:, None]
    return tube(history, Branch(dq, cycles, -1), exact_drives(LAG, q.size))


def test_the_homes_are_certified_with_the_distance_the_oracle_measures(cell, proximity, oracle):
    homes = {name: robot.home for name, robot in cell.robots.items()}
    certificate = Certifier(proximity).certify("fr", at_rest(homes["fr"]), [("gr", at_rest(homes["gr"]))])
    assert certificate.holds
    assert certificate.binding.nearest.distance_m >= oracle.of_one_robot(homes).distance_m - 1e-6


def test_a_robot_in_the_floor_is_not_certified_and_the_pair_is_named(cell, proximity):
    q = cell.robots["fr"].home.copy()
    q[1] = np.deg2rad(30)
    certificate = Certifier(proximity).certify("fr", at_rest(q), [])
    assert not certificate.holds
    near = certificate.binding
    assert near.nearest.distance_m < near.stop_distance_m
    assert "structure/floor" in near.nearest.pair


@pytest.mark.long
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_no_sample_of_a_certified_tube_is_nearer_than_the_stop_distance(cell, proximity, oracle, seed):
    random = np.random.default_rng(seed)
    cycle_s = cell.description.cycle_s
    tubes, points = {}, {}
    for name, robot in cell.robots.items():
        near_home = robot.home + random.uniform(-1, 1, robot.n) * 0.15 * (robot.upper - robot.lower)
        q = np.clip(near_home, robot.lower, robot.upper)
        dq = random.uniform(-1, 1, robot.n) * robot.max_velocity * cycle_s * random.uniform(0, 1)
        tubes[name] = moving(cell, name, q, dq)
        points[name] = tubes[name].points
    for name, other in (("fr", "gr"), ("gr", "fr")):
        certificate = Certifier(proximity).certify(name, tubes[name], [(other, tubes[other])])
        if not certificate.holds:
            continue
        for _ in range(25):
            here = {
                robot: rows[0] + random.uniform() * (rows[-1] - rows[0]) for robot, rows in points.items()
            }
            nearest = oracle.between_robots_and_structure(here)
            if nearest.pair[0].startswith(name) or nearest.pair[1].startswith(name):
                assert nearest.distance_m >= 0.05


@pytest.mark.long
def test_travel_bounds_the_motion_of_every_corner_within_the_box(cell, proximity):
    """The swept distance is a lower bound of the distance at any configuration of the box."""
    random = np.random.default_rng(3)
    homes = {name: robot.home for name, robot in cell.robots.items()}
    still = {name: np.zeros_like(q) for name, q in homes.items()}
    for _ in range(20):
        half = {name: random.uniform(0, 0.06, q.size) for name, q in homes.items()}
        swept = {}
        for name, q in homes.items():
            proximity.place(name, q, half[name])
        groups = {
            "fr": proximity.alone["fr"], "gr": proximity.alone["gr"], "both": proximity.between["fr", "gr"]
        }  # fmt: skip
        for key, members in groups.items():
            swept[key] = [proximity.least(group) for group in members]
        for _ in range(5):
            for name, q in homes.items():
                proximity.place(name, q + random.uniform(-1, 1, q.size) * half[name], still[name])
            for key, members in groups.items():
                for group, bound in zip(members, swept[key], strict=True):
                    assert proximity.least(group) >= bound - 1e-6


def test_an_empty_budget_refuses(cell, proximity):
    q = cell.robots["fr"].home
    far = Span.around(
        np.array([q, np.clip(q + 1.0, cell.robots["fr"].lower, cell.robots["fr"].upper)]), np.zeros(6), 0.0
    )
    assert not Certifier(proximity, budget=0).certify("fr", far, []).holds


# The search for the largest share: what it finds was certified in full, whatever was suspected.

REFUSED = 0.8
LEAST = REFUSED / 2**HALVINGS


class Judged:
    """Scales that are certified, and those that each suspect keeps apart at; both are written down."""

    def __init__(self, certified, *suspected):
        self._certified, self._suspected = certified, suspected
        self.certificates, self.suspects = [], []

    def certify(self, scale):
        self.certificates.append(scale)
        name = str(min(len(self.certificates), len(self._suspected) - 1))
        return Certificate(
            self._certified(scale), None, None if self._certified(scale) else Suspects(name, ())
        )

    def holds(self, scale, suspects):
        self.suspects.append([one.other for one in suspects])
        return all(self._suspected[int(one.other)](scale) for one in suspects)

    def largest(self):
        return largest(self.certify, self.holds, REFUSED, Certificate(False, None, Suspects("0", ())))


def up_to(greatest):
    return lambda scale: scale <= greatest


@pytest.mark.parametrize("greatest", [0.0, 0.025, 0.03, 0.3, 0.49, 0.79])
def test_the_largest_share_is_found_to_a_thirty_second_by_one_certificate(greatest):
    judged = Judged(up_to(greatest), up_to(greatest))
    assert greatest - LEAST <= judged.largest() <= greatest
    assert len(judged.certificates) == (1 if greatest >= LEAST else 0)


def test_suspects_refused_at_the_least_share_end_the_search():
    judged = Judged(up_to(1.0), up_to(0.02))
    assert judged.largest() == 0.0
    assert (judged.certificates, len(judged.suspects)) == ([], 1)


def test_a_new_failing_pair_becomes_a_suspect():
    judged = Judged(up_to(0.3), up_to(0.6), up_to(0.3))
    assert 0.3 - LEAST <= judged.largest() <= 0.3
    assert len(judged.certificates) == 2
    assert judged.suspects[0] == ["0"]
    assert judged.suspects[-1] == ["0", "1"]


def test_with_wrong_suspects_the_least_share_is_tried():
    judged = Judged(up_to(LEAST), up_to(1.0))
    assert judged.largest() == LEAST
    assert judged.certificates[-1] == LEAST
    assert len(judged.certificates) == 4


def test_with_wrong_suspects_the_least_share_must_be_certified_too():
    judged = Judged(up_to(0.0), up_to(1.0))
    assert judged.largest() == 0.0
    assert judged.certificates[-1] == LEAST


def test_without_obstacles_no_share_above_the_refused_one_is_tried():
    judged = Judged(up_to(1.0), up_to(1.0))
    assert REFUSED - LEAST <= judged.largest() < REFUSED


def test_a_request_refused_at_the_least_share_is_not_tried_again():
    judged = Judged(up_to(0.0), up_to(LEAST))
    assert judged.largest() == 0.0
    assert judged.certificates == [LEAST]


@given(st.frozensets(st.integers(1, 31)), st.lists(st.frozensets(st.integers(1, 31)), min_size=1, max_size=3))
def test_a_found_share_is_certified_and_below_the_refused_one(certified, suspected):
    def of(shares):
        return lambda scale: round(scale / LEAST) in shares

    judged = Judged(of(certified), *map(of, suspected))
    found = judged.largest()
    assert 0.0 <= found < REFUSED
    assert found == 0.0 or (found in judged.certificates and of(certified)(found))
    assert len(judged.certificates) <= 4


# The certificate in machine code against the readable one, where robots are cornered.

AMPLE = 4000
"""Pieces for the readable code: as many as it likes."""


@pytest.fixture(scope="module")
def cornered():
    """Robots, tubes that they are asked for, and tubes of others."""
    sim = Sim(CELL, epoch=0)
    found = []
    for situation in stored()[::4]:
        sim.restore(situation.memory)
        robot = sim.robots[situation.request.robot].tracker
        others = [item.tracker for name, item in sim.robots.items() if name != robot.name]
        tubes = [(other.name, tube) for other in others for tube in other.tubes()]
        brake, request = robot.brake(), np.array(situation.request.dq)
        for scale in (0.05, 0.4):
            dq = brake + scale * (request - brake)
            tube = robot.tube(Branch(dq, LIMITS[robot.name].brake_cycles(dq), -1))
            found.append((robot.name, tube, tubes))
    return found


@pytest.mark.long
def test_the_kernel_certifies_only_what_the_readable_code_certifies(cornered):
    by_kernel = [CompiledCertifier(PROXIMITY).certify(*one).holds for one in cornered]
    readable = [Certifier(PROXIMITY, AMPLE).certify(*one).holds for one in cornered]
    usual = [Certifier(PROXIMITY).certify(*one).holds for one in cornered]
    assert 0 < sum(by_kernel) < len(cornered)
    assert not [index for index, holds in enumerate(by_kernel) if holds and not readable[index]]
    assert sum(by_kernel) >= sum(usual)


def test_the_reported_pair_agrees_with_the_readable_code(cornered):
    for name, whole, others in cornered:
        told = CompiledCertifier(PROXIMITY).certify(name, whole, others)
        expected = Certifier(PROXIMITY, AMPLE).certify(name, whole, others)
        if told.holds and expected.holds:
            assert told.binding.room_m == pytest.approx(expected.binding.room_m, abs=2e-6)
            assert told.binding.nearest.pair == expected.binding.nearest.pair


def test_earlier_certificates_do_not_change_a_bit(cornered):
    def answers():
        for one in cornered:
            certificate = CompiledCertifier(PROXIMITY).certify(*one)
            binding = certificate.binding
            yield certificate.holds, binding.nearest.pair, binding.nearest.swept_m.hex()

    first = list(answers())
    for one in reversed(cornered):
        CompiledCertifier(PROXIMITY, tells=False).certify(*one)
    assert list(answers()) == first


def test_a_failed_certificate_fails_again_for_its_open_pairs_alone(cornered):
    failed = 0
    for name, whole, others in cornered:
        certificate = CompiledCertifier(PROXIMITY).certify(name, whole, others)
        if certificate.holds:
            assert certificate.failing is None
            continue
        failed += 1
        assert not CompiledCertifier(PROXIMITY, tells=False).judge(name, whole, others, [certificate.failing])
        assert CompiledCertifier(PROXIMITY).judge(name, whole, others, [])
        nobody = Suspects("nobody", certificate.failing.groups)
        assert CompiledCertifier(PROXIMITY).judge(name, whole, others, [nobody])
    assert failed


def test_the_budget_counts_searches_in_parts(cornered):
    divided = [one for one in cornered if CompiledCertifier(PROXIMITY).certify(*one).holds]
    spent = 0
    for one in divided:
        certifier = CompiledCertifier(PROXIMITY)
        certifier.certify(*one)
        needed = CompiledCertifier(PROXIMITY)._left - certifier._left
        assert CompiledCertifier(PROXIMITY, budget=needed).certify(*one).holds
        if needed:
            spent += 1
            assert not CompiledCertifier(PROXIMITY, budget=0).certify(*one).holds
    assert spent
