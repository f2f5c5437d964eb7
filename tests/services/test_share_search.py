"""The search for the largest share: what it finds was certified in full, whatever was suspected."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_services.sim.certificate import HALVINGS, Certificate, Suspects, largest

REFUSED = 0.8
LEAST = REFUSED / 2**HALVINGS


class Judged:
    """Scales that are certified, and those that each suspect keeps apart at; both are written down."""

    def __init__(self, certified, *suspected):
        self._certified, self._suspected = certified, suspected
        self.certificates, self.suspects = [], []

    def certify(self, scale):
        self.certificates.append(scale)
        name = str(min(len(self.certificates), len(self._suspected) - 1))
        return Certificate(
            self._certified(scale), None, None if self._certified(scale) else Suspects(name, ())
        )

    def holds(self, scale, suspects):
        self.suspects.append([one.other for one in suspects])
        return all(self._suspected[int(one.other)](scale) for one in suspects)

    def largest(self):
        return largest(self.certify, self.holds, REFUSED, Certificate(False, None, Suspects("0", ())))


def up_to(greatest):
    return lambda scale: scale <= greatest


@pytest.mark.parametrize("greatest", [0.0, 0.025, 0.03, 0.3, 0.49, 0.79])
def test_the_largest_share_is_found_to_a_thirty_second_by_one_certificate(greatest):
    judged = Judged(up_to(greatest), up_to(greatest))
    assert greatest - LEAST <= judged.largest() <= greatest
    assert len(judged.certificates) == (1 if greatest >= LEAST else 0)


def test_where_suspects_are_refused_the_least_share_nothing_else_is_asked():
    judged = Judged(up_to(1.0), up_to(0.02))
    assert judged.largest() == 0.0
    assert (judged.certificates, len(judged.suspects)) == ([], 1)


def test_a_pair_that_nobody_suspected_is_from_then_on():
    judged = Judged(up_to(0.3), up_to(0.6), up_to(0.3))
    assert 0.3 - LEAST <= judged.largest() <= 0.3
    assert len(judged.certificates) == 2
    assert judged.suspects[0] == ["0"]
    assert judged.suspects[-1] == ["0", "1"]


def test_where_suspects_are_never_the_right_ones_the_least_share_is_tried():
    judged = Judged(up_to(LEAST), up_to(1.0))
    assert judged.largest() == LEAST
    assert judged.certificates[-1] == LEAST
    assert len(judged.certificates) == 4


def test_where_suspects_are_never_the_right_ones_the_least_share_has_to_be_certified_too():
    judged = Judged(up_to(0.0), up_to(1.0))
    assert judged.largest() == 0.0
    assert judged.certificates[-1] == LEAST


def test_where_nothing_stands_in_the_way_no_more_is_asked_for_than_was_refused():
    judged = Judged(up_to(1.0), up_to(1.0))
    assert REFUSED - LEAST <= judged.largest() < REFUSED


def test_what_is_refused_at_the_least_share_is_not_tried_again():
    judged = Judged(up_to(0.0), up_to(LEAST))
    assert judged.largest() == 0.0
    assert judged.certificates == [LEAST]


@given(st.frozensets(st.integers(1, 31)), st.lists(st.frozensets(st.integers(1, 31)), min_size=1, max_size=3))
def test_what_is_found_was_certified_and_below_what_was_refused(certified, suspected):
    def of(shares):
        return lambda scale: round(scale / LEAST) in shares

    judged = Judged(of(certified), *map(of, suspected))
    found = judged.largest()
    assert 0.0 <= found < REFUSED
    assert found == 0.0 or (found in judged.certificates and of(certified)(found))
    assert len(judged.certificates) <= 4
