"""The certificate in machine code against the readable one, where robots are cornered."""

import numpy as np
import pytest
from gate_bench import CELL, LIMITS, PROXIMITY

from deltaq_experiments.bench.cornered import stored
from deltaq_services.sim.certificate import Certifier, Suspects
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_services.sim.core import Sim
from deltaq_services.sim.tube import Branch

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
def test_nothing_is_certified_that_the_readable_code_does_not_certify(cornered):
    by_kernel = [CompiledCertifier(PROXIMITY).certify(*one).holds for one in cornered]
    readable = [Certifier(PROXIMITY, AMPLE).certify(*one).holds for one in cornered]
    usual = [Certifier(PROXIMITY).certify(*one).holds for one in cornered]
    assert 0 < sum(by_kernel) < len(cornered)
    assert not [index for index, holds in enumerate(by_kernel) if holds and not readable[index]]
    assert sum(by_kernel) >= sum(usual)


def test_the_pair_that_is_told_is_the_readable_ones(cornered):
    for name, tube, others in cornered:
        told = CompiledCertifier(PROXIMITY).certify(name, tube, others)
        expected = Certifier(PROXIMITY, AMPLE).certify(name, tube, others)
        if told.holds and expected.holds:
            assert told.binding.room_m == pytest.approx(expected.binding.room_m, abs=2e-6)
            assert told.binding.nearest.pair == expected.binding.nearest.pair


def test_nobody_is_told_who_did_not_ask(cornered):
    for one in cornered:
        told, quiet = (
            CompiledCertifier(PROXIMITY).certify(*one),
            CompiledCertifier(PROXIMITY, tells=False).certify(*one),
        )
        assert quiet.holds == told.holds
        assert quiet.binding is None


def test_nothing_that_was_certified_before_changes_a_bit(cornered):
    def answers():
        for one in cornered:
            certificate = CompiledCertifier(PROXIMITY).certify(*one)
            binding = certificate.binding
            yield certificate.holds, binding.nearest.pair, binding.nearest.swept_m.hex()

    first = list(answers())
    for one in reversed(cornered):
        CompiledCertifier(PROXIMITY, tells=False).certify(*one)
    assert list(answers()) == first


def test_where_a_certificate_failed_it_fails_again_for_those_pairs_alone(cornered):
    failed = 0
    for name, tube, others in cornered:
        certificate = CompiledCertifier(PROXIMITY).certify(name, tube, others)
        if certificate.holds:
            assert certificate.failing is None
            continue
        failed += 1
        assert not CompiledCertifier(PROXIMITY, tells=False).judge(name, tube, others, [certificate.failing])
        assert CompiledCertifier(PROXIMITY).judge(name, tube, others, [])
        nobody = Suspects("nobody", certificate.failing.groups)
        assert CompiledCertifier(PROXIMITY).judge(name, tube, others, [nobody])
    assert failed


def test_a_budget_is_what_may_be_searched_in_parts(cornered):
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
