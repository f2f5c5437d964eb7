"""Commands from the HLI: a stop whenever it comes, anything else once, in its turn and in its time."""

import pytest
from gate_rig import CELL, SMALL, Rig, bound

from deltaq_protocol import topics
from deltaq_protocol.guarded import CommandReply
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.core import Sim

MAX_AGE_CYCLES = 10
"""0.12 s at 12 ms."""

ANY = (
    {"kind": "reset", "robot": "fr"},
    {"kind": "io", "robot": "gr", "outputs": {"gripper": True}},
    {"kind": "dry_run", "robot": "fr", "dq": SMALL},
    {"kind": "contact", "contact": "gripper_on_valves", "allowed": True},
)


@pytest.fixture
def rig():
    return Rig()


def replies(rig, command):
    said = [output.message for output in rig.sim.on_command(command)]
    return [message for message in said if isinstance(message, CommandReply)]


def refusal(rig, command):
    before = rig.sim.counters.copy()
    (output,) = rig.sim.on_command(command)
    reply = output.message
    assert (output.topic, output.robot) == (topics.COMMAND_REPLY, "")
    assert not reply.accepted
    assert (reply.epoch, reply.newest_id) == (rig.sim.epoch, rig.sim.snapshot().command_id)
    assert rig.sim.counters - before == {f"command_{reply.code}": 1}
    return reply.code, reply.message


@pytest.mark.parametrize("fields", ANY, ids=lambda fields: fields["kind"])
def test_a_command_that_comes_again_is_refused_and_changes_nothing(rig, fields):
    command = bound(rig.sim, **fields)
    assert all(reply.accepted for reply in replies(rig, command))
    before = rig.sim.snapshot()
    again = (ReasonCode.REPLAYED_SEQUENCE, f"id {command.id}, the newest so far is {command.id}")
    assert refusal(rig, command) == again
    assert refusal(rig, command) == again
    assert rig.sim.snapshot() == before.model_copy(update={"number": before.number + 2})


def test_a_reset_that_comes_again_after_the_next_stop_frees_nobody(rig):
    rig.command(kind="stop")
    for _ in range(20):
        rig.cycle()
    reset = bound(rig.sim, kind="reset", robot="fr")
    rig.sim.on_command(reset)
    for _ in range(4):
        rig.cycle()
    assert rig.state.phase is Phase.READY
    rig.command(kind="stop")
    for _ in range(4):
        rig.cycle()
    assert rig.state.phase is Phase.HELD
    assert refusal(rig, reset)[0] is ReasonCode.REPLAYED_SEQUENCE
    for _ in range(4):
        rig.cycle()
    assert rig.state.phase is Phase.HELD


def test_a_reset_that_a_stop_overtook_is_refused(rig):
    reset = bound(rig.sim, kind="reset", robot="fr")
    rig.sim.on_command(bound(rig.sim, id=reset.id + 1, kind="stop"))
    assert refusal(rig, reset)[0] is ReasonCode.REPLAYED_SEQUENCE


@pytest.mark.parametrize("changes", [{"id": 0}, {"epoch": 4}, {"cycles": {}}, {"cycles": {"fr": 0, "gr": 0}}])
def test_a_stop_is_obeyed_whenever_it_comes_and_however_often(rig, changes):
    rig.command(kind="io", robot="gr")
    stop = bound(rig.sim, **{"kind": "stop"} | changes)
    for _ in range(2):
        for _ in range(MAX_AGE_CYCLES):
            rig.cycle()
        said = replies(rig, stop)
        assert rig.sim.snapshot().robots["fr"].orders.standing_stop is ReasonCode.OPERATOR_STOP
        for _ in range(4):
            rig.cycle()
            said += [message for message in rig.said if isinstance(message, CommandReply)]
        assert said == [CommandReply(id=stop.id, accepted=True)]
        assert rig.state.phase is Phase.HELD
    assert rig.sim.snapshot().command_id == max(1, stop.id)


@pytest.mark.parametrize("fields", ANY, ids=lambda fields: fields["kind"])
def test_a_command_for_a_gate_that_has_ended_is_refused(rig, fields):
    command = bound(rig.sim, **fields)
    rig.sim = Sim(CELL, epoch=6)
    assert refusal(rig, command) == (ReasonCode.STALE_EPOCH, "gate epoch 5, this is 6")
    assert rig.sim.snapshot().command_id == 0


@pytest.mark.parametrize("fields", ANY, ids=lambda fields: fields["kind"])
def test_a_command_that_was_kept_back_for_longer_than_an_increment_may_be_is_stale(rig, fields):
    in_time, late = (bound(rig.sim, id=id_, **fields) for id_ in (1, 2))
    for _ in range(MAX_AGE_CYCLES):
        rig.cycle()
    assert all(reply.accepted for reply in replies(rig, in_time))
    seen = rig.state.cycle - MAX_AGE_CYCLES
    rig.cycle()
    code, said = refusal(rig, late)
    assert code is ReasonCode.STALE_CYCLE
    assert said == f"goes by cycle {seen} of {fields.get('robot', 'fr')}, which is at {rig.state.cycle}"


def test_a_command_must_tell_the_cycles_of_the_robots_that_it_concerns_and_of_no_others(rig):
    rig.cycle()
    cycles = {name: server.state.cycle for name, server in rig.servers.items()}
    of_fr = {"fr": cycles["fr"], "gr": 0}
    assert replies(rig, bound(rig.sim, kind="io", robot="fr", cycles=of_fr))[0].accepted
    assert refusal(rig, bound(rig.sim, kind="io", robot="gr", cycles=of_fr))[0] is ReasonCode.STALE_CYCLE
    without = {"fr": cycles["fr"]}
    everywhere = bound(rig.sim, kind="io", cycles=without)
    assert refusal(rig, everywhere)[1] == f"goes by cycle None of gr, which is at {cycles['gr']}"


def test_of_a_robot_that_was_never_heard_no_cycle_is_asked():
    alone = Sim(CELL, epoch=5)
    (reply,) = (output.message for output in alone.on_command(bound(alone, kind="io", robot="gr")))
    assert reply.accepted


def test_a_gate_that_recalls_another_s_memory_refuses_what_that_one_has_taken(rig):
    command = bound(rig.sim, kind="io", robot="gr")
    rig.sim.on_command(command)
    heir = Sim(CELL, epoch=9)
    heir.restore(rig.sim.snapshot())
    assert heir.on_command(command) == rig.sim.on_command(command)
    assert heir.snapshot() == rig.sim.snapshot()
