"""The guarded realm over TLS: who has no identity is not let in, and each service is heard under its own keys."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from identities import make
from lockstep_realm import LockstepRealm

from deltaq_protocol import topics
from deltaq_protocol.certified.names import CLIENT_IDENTITY, IDENTITY
from deltaq_protocol.codec import pack
from deltaq_protocol.envelope import Envelopes
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.guarded import Supervision
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.sayings import HLI, SIM, robot_server, sayings
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Party
from deltaq_services.guarded_realm import (
    GuardedRealmError,
    guarded_links,
    open_guarded_session,
    open_watching_session,
)
from deltaq_services.service_identity import tls_settings

pytestmark = pytest.mark.long

STEP, CYCLES = 1e-4, 10


@pytest.fixture
def folder(tmp_path, monkeypatch):
    folder = make(tmp_path / "identities", people=("operator-desk",))
    monkeypatch.setenv(IDENTITY, str(folder))
    return folder


@pytest.fixture
def realm(tmp_path, folder, lasting_links):
    realm = LockstepRealm(tmp_path, encrypted_at="127.0.0.1")
    yield realm
    realm.close()


class Intruder:
    """Somebody with an identity of the cell, who says what others say, in envelopes of its own."""

    def __init__(self, realm, folder, name):
        cell = self.cell = realm.description
        self.robots = tuple(cell.robots)
        links = list(guarded_links(cell).values())
        tls = tls_settings(cell, folder / name, name, only_watches=True)
        self._session = open_session(connect=links, must_connect=True, tls=tls)

    def say(self, saying, message):
        envelopes = Envelopes(saying.speaker, self.cell.cell, self.robots)
        self._session.put(saying.key, envelopes.close(saying.key, message))

    def close(self):
        self._session.close()


def heard_by(realm):
    """What reaches the gate and the Robot Servers, and is still to be judged: keys and bytes."""
    heard = []

    def watch(session):
        heard_there = []
        session.declare_subscriber(
            "deltaq-guarded/**",
            lambda sample: heard_there.append((str(sample.key_expr), sample.payload.to_bytes())),
        )
        heard.append(heard_there)

    for session in (realm.shell._session, *(robot.link._session for robot in realm.robots.values())):
        watch(session)
    return heard


def test_the_encrypted_cell_moves_and_no_message_is_refused(realm):
    realm.assert_moves(CYCLES, STEP)


def test_services_that_start_again_find_one_another(realm):
    fr = realm.restart("fr")
    realm.restart_gate()
    realm.settle_held()
    assert realm.sim.robots["fr"].tracker.state.process == fr.core.process


def test_peers_without_an_identity_of_the_cell_are_refused(realm, tmp_path):
    others = make(tmp_path / "others")
    identities = (None, tls_settings(realm.description, others, "hli"))
    with ThreadPoolExecutor() as pool:
        tried = [
            pool.submit(open_session, connect=[link], must_connect=True, tls=tls)
            for tls in identities
            for link in guarded_links(realm.description).values()
        ]
        for one in tried:
            with pytest.raises(ServiceUnreachableError):
                one.result()


@pytest.mark.parametrize("name", [robot_server("fr"), HLI, "operator-desk"])
def test_an_intruder_can_publish_only_under_its_own_keys(realm, folder, name):
    """Whoever has broken into one service, or has a person's identity, says each message of the table once a cycle."""
    intruder = Intruder(realm, folder, name)
    table = sayings(realm.description.cell, tuple(realm.robots))
    lie = b"a lie under "
    arrived = heard_by(realm)
    q = {robot.name: robot.q.copy() for robot in realm.robots.values()}
    own = [saying.key for saying in table if saying.speaker == name]
    last = own[-1] if own else None

    def lies():
        return {key for session in arrived for key, payload in session if lie in payload}

    for turn in range(200):
        for saying in table:
            if saying.key != last:
                intruder.say(saying, lie + saying.key.encode())
        if last is not None:  # after all others, over the same links
            intruder.say(next(saying for saying in table if saying.key == last), lie + last.encode())
        realm.turn()
        if last in lies() or (last is None and turn > 100):
            break
    assert lies() <= set(own)
    assert last is None or last in lies()
    for robot in realm.robots.values():
        assert (robot.q == q[robot.name]).all()
        assert robot.core.counters["admissions"] == 0
    intruder.close()


def test_the_identity_of_the_gate_may_order_a_stop(realm, folder):
    """The same message under the right identity arrives, so that what the others were denied was a message."""
    gate = Intruder(realm, folder, SIM)
    fr = realm.robots["fr"]
    arrived = heard_by(realm)
    order = pack(Supervision(robot="fr", epoch=1, cycle=1, stop=ReasonCode.OPERATOR_STOP))
    saying = next(
        saying
        for saying in sayings(realm.description.cell, tuple(realm.robots))
        if saying.key == topics.SUPERVISION.key(realm.description.cell, robot="fr")
    )
    while not any(order in payload for session in arrived for _, payload in session):
        gate.say(saying, order)
        realm.turn()
    assert fr.core.counters["admissions"] == 0
    gate.close()


def test_an_observer_may_use_the_identity_of_a_person(realm, folder, monkeypatch):
    monkeypatch.delenv(IDENTITY)
    with pytest.raises(GuardedRealmError, match="is encrypted, and DELTAQ_IDENTITY names no identity"):
        open_watching_session(realm.description, SIM)
    monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "operator-desk"))
    session = open_watching_session(realm.description, robot_server("fr"))
    subscriber = session.declare_subscriber("deltaq-guarded/**")
    heard = ""
    while not heard.endswith("/state"):
        realm.turn()  # nothing comes of a turn before the others know that somebody listens
        sample = subscriber.try_recv()
        heard = "" if sample is None else str(sample.key_expr)
    session.close()


def test_a_service_cannot_publish_with_the_identity_of_a_person(realm, folder, monkeypatch):
    monkeypatch.delenv(IDENTITY)
    monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "operator-desk"))
    with pytest.raises(GuardedRealmError, match="DELTAQ_IDENTITY names no identity"):
        open_guarded_session(realm.description, Party.HLI, HLI, connect=[SIM])
