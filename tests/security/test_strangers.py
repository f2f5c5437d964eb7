"""Strangers in the guarded realm: they join its endpoints, say what its services say, and nothing comes of it."""

import math

import pytest
from sealed_realm import SealedRealm
from stranger import Stranger, ghost, orders, request

from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_protocol.codec import unpack
from deltaq_protocol.guarded import Command, Greeting, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.seal import ForgedMessageError
from deltaq_protocol.session import open_session, subscribe_newest

STEP = 1e-4  # [rad] a cycle
CYCLES = 30
CONTACT = "gripper_on_valves"


@pytest.fixture
def realm(tmp_path, lasting_links):
    realm = SealedRealm(tmp_path)
    yield realm
    realm.close()


@pytest.fixture
def stranger(realm):
    stranger = Stranger(realm.description)
    yield stranger
    stranger.close()


def attacked(realm, stranger, attack):
    """An attack of which everything has reached the Robot Servers when it returns."""
    names = ("admission", "supervision")

    def has_come():
        return all(
            robot.core.counters[f"forged_{name}"] == stranger.said[f"deltaq-guarded/lab/{robot.name}/{name}"]
            for robot in realm.robots.values()
            for name in names
        )

    def attack_and_hear():
        attack()
        realm.pump_until(has_come)

    return attack_and_hear


def hear(realm, robot, counter):
    """Cycle at rest until the Robot Server has counted what reached it."""
    while not robot.core.counters[counter]:
        realm.cycle({})


@pytest.mark.long
def test_what_the_stranger_says_would_move_the_robot_if_the_gate_said_it(realm, stranger):
    fr = realm.robots["fr"]
    realm.cycle({})
    before = fr.q.copy()
    fr.admission = stranger.admission(fr.state)
    fr.cycle()
    assert fr.core.counters["admissions"] == 1
    assert (fr.q != before).all()


@pytest.mark.long
def test_forged_admissions_move_nothing(realm, stranger):
    fr = realm.robots["fr"]
    before = fr.q.copy()

    def attack():
        stranger.say(topics.ADMISSION, stranger.admission(fr.state), robot="fr")

    for _ in range(CYCLES):
        realm.cycle({}, attacked(realm, stranger, attack))
    hear(realm, fr, "forged_admission")
    assert (fr.q == before).all()
    assert fr.core.counters["admissions"] == 0
    assert fr.state.phase is Phase.READY
    assert fr.state.counters["forged_admission"] > 0  # which `deltaq status` shows


@pytest.mark.long
def test_while_strangers_speak_in_every_cycle_every_admission_arrives_and_none_is_braked(realm, stranger):
    robots = realm.robots

    def attack():
        for robot in robots.values():
            for _ in range(3):
                stranger.say(topics.ADMISSION, stranger.admission(robot.state), robot=robot.name)
                stop = Supervision(
                    robot=robot.name,
                    epoch=robot.state.epoch,
                    cycle=robot.state.cycle,
                    stop=ReasonCode.OPERATOR_STOP,
                )
                stranger.say(topics.SUPERVISION, stop, robot=robot.name)
                stranger.say(topics.SERVER_STATE, ghost(robot.state), robot=robot.name)
                stranger.say(topics.REQUEST, request(robot.state), robot=robot.name)

    start = {name: robot.q.copy() for name, robot in robots.items()}
    for _ in range(CYCLES):
        realm.cycle(dict.fromkeys(robots, STEP), attacked(realm, stranger, attack))
    for name, robot in robots.items():
        robot.cycle()
        counters = robot.core.counters
        assert counters["admissions"] == CYCLES
        assert counters["braked_cycles"] == 0
        assert counters["forged_admission"] > 0
        assert counters["forged_supervision"] > 0
        assert robot.q[0] - start[name][0] == pytest.approx(CYCLES * STEP)
        assert (robot.q[1:] == start[name][1:]).all()
    assert realm.sim.counters["forged_messages"] > 0
    assert realm.sim.counters["admitted"] == 2 * CYCLES
    assert not any(robot.tracker.missed for robot in realm.sim.robots.values())


@pytest.mark.long
def test_ghost_states_are_not_believed(realm, stranger):
    fr = realm.robots["fr"]
    for _ in range(CYCLES):
        realm.cycle({}, lambda: stranger.say(topics.SERVER_STATE, ghost(fr.state), robot="fr"))
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    for name, robot in realm.robots.items():
        tracker = realm.sim.robots[name].tracker
        assert tracker.state == robot.state
        assert (tracker.q_cmd == robot.q).all()
        assert robot.state.phase is Phase.READY


@pytest.mark.long
def test_a_robot_that_an_operator_stopped_stays_stopped(realm, stranger):
    fr = realm.robots["fr"]
    realm.command(kind="stop")
    while fr.state.phase is not Phase.HELD:
        realm.cycle({})
    resets = fr.state.resets

    def attack():
        for order in orders(fr.state):
            stranger.say(topics.SUPERVISION, order, robot="fr")
        cycles = {name: robot.state.cycle for name, robot in realm.robots.items()}
        stranger.say(
            topics.COMMAND, Command(id=2**60, kind="reset", robot="fr", epoch=realm.sim.epoch, cycles=cycles)
        )

    for _ in range(CYCLES):
        realm.cycle({}, attacked(realm, stranger, attack))
    hear(realm, fr, "forged_supervision")
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    assert (fr.state.phase, fr.state.reason) == (Phase.HELD, ReasonCode.OPERATOR_STOP)
    assert fr.state.resets == resets
    assert realm.sim.counters["command_reset"] == 0
    # and the operator's reset still counts
    realm.command(kind="reset", robot="fr")
    while fr.state.phase is Phase.HELD:
        realm.cycle({})


@pytest.mark.long
def test_outputs_and_contacts_are_not_a_stranger_s(realm, stranger):
    gr = realm.robots["gr"]
    (output, *_) = gr.core.outputs
    before = dict(gr.core.outputs)
    contacts = realm.sim.contacts.allowed
    names = tuple(realm.description.contacts)

    def attack():
        order = Supervision(
            robot="gr",
            epoch=gr.state.epoch,
            cycle=gr.state.cycle,
            outputs={output: True},
            cell=gr.state.cell,
        )
        stranger.say(topics.SUPERVISION, order, robot="gr")
        bound = {"id": 2**60, "epoch": realm.sim.epoch, "cycles": {"gr": gr.state.cycle}}
        stranger.say(topics.COMMAND, Command(kind="io", robot="gr", outputs={output: True}, **bound))
        for name in names:
            stranger.say(topics.COMMAND, Command(kind="contact", contact=name, allowed=True, **bound))

    for _ in range(CYCLES):
        realm.cycle({}, attacked(realm, stranger, attack))
    hear(realm, gr, "forged_supervision")
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    assert gr.core.outputs == before
    assert realm.sim.contacts.allowed == contacts
    assert not any(realm.sim.counters[f"command_{kind}"] for kind in ("io", "contact"))


@pytest.mark.long
def test_greetings_are_not_a_stranger_s_either(realm, stranger):
    fr = realm.robots["fr"]
    for _ in range(CYCLES):
        realm.cycle({}, lambda: stranger.say(topics.GREETING, Greeting(service="hli"), service="hli"))
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    while not fr.core.counters["forged_greeting"]:
        realm.cycle({})
    with pytest.raises(ForgedMessageError):
        realm.shell._seal.meet("x", b"x" * 100)


def test_no_entry_of_the_audit_log_that_a_recorder_hears_is_a_stranger_s(realm, stranger):
    cell = realm.description
    recorder = open_session(connect=[cell.sim], must_connect=True)
    heard = subscribe_newest(recorder, topics.AUDIT.key(cell.cell), 1000)
    forged = AuditEntry(
        time_utc="", time_s=0.0, what=AuditKind.STOP, outcome=AuditOutcome.DONE, client="forged"
    )
    true = forged.model_copy(update={"client": "true"})
    entries = []

    def tell_and_listen():
        realm.put(topics.AUDIT_ENTRY, true)
        realm.pump()
        while (sample := heard.try_recv()) is not None:
            entries.append(unpack(AuditEntry, sample.payload.to_bytes()))

    # until what robots and HLI said before has been taken, too
    realm.pump_until(lambda: all(realm.sees(robot) for robot in realm.robots.values()))
    while not entries:
        tell_and_listen()
    forged_before = realm.sim.counters["forged_messages"]
    taken_before = realm.sim.taken
    while realm.sim.counters["forged_messages"] < forged_before + 10:
        stranger.say(topics.AUDIT_ENTRY, forged)
        stranger.say(topics.AUDIT, forged)
        tell_and_listen()
    recorder.close()
    assert set(entries) == {true}
    assert realm.sim.taken == taken_before, "the gate does not hear of them"


# --- replays ------------------------------------------------------------------------------------------


def recorded_motion(realm):
    """A realm in motion, recorded by somebody who only listened."""
    for _ in range(CYCLES):
        realm.cycle({"fr": STEP})
    for name in ("state", "admission", "supervision", "verdict"):
        key = f"deltaq-guarded/lab/fr/{name}"
        realm.pump_until(lambda key=key: [where for where, _ in realm.recording].count(key) >= CYCLES)
    return list(realm.recording)


@pytest.mark.long
def test_a_recording_says_nothing_to_those_who_heard_it(realm, stranger):
    recording = recorded_motion(realm)
    fr = realm.robots["fr"]
    for _ in range(3):  # the brake of the last admission
        realm.cycle({})
    before, admissions = fr.q.copy(), fr.core.counters["admissions"]
    states = realm.sim.taken
    stranger.repeat(recording)
    while not fr.core.counters["forged_admission"]:
        realm.cycle({})
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    assert (fr.q == before).all()
    assert fr.core.counters["admissions"] == admissions
    assert realm.sim.taken > states  # and the realm goes on


@pytest.mark.long
def test_a_recording_moves_no_robot_whose_server_has_just_started(realm, stranger):
    recording = recorded_motion(realm)
    fr = realm.restart("fr")
    before = tuple(fr.q.tolist())
    # nobody but the stranger speaks to the new process
    while not (fr.core.counters["unbound_admission"] and fr.core.counters["unbound_supervision"]):
        stranger.repeat(recording)
        fr.cycle()
        assert fr.state.phase is Phase.OFFLINE
    # and once the gate does, the robot is held as after every restart
    while fr.state.phase is not Phase.HELD:
        stranger.repeat(recording[-8:])
        realm.turn()
    assert fr.state.reason is ReasonCode.SERVER_LOST
    assert fr.core.counters["admissions"] == 0
    assert fr.state.q_cmd == before


@pytest.mark.long
def test_a_recording_shows_no_ghost_to_a_gate_that_has_just_started(realm, stranger, tmp_path):
    recording = recorded_motion(realm)
    realm.restart_gate()
    states = [(key, sealed) for key, sealed in recording if not key.endswith(("admission", "supervision"))]
    while not realm.sim.counters["unbound_messages"]:
        stranger.repeat(states)
        realm.pump()
    assert realm.sim.taken == 0
    assert all(robot.tracker.state is None for robot in realm.sim.robots.values())
    realm.settle_held()
    assert all(
        realm.sim.robots[name].tracker.state.process == robot.core.process
        for name, robot in realm.robots.items()
    )


@pytest.mark.long
def test_states_of_a_server_that_another_has_taken_the_place_of_are_not_believed(realm, stranger):
    recording = recorded_motion(realm)
    fr = realm.restart("fr")
    while realm.sim.robots["fr"].tracker.state.process != fr.core.process:
        realm.turn()
    forged = realm.sim.counters["forged_messages"]
    stranger.repeat([(key, sealed) for key, sealed in recording if key.endswith("fr/state")])
    realm.pump_until(lambda: realm.sim.counters["forged_messages"] > forged)
    assert realm.sim.robots["fr"].tracker.state.process == fr.core.process


@pytest.mark.long
def test_two_services_that_start_at_once_find_one_another(realm):
    fr = realm.restart("fr")
    realm.restart_gate()
    realm.settle_held()
    assert realm.sim.robots["fr"].tracker.state.process == fr.core.process
    while fr.state.phase is not Phase.READY:  # both are new: there is no hold to keep
        realm.turn()


@pytest.mark.long
def test_recordings_of_many_servers_keep_the_gate_from_none_that_has_just_started(realm, stranger):
    """The attack: all that were recorded under one key are repeated between a new server's state and a greeting."""
    key = topics.SERVER_STATE.key(realm.description.cell, robot="fr")
    recordings = []
    for _ in range(8):
        process = realm.restart("fr").link._seal._process
        while not (states := [said for said in realm.recording if said[0] == key and process in said[1]]):
            realm.turn()
        recordings.append(states[-1])
    realm.restart_gate()  # which has never heard any of them
    realm.settle_held()
    realm.pump_until(lambda: all(realm.has_mail(robot) for robot in realm.robots.values()))
    gate = realm.sim.counters
    while not gate["forged_messages"]:  # the new gate hears the stranger once that has found it again
        stranger.say(topics.SERVER_STATE, ghost(realm.robots["fr"].state), robot="fr")
        realm.pump()
    fr = realm.restart("fr")
    greetings = realm.shell._greeter._pace

    def is_known():
        return realm.sim.robots["fr"].tracker.state.process == fr.core.process

    def all_are_heard():
        link = realm.shell._seal._links.get(key)
        # the last recorded server is no newcomer, but known; the new one is
        return link is not None and len(link.newcomers) == len(recordings)

    # a greeting is lost if the new server's session is not ready for it; if its place went to others, all are in vain
    while not is_known():
        greetings.restore(math.inf)  # none until all have been heard
        while not (is_known() or all_are_heard()):
            fr.cycle()
            stranger.repeat(recordings)
            realm.pump()
        greetings.restore(-math.inf)
        stranger.repeat(recordings[:1])
        fr.cycle()
        realm.pump()
    assert "newcomers_passed_over" not in gate
