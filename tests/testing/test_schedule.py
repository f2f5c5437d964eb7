"""Faults and their times: what is refused, and in which words."""

import pytest

from deltaq_testing.faults.catalogue import UnknownFaultError
from deltaq_testing.schedule import VIRTUAL, ScheduleError, checked, clash, fault


def test_an_unknown_fault_is_answered_with_similar_ones():
    with pytest.raises(
        UnknownFaultError, match=r"no fault 'hli-deadd'; did you mean 'hli-dead'\? `deltaq fault list`"
    ):
        fault("hli_deadd", at_s=1)


@pytest.mark.parametrize(
    ("name", "times", "told"),
    [
        ("hli_dead", {"at_s": -1}, r"hli-dead: at_s must be 0 or later, got -1"),
        ("hli_dead", {"at_s": float("nan")}, r"hli-dead: at_s must be 0 or later, got nan"),
        ("hli_dead", {"at_s": 1, "for_s": 0}, r"hli-dead: for_s must be more than 0, got 0"),
        ("hli_dead", {"at_s": 1, "for_s": float("inf")}, r"hli-dead: for_s must be more than 0, got inf"),
        ("recorder_dead", {"at_s": 1}, r"recorder-dead does not exist in virtual time"),
    ],
)
def test_an_impossible_fault_is_refused_with_value_and_bound(name, times, told):
    with pytest.raises(ScheduleError, match=told):
        fault(name, **times)


def test_a_fault_is_shown_as_it_is_typed():
    one = fault("link_cut", at_s=2, for_s=0.5)
    assert repr(one) == 'fault("controller-hli-cut", at_s=2, for_s=0.5)'
    assert eval(repr(one), {"fault": fault}) == one


def test_two_faults_on_one_part_must_not_overlap():
    cut, lossy = fault("link_cut", at_s=1, for_s=1), fault("link_lossy", at_s=1.5)
    with pytest.raises(
        ScheduleError, match=r"must start at 2 s or later: the link controller-hli still suffers"
    ):
        checked([lossy, cut])
    assert checked([fault("link_lossy", at_s=2), cut])[0] is cut
    assert clash([cut, fault("sim_dead", at_s=1.5)]) is None


def test_every_fault_except_a_stop_names_its_parts():
    assert {row.name for row in VIRTUAL if not fault(row.name, at_s=0).parts} == {"operator-stop"}
