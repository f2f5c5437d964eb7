"""Who is believed, in virtual time."""

import itertools

from deltaq_protocol.proof import Prover
from deltaq_services.hli.authentication import GOOD_FOR_S, Authentication, Challenges
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.leases import Leases
from deltaq_services.outputs import ClientOrigin

KEY, MESSAGE = "deltaq/lab/fr/lease", b"renew"


def bench(operator: str | None = "token") -> tuple[Leases, Authentication]:
    names = (f"secret-{k}" for k in itertools.count())
    leases = Leases(["fr", "gr"], 1.0, lambda: next(names), 1)
    return leases, Authentication(leases, ClientRoles(operator), "ours")


def test_the_request_of_a_holder_is_valid_once_and_in_order() -> None:
    leases, authentication = bench()
    prover = Prover(leases.grant("fr", ClientOrigin("x"), None, 0.0).token)
    first, second, third = (prover.prove_next(KEY, MESSAGE) for _ in range(3))
    assert authentication.holder("fr", KEY, MESSAGE, second) == "secret-0"
    assert [authentication.holder("fr", KEY, MESSAGE, proof) for proof in (first, second)] == [None, None]
    assert authentication.holder("gr", KEY, MESSAGE, third) is None
    assert authentication.holder("fr", KEY, MESSAGE, third) == "secret-0"


def test_a_proof_without_a_count_makes_no_request_and_one_with_a_count_no_increment() -> None:
    leases, authentication = bench()
    prover = Prover(leases.grant("fr", ClientOrigin("x"), None, 0.0).token)
    assert authentication.holder("fr", KEY, MESSAGE, prover.prove(KEY, MESSAGE)) is None
    assert authentication.holder_of_increment("fr", KEY, MESSAGE, prover.prove_next(KEY, MESSAGE)) is None


def test_counts_restart_with_each_lease_and_the_old_lease_is_invalid() -> None:
    leases, authentication = bench()
    old = leases.grant("fr", ClientOrigin("x"), None, 0.0)
    was = Prover(old.token)
    assert authentication.holder("fr", KEY, MESSAGE, was.prove(KEY, MESSAGE, (99).to_bytes(8, "big")))
    leases.end(old)
    now = Prover(leases.grant("fr", ClientOrigin("y"), None, 0.0).token)
    assert authentication.holder("fr", KEY, MESSAGE, now.prove_next(KEY, MESSAGE)) == "secret-1"
    assert (
        authentication.holder("fr", KEY, MESSAGE, was.prove(KEY, MESSAGE, (100).to_bytes(8, "big"))) is None
    )


def test_the_previous_holder_is_known_and_earlier_ones_are_not() -> None:
    leases, authentication = bench()
    provers = []
    for _ in range(3):
        lease = leases.grant("fr", ClientOrigin("x"), None, 0.0)
        provers.append(Prover(lease.token))
        leases.end(lease)
    leases.grant("fr", ClientOrigin("y"), None, 0.0)
    known = [
        authentication.holder_of_increment("fr", KEY, MESSAGE, prover.prove(KEY, MESSAGE))
        for prover in provers
    ]
    assert known == [None, None, ("secret-2", False)]


def test_a_challenge_is_valid_once_for_a_short_time_and_with_the_token() -> None:
    _, authentication = bench()
    operator, stranger = Prover("token"), Prover("guessed")
    challenge = authentication.challenge(10.0)
    assert authentication.token(KEY, MESSAGE, stranger.prove(KEY, MESSAGE, challenge), 10.0) is None
    answer = operator.prove(KEY, MESSAGE, challenge)
    assert authentication.token(KEY, MESSAGE, answer, 10.0 + GOOD_FOR_S) == "token"
    assert authentication.token(KEY, MESSAGE, answer, 10.0) is None
    late = operator.prove(KEY, MESSAGE, authentication.challenge(10.0))
    assert authentication.token(KEY, MESSAGE, late, 10.1 + GOOD_FOR_S) is None
    assert authentication.token(KEY, MESSAGE, operator.prove(KEY, MESSAGE, b"of mine"), 10.0) is None


def test_without_an_operators_token_no_client_proves_to_be_operator() -> None:
    _, authentication = bench(operator=None)
    challenge = authentication.challenge(0.0)
    assert authentication.token(KEY, MESSAGE, Prover("").prove(KEY, MESSAGE, challenge), 0.0) is None


def test_a_flood_of_challenges_invalidates_no_other_and_uses_no_memory() -> None:
    challenges = Challenges("ours")
    mine = challenges.new(0.0)
    assert len({challenges.new(0.0) for _ in range(10_000)}) == 10_000
    assert challenges.accept(mine, 1.0)
    assert not challenges.accept(mine, 1.0)
    assert not Challenges("another").accept(challenges.new(1.0), 1.0)
    assert not challenges.accept(challenges.new(0.0), GOOD_FOR_S + 0.1)
    assert challenges._used == {}


def test_a_replayed_request_of_a_holder_goes_first_once_only() -> None:
    leases, authentication = bench()
    prover = Prover(leases.grant("fr", ClientOrigin("x"), None, 0.0).token)
    first, second, third = (prover.prove_next(KEY, MESSAGE) for _ in range(3))
    assert [authentication.goes_first(KEY, MESSAGE, proof, 0.0) for proof in (second, first, third)] == [
        True
    ] * 3
    assert not any(authentication.goes_first(KEY, MESSAGE, proof, 0.0) for proof in (first, second, third))
    # what zenoh's threads have heard is not taken up yet
    assert authentication.holder("fr", KEY, MESSAGE, first) == "secret-0"
    # and a lease that ended leaves nothing behind
    leases.grant("fr", ClientOrigin("y"), None, 0.0)
    assert not authentication.goes_first(KEY, MESSAGE, prover.prove_next(KEY, MESSAGE), 0.0)
    assert list(authentication._heard_counts) == ["secret-1"]


def test_an_overheard_request_of_the_operator_goes_first_once_and_none_does_when_it_is_late() -> None:
    _, authentication = bench()
    prover = Prover("token")
    proof = prover.prove(KEY, MESSAGE, authentication.challenge(0.0))
    late = prover.prove(KEY, MESSAGE, authentication.challenge(0.0))
    assert authentication.goes_first(KEY, MESSAGE, proof, 0.0)
    assert not authentication.goes_first(KEY, MESSAGE, proof, 0.0)
    assert not authentication.goes_first(KEY, MESSAGE, late, GOOD_FOR_S + 0.1)
    assert not authentication.goes_first(KEY, MESSAGE, prover.prove(KEY, MESSAGE), 0.0)
    assert authentication.token(KEY, MESSAGE, proof, 0.0) == "token"
