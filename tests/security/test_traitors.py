"""Who has broken into one service has its identity, and every key that follows from it; others are not deceived."""

import pytest
from identities import Traitor, make
from sealed_realm import SealedRealm
from stranger import Stranger, ghost, orders, request

from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import Command, CommandReply, Greeting
from deltaq_protocol.messages import Outcome, Phase, Verdict
from deltaq_protocol.sayings import HLI, SIM, robot_server, services
from deltaq_protocol.seal import ForgedMessageError
from deltaq_services.guarded_key import KEY_FILE

pytestmark = pytest.mark.long

STEP = 1e-4  # [rad] a cycle
CYCLES = 10


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv(KEY_FILE)
    folder = make(tmp_path / "identities")
    monkeypatch.setenv(IDENTITY, str(folder))
    return folder


@pytest.fixture
def realm(tmp_path, folder, lasting_links):
    realm = SealedRealm(tmp_path)
    yield realm
    realm.close()


class Inside(Stranger):
    """A stranger with an identity: it says each thing once with every key that it has."""

    macs_of_a_state = 2

    def __init__(self, cell, folder):
        super().__init__(cell)
        self.traitor = Traitor(folder, cell.cell, tuple(cell.robots))

    def say(self, topic, message, **fields):
        key = topic.key(self.cell.cell, **fields)
        for key_of_a_pair in self.traitor.says(key, pack(message)):
            self._publisher(key).put(key_of_a_pair)
            self.said[key] += 1

    def hear(self):
        super().hear()
        for key, sealed in self.recording:
            self.traitor.overhear(key, sealed)


def inside(realm, folder):
    """It has heard every process of the realm."""
    one = Inside(realm.description, folder)
    while len(one.traitor.processes) < len(services(tuple(realm.robots))):
        realm.turn()
        one.hear()
    return one


def test_identities_carry_a_realm_in_motion_in_which_nothing_is_refused(realm):
    realm.assert_moves(CYCLES, STEP)


def test_services_that_start_again_find_one_another(realm):
    fr = realm.restart("fr")
    realm.restart_gate()
    realm.settle_held()
    assert realm.sim.robots["fr"].tracker.state.process == fr.core.process


def test_what_a_traitor_says_would_move_the_robot_if_it_had_the_gate_s_identity(realm, folder):
    gate = inside(realm, folder / SIM)
    fr = realm.robots["fr"]
    realm.cycle({})
    gate.say(topics.ADMISSION, gate.admission(fr.state), robot="fr")
    while fr.admission is None:
        fr.listen()
    before = fr.q.copy()
    fr.cycle()
    assert fr.core.counters["admissions"] == 1
    assert (fr.q != before).all()
    gate.close()


def lie_to(realm, traitor, robot, topic, message):
    """Say something in the gate's place, and let the Robot Server look at it: it keeps few messages of a kind."""
    traitor.say(topic, message, robot=robot.name)
    said = traitor.said[topic.key(realm.description.cell, robot=robot.name)]
    realm.pump_until(lambda: robot.core.counters[f"forged_{topic.name}"] == said)


def attack(realm, traitor, own):
    """Everything that others say, in their place, once for each robot: as the gate, the HLI and other Robot Servers."""
    cycles = {name: robot.state.cycle for name, robot in realm.robots.items()}
    bound = {"id": 2**60, "epoch": realm.sim.epoch, "cycles": cycles}
    for name, robot in realm.robots.items():
        if name != own:
            lie_to(realm, traitor, robot, topics.ADMISSION, traitor.admission(robot.state))
            for order in orders(robot.state):
                lie_to(realm, traitor, robot, topics.SUPERVISION, order)
            traitor.say(topics.SERVER_STATE, ghost(robot.state), robot=name)
        traitor.say(topics.REQUEST, request(robot.state), robot=name)
        traitor.say(topics.COMMAND, Command(kind="reset", robot=name, **bound))
        outputs = dict.fromkeys(robot.core.outputs, True)
        traitor.say(topics.COMMAND, Command(kind="io", robot=name, outputs=outputs, **bound))
    traitor.say(topics.COMMAND, Command(kind="stop", **bound))
    for contact in realm.description.contacts:
        traitor.say(topics.COMMAND, Command(kind="contact", contact=contact, allowed=True, **bound))
    entry = AuditEntry(
        time_utc="", time_s=0.0, what=AuditKind.STOP, outcome=AuditOutcome.DONE, client="forged"
    )
    traitor.say(topics.AUDIT_ENTRY, entry)
    for service in services(tuple(realm.robots)):
        if service != traitor.traitor.name:
            traitor.say(topics.GREETING, Greeting(service=service), service=service)


def test_who_has_one_robot_server_says_nothing_for_the_other_robot_the_hli_or_the_gate(realm, folder):
    traitor = inside(realm, folder / robot_server("fr"))
    gr = realm.robots["gr"]
    before = {name: (robot.q.copy(), dict(robot.core.outputs)) for name, robot in realm.robots.items()}
    contacts, resets = realm.sim.contacts.allowed, gr.state.resets
    addressed = realm.shell._seal._receivers
    for _ in range(CYCLES):
        realm.cycle({}, lambda: attack(realm, traitor, own="fr"))

    def refused():
        counted = gr.core.counters
        at_gr = all(counted[f"forged_{name}"] for name in ("admission", "supervision", "greeting"))
        return at_gr and realm.sim.counters["forged_messages"] >= 20 * CYCLES

    while not refused():
        realm.cycle({})
    for name, robot in realm.robots.items():
        q, outputs = before[name]
        assert (robot.q == q).all()
        assert robot.core.outputs == outputs
        assert robot.core.counters["admissions"] == 0
        assert robot.state.phase is Phase.READY
        assert realm.sim.robots[name].tracker.state.cycle <= robot.state.cycle, "no ghost"
    assert gr.state.resets == resets
    assert realm.sim.contacts.allowed == contacts
    assert not [counter for counter in realm.sim.counters if counter.startswith(("command_", "impossible"))]
    assert realm.shell._seal._receivers == addressed, "nobody was greeted"
    assert gr.state.counters["forged_admission"] > 0, "which `deltaq status` shows"
    # and the realm goes on
    for _ in range(CYCLES):
        realm.cycle(dict.fromkeys(realm.robots, STEP))
    traitor.close()


def test_while_it_lies_in_every_cycle_every_admission_of_the_other_robot_arrives(realm, folder):
    traitor = inside(realm, folder / robot_server("fr"))
    gr = realm.robots["gr"]

    def lie():
        lie_to(realm, traitor, gr, topics.ADMISSION, traitor.admission(gr.state))
        traitor.say(topics.SERVER_STATE, ghost(gr.state), robot="gr")

    start = gr.q[0]
    for _ in range(CYCLES):
        realm.cycle({"gr": STEP}, lie)
    gr.cycle()
    assert gr.core.counters["admissions"] == CYCLES
    assert gr.core.counters["braked_cycles"] == 0
    assert gr.q[0] - start == pytest.approx(CYCLES * STEP)
    traitor.close()


def test_who_has_the_hli_says_nothing_for_the_gate_or_a_robot_server(realm, folder):
    traitor = inside(realm, folder / HLI)
    fr = realm.robots["fr"]
    before = fr.q.copy()

    def lie():
        lie_to(realm, traitor, fr, topics.ADMISSION, traitor.admission(fr.state))
        for order in orders(fr.state):
            lie_to(realm, traitor, fr, topics.SUPERVISION, order)
        traitor.say(topics.SERVER_STATE, ghost(fr.state), robot="fr")

    for _ in range(CYCLES):
        realm.cycle({}, lie)
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    assert (fr.q == before).all()
    assert fr.core.counters["admissions"] == 0
    assert fr.state.phase is Phase.READY
    traitor.close()


@pytest.mark.parametrize("own", ["fr", "gr"])
def test_the_hli_is_told_no_verdicts_or_replies_by_a_robot_server(realm, folder, own):
    traitor = inside(realm, folder / robot_server(own))
    verdict = Verdict(robot="gr", cycle=1, seq=1, outcome=Outcome.ADMITTED, scale=1.0, dq=(0.0,))
    for topic, message, fields in (
        (topics.GATE_VERDICT, verdict, {"robot": "gr"}),
        (topics.COMMAND_REPLY, CommandReply(id=1, accepted=True), {}),
    ):
        key = topic.key(realm.description.cell, **fields)
        for sealed in traitor.traitor.says(key, pack(message)):
            with pytest.raises(ForgedMessageError, match="without the seal of sim"):
                realm._seal.open(key, sealed)
    traitor.close()


def test_a_service_of_another_authority_is_a_stranger(realm, tmp_path):
    """Of the same name, for a cell of the same name."""
    gate = Inside(realm.description, make(tmp_path / "others") / SIM)
    fr = realm.robots["fr"]
    realm.cycle({})
    gate.hear()
    before = fr.q.copy()
    for _ in range(CYCLES):
        realm.cycle({}, lambda: lie_to(realm, gate, fr, topics.ADMISSION, gate.admission(fr.state)))
    assert (fr.q == before).all()
    gate.close()


def test_one_key_says_nothing_in_a_realm_of_identities(realm):
    stranger = Stranger(realm.description)
    fr = realm.robots["fr"]
    for _ in range(CYCLES):
        realm.cycle({}, lambda: stranger.say(topics.SERVER_STATE, ghost(fr.state), robot="fr"))
    realm.pump_until(lambda: realm.sim.counters["forged_messages"])
    assert realm.sim.robots["fr"].tracker.state == fr.state
    stranger.close()
