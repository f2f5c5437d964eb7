"""Gaps that the explorer found, each by its shortest way; they are closed, and stay so."""

import numpy as np
import pytest
from gate_rig import bound

from deltaq_proofs.model_checker.one_joint import ROBOT, one_joint_cell, one_joint_sim
from deltaq_protocol.guarded import Request, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement


class Pair:
    """A Robot Server and its gate; every message arrives, in order."""

    def __init__(self):
        self.cell = one_joint_cell()
        self.sim = one_joint_sim(self.cell)
        self.processes = 0
        self.start_server()
        self.time = 0
        self.supervision = None

    def start_server(self):
        self.processes += 1
        self.server = RobotServer(self.cell, ROBOT, self.processes)

    def cycles(self, count=4):
        for _ in range(count):
            self.time += 1
            q_start = np.zeros(1) if self.server.state is None else None
            measured = Measurement(self.time, np.zeros(1), q_start=q_start)
            self.server.cycle(measured, float(self.time), None, self.supervision)
            self.take(self.server.state)
            self.take(Request(robot=ROBOT, cycle=self.server.state.cycle, lease_epoch=1))
        return self.server.state.phase

    def unheard(self, count):
        """As many cycles of which the gate hears nothing."""
        for _ in range(count):
            self.time += 1
            q_start = np.zeros(1) if self.server.state is None else None
            self.server.cycle(Measurement(self.time, np.zeros(1), q_start=q_start), float(self.time))

    def take(self, message):
        outputs = [output.message for output in self.sim.take(message)]
        orders = [message for message in outputs if isinstance(message, Supervision)]
        self.supervision = orders[-1] if orders else self.supervision
        return outputs

    def command(self, kind):
        return self.take(bound(self.sim, kind=kind, robot=ROBOT))


@pytest.fixture
def pair():
    pair = Pair()
    assert pair.cycles() is Phase.READY
    return pair


def test_a_stop_holds_and_a_reset_releases(pair):
    pair.command("stop")
    assert pair.cycles() is Phase.HELD
    pair.command("reset")
    assert pair.cycles() is Phase.READY


def test_a_stop_right_after_a_reset_holds(pair):
    pair.command("stop")
    pair.cycles()
    pair.command("reset")
    pair.command("stop")
    assert pair.cycles() is Phase.HELD


def test_a_restarted_robot_server_obeys_no_old_reset(pair):
    pair.command("stop")
    pair.cycles()
    pair.command("reset")
    pair.cycles()
    pair.start_server()
    assert pair.cycles(20) is Phase.HELD
    assert pair.server.state.reason is ReasonCode.SERVER_LOST
    pair.command("reset")
    assert pair.cycles() is Phase.READY


@pytest.mark.parametrize("further", [0, 1, 30])
def test_a_restarted_robot_server_is_held_even_if_its_first_states_are_lost(pair, further):
    pair.command("stop")
    pair.cycles()
    reached = pair.server.state.cycle
    pair.start_server()
    pair.unheard(reached + further - 1)
    assert pair.cycles() is Phase.HELD
    assert pair.server.state.reason is ReasonCode.SERVER_LOST


def test_a_state_of_an_ended_robot_server_is_ignored(pair):
    old = pair.server.state
    pair.start_server()
    pair.cycles()
    newest = pair.server.state
    pair.take(old)
    assert pair.sim.robots[ROBOT].tracker.state is newest
    assert not pair.sim.robots[ROBOT].tracker.restarted


def test_no_reset_is_accepted_while_the_krc_of_a_held_robot_is_silent(pair):
    pair.command("stop")
    pair.cycles()
    pair.server.krc_silent(99.0)
    pair.take(pair.server.state)
    assert [reply.code for reply in pair.command("reset")] == [ReasonCode.CAUSE_STANDS]
