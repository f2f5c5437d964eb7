"""Proofs: any bit of secret, key, message and nonce counts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.proof import COUNT_BYTES, MAC_BYTES, MAX_PROOF_BYTES, Prover, key_of, proven_nonce

KEY, MESSAGE = "deltaq/lab/fr/increment", b"\x81\xa4type"


def test_a_proof_is_valid_only_with_the_right_secret() -> None:
    proof = Prover("secret").prove(KEY, MESSAGE, b"nonce")
    assert proven_nonce(key_of("secret"), KEY, MESSAGE, proof) == b"nonce"
    assert proven_nonce(key_of("Secret"), KEY, MESSAGE, proof) is None
    assert proven_nonce(key_of("secret"), KEY.replace("fr", "gr"), MESSAGE, proof) is None
    assert proven_nonce(key_of("secret"), KEY, MESSAGE + b"\0", proof) is None
    assert b"secret" not in proof


@given(bit=st.integers(0, 8 * (MAC_BYTES + 5) - 1))
def test_no_bit_of_a_proof_can_be_changed(bit: int) -> None:
    proof = bytearray(Prover("secret").prove(KEY, MESSAGE, b"nonce"))
    proof[bit // 8] ^= 1 << bit % 8
    assert proven_nonce(key_of("secret"), KEY, MESSAGE, bytes(proof)) is None


@given(proof=st.binary(max_size=2 * MAX_PROOF_BYTES))
def test_an_invalid_proof_shows_no_nonce(proof: bytes) -> None:
    assert proven_nonce(key_of("secret"), KEY, MESSAGE, proof) is None


@pytest.mark.parametrize("moved", [("nonced", "eltaq", b"x"), ("n", "onced", b"eltaqx")])
def test_moving_bytes_between_nonce_key_and_message_invalidates_a_proof(
    moved: tuple[str, str, bytes],
) -> None:
    proof = Prover("secret").prove("deltaq", b"x", b"nonce")
    nonce, key, message = moved
    assert proven_nonce(key_of("secret"), key, message, proof[:MAC_BYTES] + nonce.encode()) is None


def test_requests_are_counted() -> None:
    prover = Prover("secret")
    nonces = [proven_nonce(key_of("secret"), KEY, MESSAGE, prover.prove_next(KEY, MESSAGE)) for _ in range(3)]
    assert nonces == [count.to_bytes(COUNT_BYTES, "big") for count in (1, 2, 3)]


def test_a_lone_surrogate_is_a_valid_secret() -> None:
    assert proven_nonce(key_of("\ud800"), KEY, MESSAGE, Prover("\ud800").prove(KEY, MESSAGE)) == b""
