"""Equal deeds are counted, so that a flood of refused attempts fills no disk."""

from __future__ import annotations

from collections import Counter

import pytest

from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.audit import (
    LONGEST_QUIET_S,
    MANY,
    MOST_BYTES,
    MOST_FILES,
    MOST_GROUPS,
    NEW_GROUPS_S,
    CountedDeed,
    DeedGroups,
)
from deltaq_services.hli.commands import Deed
from deltaq_services.outputs import ClientOrigin


def refused(client: str = "stranger", address: str = "10.0.0.9:4711", role: str = "observer") -> Deed:
    origin = ClientOrigin(client, address, role)
    return Deed(
        AuditKind.LEASE_REFUSED, AuditOutcome.REFUSED, origin, "fr", ReasonCode.NOT_PERMITTED, "acquire"
    )


def flooded(groups: DeedGroups, deeds: list[Deed], each_s: float) -> list[CountedDeed]:
    """What is told of deeds that come one by one, the rest included."""
    told: list[CountedDeed] = []
    for number, deed in enumerate(deeds):
        now_s = number * each_s
        told += groups.add(deed, now_s) + groups.due(now_s)
    return told + groups.rest()


def test_a_flood_of_equal_attempts_is_a_few_lines_and_none_goes_uncounted() -> None:
    told = flooded(DeedGroups(), [refused()] * 100_000, each_s=0.001)
    assert sum(counted.count for counted in told) == 100_000
    assert len(told) <= 10  # 100 s: at 0, 1, 3, 7, 15, 31, 61, 91, and the rest


def test_who_connects_again_each_time_is_one_group_and_the_newest_port_is_told() -> None:
    deeds = [refused(address=f"[fe80::1]:{port}") for port in range(10_000, 20_000)]
    told = flooded(DeedGroups(), deeds, each_s=0.00005)
    assert [counted.count for counted in told] == [1, 9_999]
    assert told[-1].deed.origin.address == "[fe80::1]:19999"


@pytest.mark.long
def test_a_flood_of_invented_names_is_bounded_and_counted_and_takes_no_line_from_others() -> None:
    groups = DeedGroups()
    strangers = [refused(client=f"stranger-{number}") for number in range(100_000)]
    told = flooded(groups, strangers, each_s=0.001)
    assert sum(counted.count for counted in told) == 100_000
    assert len(told) < 2 * MOST_GROUPS + 2 * 100 * NEW_GROUPS_S + 10
    assert {counted.deed.origin.client for counted in told} >= {"stranger-0", MANY}
    (operator,) = groups.add(refused("the operator", role="operator"), 100.0)
    assert operator.deed.origin.client == "the operator"
    stop = Deed(AuditKind.STOP, AuditOutcome.ASKED, ClientOrigin("stranger-0", "10.0.0.9:4711", "observer"))
    assert groups.add(stop, 100.0) == [CountedDeed(stop, 100.0, 1)]


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize("names", [1, MOST_GROUPS, 10 * MOST_GROUPS, 10_000])
def test_the_worst_flood_of_a_kind_drives_no_entry_out_of_the_files_within_hours(names: int) -> None:
    hours, each_s = 1.0, 0.02
    groups, lines = DeedGroups(), 0
    for number in range(int(hours * 3600 / each_s)):
        now_s = number * each_s
        told = groups.add(refused(f"stranger-{number % names}"), now_s) + groups.due(now_s)
        lines += len(told)
    line_bytes, kinds = 400, 15
    assert lines / hours * line_bytes * kinds < MOST_BYTES * MOST_FILES / 8.0  # a shift of eight hours


def test_each_setting_of_an_output_is_counted_by_what_was_set() -> None:
    groups, told = DeedGroups(), list[CountedDeed]()
    origin = ClientOrigin("driver", "10.0.0.7:1", "controller")
    for number in range(1000):
        text = "gripper on" if number % 2 else "gripper off"
        deed = Deed(AuditKind.OUTPUTS, AuditOutcome.DONE, origin, "gr", text=text)
        told += groups.add(deed, number * 0.1) + groups.due(number * 0.1)
    counts: Counter[str] = Counter()
    for counted in told + groups.rest():
        counts[counted.deed.text] += counted.count
    assert counts == {"gripper on": 500, "gripper off": 500}


def test_what_differs_is_told_apart_and_at_once() -> None:
    groups, deeds = DeedGroups(), [refused(), refused("another"), refused(address="10.0.0.8:1")]
    assert [groups.add(deed, 0.0)[0].deed for deed in deeds] == deeds


def test_what_comes_once_is_told_once_and_again_after_the_second() -> None:
    groups = DeedGroups()
    assert groups.add(refused(), 0.0)
    assert groups.due(1.5) == []
    assert groups.add(refused(), 2.0) == [CountedDeed(refused(), 2.0, 1)]


def test_an_entry_of_many_has_the_time_of_the_newest() -> None:
    groups = DeedGroups()
    groups.add(refused(), 0.0)
    groups.add(refused(), 0.4, count=7)
    assert groups.due(0.9) == []
    assert groups.due(1.2) == [CountedDeed(refused(), 0.4, 7)]


def test_nothing_is_kept_of_strangers_who_have_gone() -> None:
    groups = DeedGroups()
    flooded(groups, [refused(client=str(number)) for number in range(1000)], each_s=0.001)
    assert groups.due(2 * LONGEST_QUIET_S) == []
    counts: Counter[str] = Counter(counted.deed.origin.client for counted in groups.rest())
    assert not counts
