"""Seals under identities: each service is believed what the table has it say, and nothing else, with any key."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from identities import ROBOTS, Traitor, make

from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.sayings import sayings, services
from deltaq_protocol.seal import MAC_BYTES, ForgedMessageError, Seal, UnboundMessageError
from deltaq_protocol.seal_keys import PairKeys, pair_key

CELL = "lab"
SERVICES = services(ROBOTS)
TABLE = sayings(CELL, ROBOTS)
ROWS = {row.key: row for row in TABLE}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make(tmp_path_factory.mktemp("identities") / "lab")


@pytest.fixture(scope="module")
def keys(folder):
    return {name: keys_of(folder / name) for name in SERVICES}


def keys_of(folder):
    identity = Identity.read(folder, now_utc())
    secrets = {name: identity.secret_with(name, now_utc()) for name in SERVICES}
    return PairKeys(identity.name, CELL, ROBOTS, secrets)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.key)
def test_what_a_service_says_is_read_by_those_it_is_said_to_and_by_nobody_else(keys, row):
    sealed = Seal(keys[row.speaker]).close(row.key, b"said")
    for name in SERVICES:
        seal = Seal(keys[name])
        if name in row.listeners:
            assert seal.read(row.key, sealed) == b"said"
            with pytest.raises(UnboundMessageError):
                seal.open(row.key, sealed)
        else:
            with pytest.raises(ForgedMessageError, match="nothing is said there to this identity"):
                seal.read(row.key, sealed)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.key)
def test_nobody_speaks_where_the_table_has_another_speak(keys, row):
    for name in SERVICES:
        if name != row.speaker:
            with pytest.raises(ValueError, match=f"{name} says nothing under {row.key}"):
                Seal(keys[name]).close(row.key, b"said")


def deceived(keys, traitor, row, liar):
    """Who believes what somebody says in another's place, with any of its keys."""
    return {
        name
        for name in row.listeners
        for sealed in traitor.says(row.key, b"lie")
        if believes(Seal(keys[name]), row.key, sealed) and name != liar
    }


def believes(seal, key, sealed):
    try:
        return seal.read(key, sealed) == b"lie"
    except ForgedMessageError:
        return False


@pytest.mark.parametrize("liar", SERVICES)
def test_who_has_an_identity_is_believed_what_that_one_may_say_and_nothing_that_others_say(
    keys, folder, liar
):
    traitor = Traitor(folder / liar)
    for row in TABLE:
        others = set(row.listeners) - {liar}
        assert deceived(keys, traitor, row, liar) == (others if row.speaker == liar else set())


@given(st.data())
def test_whatever_bit_is_changed_or_left_out_its_listener_refuses_it(keys, data):
    row = data.draw(st.sampled_from(TABLE))
    sealed = bytearray(Seal(keys[row.speaker]).close(row.key, b"message"))
    name = data.draw(st.sampled_from(row.listeners))
    at = row.listeners.index(name) * MAC_BYTES
    # MACs of other listeners are theirs to check
    own = [*range(at, at + MAC_BYTES), *range(MAC_BYTES * len(row.listeners), len(sealed))]
    sealed[data.draw(st.sampled_from(own))] ^= 1 << data.draw(st.integers(0, 7))
    seal = Seal(keys[name])
    with pytest.raises(ForgedMessageError, match=f"without the seal of {row.speaker}"):
        seal.read(row.key, bytes(sealed))
    with pytest.raises(ForgedMessageError):
        seal.read(row.key, bytes(sealed)[: data.draw(st.integers(0, len(sealed) - 1))])


def test_nobody_ends_the_process_of_another_service_by_saying_its_number(keys):
    """The attack: numbers of processes are no secret; who has one identity speaks as that one, then as another."""
    sim, hli, gr = (Seal(keys[name]) for name in ("sim", "hli", "robot-server-gr"))
    command, state = "deltaq-guarded/lab/command", "deltaq-guarded/lab/gr/state"
    for seal, name in ((hli, "hli"), (gr, "robot-server-gr")):
        key = f"deltaq-guarded/lab/greeting/{name}"
        sim.meet(key, seal.close(key, b""))
    greeting = sim.greet("deltaq-guarded/lab/greeting/sim", b"")
    for seal in (hli, gr):
        assert seal.meet("deltaq-guarded/lab/greeting/sim", greeting)
    assert sim.open(command, hli.close(command, b"first")) == b"first"
    own, gr._process = gr._process, hli._process
    sim.open(state, gr.close(state, b"as the process of the HLI"))
    gr._process = own
    sim.open(state, gr.close(state, b"as its own"))
    assert sim.open(command, hli.close(command, b"second")) == b"second"


def test_what_is_said_under_one_key_says_nothing_under_another_of_the_same_speaker(keys):
    for here, there in itertools.permutations(TABLE, 2):
        if here.speaker == there.speaker and here.listeners == there.listeners:
            sealed = Seal(keys[here.speaker]).close(here.key, b"said")
            with pytest.raises(ForgedMessageError):
                Seal(keys[there.listeners[0]]).read(there.key, sealed)


def test_the_same_names_have_other_keys_under_another_authority(keys, tmp_path):
    theirs = keys_of(make(tmp_path / "again") / "sim")
    sealed = Seal(theirs).close("deltaq-guarded/lab/fr/admission", b"said")
    with pytest.raises(ForgedMessageError, match="without the seal of sim"):
        Seal(keys["robot-server-fr"]).read("deltaq-guarded/lab/fr/admission", sealed)


NAMES = st.lists(st.text(max_size=6), min_size=3, max_size=3)


@given(NAMES, NAMES)
def test_a_key_is_of_one_cell_and_of_one_direction(one, other):
    secret = bytes(32)
    assert (pair_key(secret, *one) == pair_key(secret, *other)) == (one == other)
