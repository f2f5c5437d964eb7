"""The virtual cell: its clients, its wires and its processes, and that one seed is one run."""

import numpy as np
import pytest

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.guarded import Admission
from deltaq_protocol.messages import LeaseAction, LeaseReply, LeaseRequest, Outcome, Phase
from deltaq_testing.virtual_cell.cell import VirtualCell, VirtualCellError
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Link, MessageWire, Process

STEP = np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def lab():
    return LoadedCell.load("lab")


class Listener:
    """A client that keeps what it is told."""

    def __init__(self, say):
        self.robot, self.token, self.say = "fr", None, say
        self.told = []

    def take(self, message):
        self.told.append(message)

    def acquire(self):
        self.say(LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE, client="listener"))
        return [message.granted for message in self.told if isinstance(message, LeaseReply)]


def ready(lab):
    cell = VirtualCell(lab)
    cell.run_until_ready()
    return cell


def test_the_second_client_drives_only_after_the_first_died(lab):
    cell = ready(lab)
    one, other = cell.connect(Listener), cell.connect(Listener)
    assert one.core.acquire() == [True]
    assert other.core.acquire() == [False]
    one.core.token = one.core.told[-1].lease
    with pytest.raises(VirtualCellError, match="no lease of fr for third"):
        cell.acquire("fr", "third")
    cell.kill_client(one)
    cell.cycle()
    assert other.core.acquire() == [False, True]


def test_messages_for_an_earlier_client_do_not_reach_its_successor(lab):
    cell, down = ready(lab), MessageWire()
    connection = cell.connect(Listener, down=down)
    before = connection.core
    assert before.acquire() == [True]
    connection.start()
    cell.hli_clock_s = 100.0  # the lease runs out, and its holder is told of it
    cell.cycle()
    assert connection.core is not before
    assert {type(message).__name__ for message in connection.core.told} == {"RobotState"}


def test_a_resumed_gate_answers_the_messages_of_its_freeze(lab):
    cell = ready(lab)
    cell.acquire("fr", "test")
    gate = cell.process(Process.SIM, "fr")
    gate.freeze()
    cell.cycle()
    assert cell.ask("fr", STEP) is None
    gate.thaw()
    assert cell.ask("fr", STEP).outcome is Outcome.ADMITTED


@pytest.mark.long
def test_a_wire_carries_only_its_kind_of_message(lab):
    cell, wire = ready(lab), MessageWire()
    cell.plug(Link.SIM_SERVER, Process.ROBOT_SERVER, wire, ["fr"], Admission)
    wire.link.faults = LinkFaults(drop=1.0)
    for robot in ("fr", "gr"):
        cell.acquire(robot, "test")
    for _ in range(60):  # longer than a gate may be silent
        cell.cycle()
        for robot in ("fr", "gr"):
            cell.ask(robot, np.resize(STEP, cell.cell.robots[robot].n))
    assert cell.arms["fr"].server.counters["admissions"] == 0
    assert cell.arms["gr"].server.counters["admissions"] > 50
    assert cell.states["fr"].phase is Phase.READY
    assert wire.link.counts["dropped"] > 50


def test_a_robot_with_a_late_clock_stands_while_the_others_move(lab):
    cell = ready(lab)
    before = {name: state.cycle for name, state in cell.states.items()}
    cell.cycle(["gr"])
    cell.cycle(["gr"])
    assert {name: state.cycle - before[name] for name, state in cell.states.items()} == {"fr": 0, "gr": 2}


def test_a_robot_without_a_krc_is_at_its_setpoint():
    cell = VirtualCell("dawm")
    cell.run_until_ready()
    assert cell.krc_arms == {}
    cell.acquire("dawm", "test")
    before = cell.arms["dawm"].q
    dq = np.full(before.size, 1e-5)
    for _ in range(3):
        cell.cycle()
        assert cell.ask("dawm", dq).outcome is Outcome.ADMITTED
    cell.cycle()
    np.testing.assert_allclose(cell.arms["dawm"].q - before, 3 * dq)
