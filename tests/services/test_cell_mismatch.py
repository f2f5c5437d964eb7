"""Services that have read different descriptions of a cell: nothing moves, everybody is told, a stop is obeyed."""

import itertools
from collections import Counter
from typing import Any

import pytest
from gate_rig import CELL, REST_CYCLES, Rig
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_cell.cell_model import CellModel
from deltaq_cell.identity import content_identity
from deltaq_protocol.guarded import Health, Supervision
from deltaq_protocol.messages import (
    Error,
    Increment,
    LeaseAction,
    LeaseRequest,
    Phase,
    ResetRequest,
    StopRequest,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Realm
from deltaq_services.hli.core import HliCore
from deltaq_services.outputs import Output, Sender, published
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.sim.core import Sim

OURS = content_identity(CELL.description)
_GATE = CELL.description.gate.model_copy(update={"stop_distance_m": 0.06})
OTHER = CellModel.of(CELL.description.model_copy(update={"gate": _GATE}), CELL.robots, CELL.yaml)
THEIRS = content_identity(OTHER.description)


def test_the_gate_admits_nothing_while_a_robot_server_has_read_another_cell() -> None:
    rig = Rig()
    rig.request()
    rig.cycle()
    assert rig.state.phase is Phase.ENGAGED
    rig.servers["gr"] = RobotServer(OTHER.description, "gr", process=2)
    for count in range(1, 11):
        rig.cycle()
        verdict = rig.request()
        assert verdict.outcome == "refused"
        assert rig.sim.counters["states_of_another_cell_gr"] == count
    (reason,) = verdict.reasons
    assert reason.code is ReasonCode.CELL_MISMATCH
    assert reason.what == f"the Robot Server of gr has read cell {THEIRS}, and here it is {OURS}"
    assert rig.sim.counters["states_of_another_cell_fr"] == 0
    assert rig.servers["gr"].state.phase is Phase.OFFLINE  # it never began
    reset = rig.command(kind="reset", robot="gr")
    assert (reset.accepted, reset.code) == (False, ReasonCode.CELL_MISMATCH)
    assert str(THEIRS) in reset.message
    assert str(OURS) in reset.message


def test_a_robot_server_holds_its_robot_under_a_gate_of_another_cell() -> None:
    rig = Rig()
    for _ in range(3):
        rig.request()
        rig.cycle()
    assert rig.state.phase is Phase.ENGAGED
    right = rig.sim
    rig.sim = Sim(OTHER, epoch=6)
    for _ in range(20):
        rig.cycle()
    server = rig.servers["fr"]
    assert (server.state.phase, server.state.reason) == (Phase.HELD, ReasonCode.CELL_MISMATCH)
    assert server.counters["supervision_of_another_cell"] >= 19
    assert not any(server.state.dq)
    rig.command(kind="reset", robot="fr")
    rig.cycle()
    assert server.state.phase is Phase.HELD
    rig.sim = right
    for _ in range(REST_CYCLES):  # until the drives have come to rest for all that the gate knows
        rig.cycle()
    assert rig.command(kind="reset", robot="fr") is None  # taken, and answered when it shows
    for _ in range(3):
        rig.cycle()
    assert server.state.phase is Phase.READY


@pytest.mark.long
def test_the_gate_orders_a_stop_of_a_robot_whose_server_has_read_another_cell() -> None:
    state = Rig().state
    ours, theirs = Sim(CELL, epoch=5), Sim(OTHER, epoch=6)
    (alike, *_), (other, *_) = ours.on_state(state), theirs.on_state(state)
    assert isinstance(alike.message, Supervision)
    assert isinstance(other.message, Supervision)
    assert (alike.message.stop, alike.message.cell) == (None, str(OURS))
    assert (other.message.stop, other.message.cell) == (ReasonCode.CELL_MISMATCH, str(THEIRS))


def test_a_stop_of_any_gate_is_obeyed() -> None:
    rig = Rig()
    rig.request()
    rig.cycle()
    rig.sim = Sim(OTHER, epoch=6)
    rig.command(kind="stop")
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.HELD


class _Client(Sender):
    lasting = True

    def deliver(self, message: Any) -> None:
        raise AssertionError("the core only hands it back")


class _Hli:
    """An HLI's core whose client holds the lease of fr."""

    def __init__(self) -> None:
        cell = small_cell()
        tokens = (f"token-{k}" for k in itertools.count())
        self.core = HliCore(cell, told(cell), tool_pose, lambda: next(tokens), 1000)
        self.core.on_server_state(server_state("fr", 100), 50.0)
        asked = LeaseRequest(robot="fr", action=LeaseAction.ACQUIRE)
        (reply,) = (output.message for output in self.core.requests.on_lease(asked, _Client(), 50.0))
        self.lease = str(reply.model_dump()["lease"])
        self.seq = 0

    def hear(self, service: str, cell: str) -> None:
        self.core.on_health(Health(service=service, healthy=True, time_s=1.0, cell=cell), 50.0)

    def move(self) -> list[Output]:
        self.seq += 1
        increment = Increment(robot="fr", seq=self.seq, cycle=100, dq=(0.0,) * 6, lease=self.lease)
        return self.core.increments.on_increment(increment, None, 50.0)


@pytest.mark.parametrize("service", ["sim", "robot-server-gr"])
@pytest.mark.parametrize("cell", [str(THEIRS), ""])
def test_the_hli_forwards_nothing_to_services_of_another_cell(service: str, cell: str) -> None:
    hli = _Hli()
    hli.hear(service, cell)
    (output,) = hli.move()
    assert isinstance(output.message, Verdict)
    (reason,) = output.message.reasons
    assert reason.code is ReasonCode.CELL_MISMATCH
    assert reason.what.startswith(f"{service} has read cell ")
    assert reason.what.endswith(f"and here it is {hli.core.description.identity}")
    (refused,) = hli.core.requests.on_reset(ResetRequest(robot="fr"), _Client(), 50.0)
    assert isinstance(refused.message, Error)
    assert refused.message.code is ReasonCode.CELL_MISMATCH
    status = hli.core.status(50.0, Counter())
    assert status.mismatches == (reason.what,)
    assert status.identity == hli.core.description.identity
    assert status.hli["signs_of_life_of_another_cell"] == 1
    assert published(hli.core.requests.on_stop(StopRequest(), _Client(), 50.0), Realm.GUARDED)


def test_after_the_mismatch_is_corrected_the_hli_forwards_again() -> None:
    hli = _Hli()
    hli.hear("sim", str(THEIRS))
    assert not published(hli.move()[:1], Realm.GUARDED)
    hli.hear("sim", f"{hli.core.description.identity}-bodies")  # the gate reads the bodies too
    assert published(hli.move()[:1], Realm.GUARDED)
