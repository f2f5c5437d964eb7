"""A dry run and contacts: what the gate would say, and what it lets touch."""

import numpy as np
import pytest
from gate_rig import CELL, SMALL, Rig, bound

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.guarded import CommandReply
from deltaq_protocol.messages import Outcome, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.core import Sim

CONTACT = "gripper_on_valves"


@pytest.fixture
def rig():
    return Rig()


def test_a_dry_run_gives_the_verdict_of_the_gate_and_changes_nothing(rig):
    before = rig.sim.snapshot()
    reply = rig.command(kind="dry_run", robot="fr", dq=SMALL)
    assert reply.accepted
    after = rig.sim.snapshot()
    assert after.robots["fr"].tracker == before.robots["fr"].tracker
    assert (after.sequence, after.receipt) == (before.sequence, before.receipt)
    assert rig.sim.counters[Outcome.ADMITTED] == 0
    said = rig.request()
    assert reply.verdict.model_copy(update={"seq": said.seq}) == said


def test_a_second_dry_run_of_a_cycle_is_refused_and_one_in_the_next_is_not(rig):
    assert rig.command(kind="dry_run", robot="fr", dq=SMALL).accepted
    assert rig.command(kind="dry_run", robot="fr", dq=SMALL).code is ReasonCode.SUPERSEDED
    assert rig.command(kind="dry_run", robot="gr", dq=(0.0,) * 9).accepted
    rig.cycle()
    assert rig.command(kind="dry_run", robot="fr", dq=SMALL).accepted


def test_the_cycle_of_a_dry_run_is_remembered_for_a_replay(rig):
    rig.command(kind="dry_run", robot="fr", dq=SMALL)
    other = Sim(CELL, epoch=1)
    other.restore(rig.sim.snapshot())
    (output,) = other.on_command(bound(other, kind="dry_run", robot="fr", dq=SMALL))
    assert output.message.code is ReasonCode.SUPERSEDED


def told(sim, **fields):
    """The one reply to a command: whether it was taken, why not, and in words."""
    command = bound(sim, **fields)
    (output,) = sim.on_command(command)
    assert (output.topic, output.robot, output.message.id) == (topics.COMMAND_REPLY, "", command.id)
    return output.message.accepted, output.message.code, output.message.message


def test_the_reply_to_a_dry_run_explains_its_limit(rig):
    fields = {"kind": "dry_run", "robot": "fr", "dq": SMALL}
    shape = (False, ReasonCode.BAD_SHAPE, "dq has 7 elements, not 6")
    assert told(rig.sim, **fields | {"dq": (0.0,) * 7}) == shape
    assert told(rig.sim, **fields | {"dq": None})[1] is ReasonCode.BAD_SHAPE
    nobody = (False, ReasonCode.NOT_READY, "no state of that robot yet")
    assert told(Sim(CELL, epoch=5), **fields) == told(rig.sim, kind="dry_run", dq=SMALL) == nobody
    alone = Sim(CELL, epoch=5)
    alone.on_state(rig.state)
    assert told(alone, **fields) == (False, ReasonCode.NOT_READY, "fr: gr")
    assert told(rig.sim, **fields) == (True, None, "")
    again = (False, ReasonCode.SUPERSEDED, "one dry run for each state of the robot")
    assert told(rig.sim, **fields) == again
    rig.cycle()
    rig.command(kind="stop")
    assert told(rig.sim, **fields) == (False, ReasonCode.STOPPED, "fr is ready")
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.HELD
    assert told(rig.sim, **fields)[1] is ReasonCode.STOPPED


def test_a_new_gate_decides_nothing_before_it_knows_the_setpoints_of_the_lag(rig):
    sim = Sim(CELL, epoch=5)
    cycles = sim.robots["fr"].tracker.drives.lag + 1
    for cycle in range(1, cycles + 1):
        for server in rig.servers.values():
            sim.on_state(server.state.model_copy(update={"cycle": cycle}))
        answer = told(sim, kind="dry_run", robot="fr", dq=SMALL)
        assert answer == ((False, ReasonCode.NOT_READY, "fr: fr") if cycle < cycles else (True, None, ""))


T_HOME = CELL.robots["gr"].forward(CELL.robots["gr"].home)
BUOY = T_HOME[:3, 3] + 0.3 * T_HOME[:3, 2]
LIMITS = CELL.robots["gr"].max_velocity * CELL.description.cycle_s


def with_a_buoy(folder):
    """The lab with a ball before the leader's gripper, that it may touch when an operator says so."""
    path = folder / "buoy.yaml"
    position = ", ".join(f"{number:.4f}" for number in BUOY)
    path.write_text(
        "extends: lab\n"
        f"structure: {{buoy: {{shape: {{kind: sphere, radius_m: 0.05}}, pose: {{position_m: [{position}]}}}}}}\n"
        f"contacts: {{touch: {{bodies: {GRIPPER}, against: [structure/buoy], speed: 0.05}}}}\n",
        encoding="utf-8",
    )
    return CellModel.load(path)


GRIPPER = "[gr/tool_gripper, gr/tool_finger_1, gr/tool_finger_2]"


def driven_at_the_buoy(rig, cycles):
    """The last verdict, where the tool is from the buoy [m], and the greatest share of a velocity limit."""
    robot, server = CELL.robots["gr"], rig.servers["gr"]
    verdict, fastest = None, 0.0
    for _ in range(cycles):
        q = np.array(server.state.q_cmd)
        way = BUOY - robot.forward(q)[:3, 3]
        dq = np.linalg.lstsq(robot.jacobian(q)[:3], way * min(1.0, 0.01 / np.linalg.norm(way)), rcond=None)[0]
        verdict = rig.request(tuple(dq), robot="gr", cycle=server.state.cycle)
        rig.cycle()
        fastest = max(fastest, float(np.max(np.abs(server.state.dq) / LIMITS)))
    q = np.array(server.state.q_cmd)
    return verdict, float(np.linalg.norm(robot.forward(q)[:3, 3] - BUOY)), fastest


@pytest.mark.long
def test_bodies_touch_slowly_while_a_contact_is_allowed_and_not_without(tmp_path):
    cell = with_a_buoy(tmp_path)
    rig = Rig(cell)
    verdict, kept_off, _ = driven_at_the_buoy(rig, 60)
    assert verdict.outcome is not Outcome.ADMITTED
    assert verdict.reasons[0].code is ReasonCode.CLEARANCE
    assert "structure/buoy" in verdict.reasons[0].what
    assert rig.command(kind="contact", contact="touch", allowed=True).accepted
    for _ in range(12):
        rig.cycle()
    verdict, reached, fastest = driven_at_the_buoy(rig, 120)
    assert reached < kept_off - 0.05
    assert fastest <= cell.description.contacts["touch"].speed * (1 + 1e-9)
    assert ReasonCode.CONTACT in {reason.code for reason in verdict.reasons} or verdict.reasons == ()
    assert rig.command(kind="contact", contact="touch", allowed=False).accepted
    for _ in range(12):
        rig.cycle()
    verdict, nearer, _ = driven_at_the_buoy(rig, 5)
    assert verdict.outcome is Outcome.HELD
    assert nearer >= reached - 1e-3


def test_only_robots_of_the_contact_are_slowed(rig):
    rig.command(kind="contact", contact=CONTACT, allowed=True)
    assert rig.sim.contacts.speed("gr") == (CELL.description.contacts[CONTACT].speed, CONTACT)
    assert rig.sim.contacts.speed("fr") == (1.0, "")


def test_an_unknown_contact_is_refused(rig):
    for contact, said in (("handshake", "'handshake'"), (None, "None")):
        refused = (False, ReasonCode.MALFORMED, f"no contact {said} here")
        assert told(rig.sim, kind="contact", contact=contact, allowed=True) == refused
    assert told(rig.sim, kind="contact", contact=CONTACT, allowed=True) == (True, None, "")


def test_allowed_contacts_are_part_of_a_snapshot(rig):
    rig.command(kind="contact", contact=CONTACT, allowed=True)
    memory = rig.sim.snapshot()
    assert memory.contacts == (CONTACT,)
    other = Sim(CELL, epoch=9)
    other.restore(memory)
    assert other.contacts.allowed == (CONTACT,)
    assert other.snapshot() == memory


# Commands from the HLI: a stop whenever it comes, anything else once, in its turn and in its time.

MAX_AGE_CYCLES = 10
"""0.12 s at 12 ms."""

ANY = (
    {"kind": "reset", "robot": "fr"},
    {"kind": "io", "robot": "gr", "outputs": {"gripper": True}},
    {"kind": "dry_run", "robot": "fr", "dq": SMALL},
    {"kind": "contact", "contact": "gripper_on_valves", "allowed": True},
)


def replies(rig, command):
    said = [output.message for output in rig.sim.on_command(command)]
    return [message for message in said if isinstance(message, CommandReply)]


def refusal(rig, command):
    before = rig.sim.counters.copy()
    (output,) = rig.sim.on_command(command)
    reply = output.message
    assert (output.topic, output.robot) == (topics.COMMAND_REPLY, "")
    assert not reply.accepted
    assert (reply.epoch, reply.newest_id) == (
        rig.sim.epoch,
        rig.sim.snapshot().command_id,
    )
    assert rig.sim.counters - before == {f"command_{reply.code}": 1}
    return reply.code, reply.message


@pytest.mark.parametrize("fields", ANY, ids=lambda fields: fields["kind"])
def test_a_repeated_command_is_refused_and_changes_nothing(rig, fields):
    command = bound(rig.sim, **fields)
    assert all(reply.accepted for reply in replies(rig, command))
    before = rig.sim.snapshot()
    again = (ReasonCode.REPLAYED_SEQUENCE, f"id {command.id}, the newest so far is {command.id}")
    assert refusal(rig, command) == again
    assert refusal(rig, command) == again
    assert rig.sim.snapshot() == before.model_copy(update={"number": before.number + 2})


def test_a_repeated_reset_after_the_next_stop_releases_no_robot(rig):
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
def test_late_and_repeated_stops_are_obeyed(rig, changes):
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
def test_a_command_delayed_beyond_the_greatest_age_is_stale(rig, fields):
    in_time, late = (bound(rig.sim, id=id_, **fields) for id_ in (1, 2))
    for _ in range(MAX_AGE_CYCLES):
        rig.cycle()
    assert all(reply.accepted for reply in replies(rig, in_time))
    seen = rig.state.cycle - MAX_AGE_CYCLES
    rig.cycle()
    code, said = refusal(rig, late)
    assert code is ReasonCode.STALE_CYCLE
    assert said == f"refers to cycle {seen} of {fields.get('robot', 'fr')}, which is at {rig.state.cycle}"


def test_a_command_must_have_the_cycles_of_exactly_its_robots(rig):
    rig.cycle()
    cycles = {name: server.state.cycle for name, server in rig.servers.items()}
    of_fr = {"fr": cycles["fr"], "gr": 0}
    assert replies(rig, bound(rig.sim, kind="io", robot="fr", cycles=of_fr))[0].accepted
    assert refusal(rig, bound(rig.sim, kind="io", robot="gr", cycles=of_fr))[0] is ReasonCode.STALE_CYCLE
    without = {"fr": cycles["fr"]}
    everywhere = bound(rig.sim, kind="io", cycles=without)
    assert refusal(rig, everywhere)[1] == f"refers to cycle None of gr, which is at {cycles['gr']}"


def test_a_command_names_no_cycle_of_a_robot_without_a_state():
    alone = Sim(CELL, epoch=5)
    (reply,) = (output.message for output in alone.on_command(bound(alone, kind="io", robot="gr")))
    assert reply.accepted


def test_a_restored_gate_refuses_commands_that_the_former_one_took(rig):
    command = bound(rig.sim, kind="io", robot="gr")
    rig.sim.on_command(command)
    heir = Sim(CELL, epoch=9)
    heir.restore(rig.sim.snapshot())
    assert heir.on_command(command) == rig.sim.on_command(command)
    assert heir.snapshot() == rig.sim.snapshot()
