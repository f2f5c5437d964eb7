"""The guarded realm over TLS: who has no identity of the cell is not there, each is heard under its own keys."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from identities import Traitor, make
from sealed_realm import SealedRealm
from stranger import ghost

from deltaq_protocol import topics
from deltaq_protocol.certified.names import CLIENT_IDENTITY, IDENTITY
from deltaq_protocol.codec import pack
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.sayings import HLI, robot_server, sayings
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Party
from deltaq_services.guarded_key import KEY_FILE, GuardedKeyError
from deltaq_services.guarded_session import open_guarded_session, open_watching_session
from deltaq_services.service_identity import tls_settings

STEP, CYCLES = 1e-4, 10


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv(KEY_FILE)
    folder = make(tmp_path / "identities", people=("operator-desk",))
    monkeypatch.setenv(IDENTITY, str(folder))
    return folder


@pytest.fixture
def realm(tmp_path, folder, lasting_links):
    realm = SealedRealm(tmp_path, transport="tls")
    yield realm
    realm.close()


def endpoints(realm):
    cell = realm.description
    return [cell.sim, *(robot.server for robot in cell.robots.values())]


@pytest.mark.long
def test_the_realm_moves_and_nothing_is_refused(realm):
    realm.assert_moves(CYCLES, STEP)


@pytest.mark.long
def test_who_has_no_identity_or_one_of_another_authority_is_not_let_in(realm, tmp_path):
    others = make(tmp_path / "others")
    identities = (None, tls_settings(realm.description, others, "hli"))
    with ThreadPoolExecutor() as pool:
        tried = [
            pool.submit(open_session, connect=[endpoint], must_connect=True, tls=tls)
            for tls in identities
            for endpoint in endpoints(realm)
        ]
        for one in tried:
            with pytest.raises(ServiceUnreachableError):
                one.result()
    assert realm.sim.counters["forged_messages"] == 0


@pytest.mark.long
def test_who_has_one_robot_server_is_not_even_heard_in_another_s_place(realm, folder):
    """What it may say arrives, and is judged by its seal; what others say does not arrive."""
    cell = realm.description
    traitor = Traitor(folder / robot_server("fr"), cell.cell, tuple(cell.robots))
    session = open_session(
        connect=[cell.sim], must_connect=True, tls=tls_settings(cell, folder, robot_server("fr"))
    )
    own, other = (topics.SERVER_STATE.key(cell.cell, robot=robot) for robot in ("fr", "gr"))
    command = topics.COMMAND.key(cell.cell)
    state = pack(ghost(realm.robots["gr"].state))
    heard = []
    handle = realm.shell._handle
    realm.shell._handle = lambda key, payload: (heard.append((key, payload)), handle(key, payload))
    last = b"no seal at all"
    while (own, last) not in heard:
        for key in (other, command):
            for sealed in traitor.says(key, state):
                session.put(key, sealed)
        session.put(own, last)  # after all others, over the same link
        realm.turn()
    assert realm.sim.counters["forged_messages"] >= 1
    said = {sealed[-len(state) :] for key, sealed in heard if key in (other, command)}
    assert state not in said
    session.close()


@pytest.mark.long
def test_who_watches_may_do_so_with_a_person_s_identity(realm, folder, monkeypatch):
    monkeypatch.delenv(IDENTITY)
    with pytest.raises(GuardedKeyError, match="is encrypted, and DELTAQ_IDENTITY names no identity"):
        open_watching_session(realm.description, endpoints(realm))
    monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "operator-desk"))
    session = open_watching_session(realm.description, endpoints(realm))
    subscriber = session.declare_subscriber("deltaq-guarded/**")
    heard = ""
    while not heard.endswith("/state"):
        realm.turn()  # nothing comes of a turn before the others know that somebody listens
        sample = subscriber.try_recv()
        heard = "" if sample is None else str(sample.key_expr)
    session.close()


@pytest.mark.long
def test_a_person_is_heard_under_no_key(realm, folder):
    cell = realm.description
    session = open_session(
        connect=[cell.sim], must_connect=True, tls=tls_settings(cell, folder, "operator-desk")
    )
    for saying in sayings(cell.cell, tuple(cell.robots)):
        session.put(saying.key, b"no seal at all")
    for _ in range(100):  # many times as long as a message takes
        realm.turn()
    assert realm.sim.counters["forged_messages"] == 0
    session.close()


def test_a_service_does_not_speak_under_a_person_s_identity(realm, folder, monkeypatch):
    monkeypatch.delenv(IDENTITY)
    monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "operator-desk"))
    with pytest.raises(GuardedKeyError, match="DELTAQ_IDENTITY names no identity"):
        open_guarded_session(realm.description, Party.HLI, HLI, connect=endpoints(realm))
