"""Short attacks made of few numbers, so that hypothesis shrinks a failure of the gate to its bones.

A case is a list of moves. Each holds for some cycles: in which direction either robot pushes, how hard, and what the
wires do meanwhile. Both robots begin beside one another with 5 mm to spare, where a few cycles are enough.
"""

from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import pytest
from gate_bench import FR_BESIDE_GR, GR_BESIDE_FR, ORACLE, with_room
from gate_rig import CELL, Rig
from hypothesis import HealthCheck, Phase, example, find, given, settings
from hypothesis import strategies as st

from deltaq_services.sim.certificate import Certificate
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_testing.oracle import limit_violations

STOP_M = CELL.description.gate.stop_distance_m
SELF_STOP_M = CELL.description.gate.self_stop_distance_m
CYCLE_S = CELL.description.cycle_s
BESIDE = {"fr": FR_BESIDE_GR, "gr": GR_BESIDE_FR}
START = BESIDE | {"gr": with_room(5e-3, "gr", BESIDE, 4)}


@dataclass(frozen=True)
class Move:
    """What both controllers ask for some cycles long, per joint in tenths of the fastest, and what is lost."""

    fr: tuple[int, ...]
    gr: tuple[int, ...]
    cycles: int
    lost: str


def directions(joints):
    return st.tuples(*[st.integers(-10, 10)] * joints)


MOVES = st.lists(
    st.builds(
        Move,
        directions(6),
        directions(9),
        st.integers(1, 8),
        st.sampled_from(["nothing", "fr", "gr", "both"]),
    ),
    min_size=1,
    max_size=5,
)


def broken(moves):
    """What gave way when these moves were made, or None."""
    rig = Rig(**{name: q.copy() for name, q in START.items()})
    setpoints = {name: [] for name in START}
    for move in moves:
        asked = {"fr": move.fr, "gr": move.gr}
        for _ in range(move.cycles):
            for name, tenths in asked.items():
                fastest = CELL.robots[name].max_velocity * CYCLE_S
                dq = tuple((np.array(tenths) / 10 * fastest).tolist())
                rig.request(dq, robot=name, cycle=rig.servers[name].state.cycle)
                if move.lost in (name, "both"):
                    _, supervision = rig.mail[name]
                    rig.mail[name] = (None, supervision)
            rig.cycle()
            here = {name: np.array(server.state.q_cmd) for name, server in rig.servers.items()}
            for name, q in here.items():
                setpoints[name].append(q)
            if (near := ORACLE.between_robots_and_structure(here)).distance_m < STOP_M:
                return f"{near.pair} {near.distance_m:.4f} m apart"
            if (near := ORACLE.of_one_robot(here)).distance_m < SELF_STOP_M:
                return f"{near.pair} {near.distance_m:.4f} m apart"
    for name, rows in setpoints.items():
        if limit_violations(CELL.robots[name], np.array(rows), CYCLE_S).total:
            return f"{name} passed a limit"
    return None


STILL = (0,) * 6, (0,) * 9


@pytest.mark.long
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(MOVES)
@example([Move((10, 0, 0, 0, 0, 0), STILL[1], 8, "nothing"), Move((-10, 0, 0, 0, 0, 0), STILL[1], 8, "fr")])
def test_no_short_attack_of_neighbouring_robots_breaks_an_invariant(moves):
    assert broken(moves) is None


@pytest.mark.nightly
@pytest.mark.timeout(300)
def test_an_uncritical_gate_is_detected_and_its_failure_shrunk():
    careless = patch.object(CompiledCertifier, "certify", lambda *_: Certificate(holds=True, binding=None))
    with careless:
        shortest = find(
            MOVES,
            lambda moves: broken(moves) is not None,
            settings=settings(max_examples=300, deadline=None, phases=[Phase.generate, Phase.shrink]),
        )
        assert broken(shortest) is not None
    assert len(shortest) <= 2
    assert broken(shortest) is None, "the real gate stops what the careless one let pass"
