"""Clients that prove role and name by a certificate: once, soon, for one request, under the cell's authority alone."""

import itertools
from datetime import timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from hypothesis import given
from hypothesis import strategies as st
from signed_clients import known_to, people

from deltaq_protocol.certified.authority import Authority
from deltaq_protocol.certified.certificate import check_issued, now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.certified.names import IdentityError
from deltaq_protocol.certified.signed import MAX_SIGNED_BYTES, IdentityProver, Signed
from deltaq_protocol.codec import MAX_MESSAGE_BYTES
from deltaq_protocol.proof import MAX_PROOF_BYTES, Prover
from deltaq_protocol.topic import ClientRole
from deltaq_services.hli.authentication import GOOD_FOR_S, Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.leases import Leases

KEY, MESSAGE = "deltaq/small/fr/lease", b"take"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return people(tmp_path_factory.mktemp("identities") / "small")


def bench(folder, now=now_utc):
    names = (f"secret-{k}" for k in itertools.count())
    leases = Leases(["fr"], 1.0, lambda: next(names), 1)
    return Authentication(leases, ClientRoles("token"), "ours", known_to(folder, now))


def forged(name, folder):
    """Who has a service's identity makes itself an authority, and signs with what that one issued."""
    identity = Identity.read(folder / "robot-server-fr", now_utc())
    key, certificate = Authority(identity.key, identity.authority).issue(name, now_utc())
    prover = IdentityProver(folder / "operator-desk")
    prover._key, prover._certificate = key, certificate.public_bytes(Encoding.DER)
    return prover


def test_a_name_is_proven_once_in_answer_to_a_challenge(folder):
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    proof = desk.prove(KEY, MESSAGE, server.challenge(10.0))
    assert server.goes_first(KEY, MESSAGE, proof, 10.0)
    assert not server.goes_first(KEY, MESSAGE, proof, 10.0), "whoever overheard it waits with the strangers"
    assert server.identity(KEY, MESSAGE, proof, 10.0 + GOOD_FOR_S) == "operator-desk"
    assert server.identity(KEY, MESSAGE, proof, 10.0) == ""
    tower = IdentityProver(folder / "controller-tower")
    assert (
        server.identity(KEY, MESSAGE, tower.prove(KEY, MESSAGE, server.challenge(0.0)), 1.0)
        == "controller-tower"
    )


def test_a_late_proof_or_one_without_a_challenge_is_invalid(folder):
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    late = desk.prove(KEY, MESSAGE, server.challenge(10.0))
    assert server.identity(KEY, MESSAGE, late, 10.1 + GOOD_FOR_S) == ""
    for nonce in (b"", b"of mine", bench(folder).challenge(0.0)[:-1] + b"x"):
        proof = desk.prove(KEY, MESSAGE, nonce)
        assert server.identity(KEY, MESSAGE, proof, 0.0) == ""
        assert not server.goes_first(KEY, MESSAGE, proof, 10.0)


@pytest.mark.parametrize(
    ("key", "message"), [(KEY + "s", MESSAGE), (KEY, MESSAGE + b"s"), (KEY + "t", b"ake")]
)
def test_a_signature_is_of_one_request(folder, key, message):
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    proof = desk.prove(KEY, MESSAGE, server.challenge(0.0))
    assert server.identity(key, message, proof, 0.0) == ""
    assert server.identity(KEY, MESSAGE, proof, 0.0) == "operator-desk", "nobody has used its challenge up"


@pytest.mark.long
@given(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 7), st.floats(0.0, 1.0, exclude_max=True))
def test_a_proof_with_any_changed_or_missing_bit_is_invalid(folder, place, bit, end):
    # the length of a signature is one thing and another
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    proof = bytearray(desk.prove(KEY, MESSAGE, server.challenge(0.0)))
    proof[int(place * len(proof))] ^= 1 << bit
    assert server.identity(KEY, MESSAGE, bytes(proof), 0.0) == ""
    part = bytes(proof)[: int(end * len(proof))]
    assert server.identity(KEY, MESSAGE, part, 0.0) == ""
    assert not server.goes_first(KEY, MESSAGE, part, 0.0)


def test_a_certificate_has_one_valid_encoding():
    """Where the signature's last bit is clear, other bytes could say that this bit is none of it."""
    authority = Authority.new("small", now_utc())
    while (certificate := authority.issue("operator-desk", now_utc())[1]).signature[-1] & 1:
        continue
    check_issued(certificate, authority.certificate, "it", now_utc())
    spelled = bytearray(certificate.public_bytes(Encoding.DER))
    spelled[-len(certificate.signature) - 1] = 1  # bits of the last byte that are not used
    same = x509.load_der_x509_certificate(bytes(spelled))
    assert same.signature == certificate.signature
    with pytest.raises(IdentityError, match="not issued by"):
        check_issued(same, authority.certificate, "it", now_utc())


@given(st.binary(max_size=MAX_SIGNED_BYTES + 10))
def test_forged_bytes_are_not_authenticated(folder, proof):
    server = bench(folder)
    assert server.identity(KEY, MESSAGE, proof, 0.0) == ""
    assert not server.goes_first(KEY, MESSAGE, proof, 10.0)


@given(
    st.binary(min_size=20, max_size=80),
    st.binary(min_size=20, max_size=80),
    st.binary(min_size=200, max_size=900),
)
def test_a_signed_proof_survives_a_round_trip(signature, nonce, certificate):
    signed = Signed(signature, nonce, certificate)
    assert Signed.parse(signed.pack()) == signed


def test_an_identity_of_another_cells_authority_is_invalid(folder, tmp_path):
    server, other = bench(folder), people(tmp_path / "other")
    proof = IdentityProver(other / "operator-desk").prove(KEY, MESSAGE, server.challenge(0.0))
    assert server.identity(KEY, MESSAGE, proof, 0.0) == ""


def test_the_identity_of_a_service_proves_no_operator(folder):
    server = bench(folder)
    proof = forged("operator-desk", folder).prove(KEY, MESSAGE, server.challenge(0.0))
    assert server.identity(KEY, MESSAGE, proof, 0.0) == ""
    with pytest.raises(IdentityError, match="is the identity of robot-server-fr, a service; clients have"):
        IdentityProver(folder / "robot-server-fr")
    # nor does its own certificate make it one
    prover, own = (
        IdentityProver(folder / "operator-desk"),
        Identity.read(folder / "robot-server-fr", now_utc()),
    )
    prover._key, prover._certificate = own.key, own.certificate.public_bytes(Encoding.DER)
    assert server.identity(KEY, MESSAGE, prover.prove(KEY, MESSAGE, server.challenge(0.0)), 0.0) == ""


def test_a_foreign_certificate_is_invalid_without_its_key(folder):
    server = bench(folder)
    tower, desk = IdentityProver(folder / "controller-tower"), IdentityProver(folder / "operator-desk")
    tower._certificate = desk._certificate
    assert server.identity(KEY, MESSAGE, tower.prove(KEY, MESSAGE, server.challenge(0.0)), 0.0) == ""


def test_a_certificate_that_expires_while_the_hli_runs_becomes_invalid(folder):
    clock = [now_utc()]
    server, desk = bench(folder, lambda: clock[0]), IdentityProver(folder / "operator-desk")
    before = desk.prove(KEY, MESSAGE, server.challenge(0.0))
    assert server.identity(KEY, MESSAGE, before, 0.0) == "operator-desk"
    clock[0] += timedelta(days=731)
    assert server.identity(KEY, MESSAGE, desk.prove(KEY, MESSAGE, server.challenge(0.0)), 0.0) == ""


def test_tokens_and_identities_are_never_confused(folder):
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    challenge = server.challenge(0.0)
    by_token, signed = Prover("token").prove(KEY, MESSAGE, challenge), desk.prove(KEY, MESSAGE, challenge)
    assert len(by_token) <= MAX_PROOF_BYTES < len(signed) <= MAX_SIGNED_BYTES
    assert server.identity(KEY, MESSAGE, by_token, 0.0) == ""
    assert server.token(KEY, MESSAGE, signed, 0.0) is None
    assert server.token(KEY, MESSAGE, by_token, 0.0) == "token"


def test_a_message_that_is_too_long_is_not_authenticated(folder):
    server, desk = bench(folder), IdentityProver(folder / "operator-desk")
    long = bytes(MAX_MESSAGE_BYTES + 1)
    proof = desk.prove(KEY, long, server.challenge(0.0))
    assert server.identity(KEY, long, proof, 0.0) == ""
    assert not server.goes_first(KEY, long, proof, 0.0)


def test_a_flood_of_certificates_uses_no_memory_and_verifies_no_signature(folder):
    server = bench(folder)
    prover = forged("operator-desk", folder)
    for _ in range(20):
        server.identity(KEY, MESSAGE, prover.prove(KEY, MESSAGE, server.challenge(0.0)), 0.0)
    assert server._identities._known == {}


@pytest.mark.parametrize(
    ("token", "identity", "role"),
    [
        (None, "", ClientRole.OBSERVER),
        (None, "controller-tower", ClientRole.CONTROLLER),
        (None, "operator-desk", ClientRole.OPERATOR),
        (None, "robot-server-fr", ClientRole.OBSERVER),
        ("operator", "controller-tower", ClientRole.OPERATOR),
        ("controller", "operator-desk", ClientRole.OPERATOR),
    ],
)
def test_the_role_is_the_greater_of_those_that_token_and_identity_prove(token, identity, role):
    assert ClientRoles("operator", "controller").of(token, identity) is role
