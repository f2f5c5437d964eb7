"""Equal deeds are one entry with a count, so that a flood of them fills no disk. Plain decisions.

The first of a group is told at once, those that follow are counted: until a second is over, and, while they keep
coming, until 2, 4, 8, 16 and then 30 seconds are. Of one kind, outcome and role so many groups are told apart; whatever
is beyond them goes into one. So nobody soon drives the entries of others out of the files by inventing names.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.deeds import Deed
from deltaq_services.outputs import ClientOrigin
from deltaq_services.rate_limit import RateLimit

QUIET_S = 1.0
LONGEST_QUIET_S = 30.0
MOST_GROUPS = 20
"""Groups of one kind, outcome and role that are told apart at a time."""
NEW_GROUPS_S = 0.2
"""Of these, new ones a second; at once there may be as many as at a time."""
MANY = "more than can be told apart"
"""The client of what is beyond."""


@dataclass(frozen=True, slots=True)
class CountedDeed:
    """The newest of some equal deeds, when it was [s], and how many they are."""

    deed: Deed
    time_s: float
    count: int


class _Key(NamedTuple):
    what: AuditKind
    outcome: AuditOutcome
    code: ReasonCode | None
    robot: str | None
    client: str
    host: str
    role: str
    identity: str
    text: str


_Kind = tuple[AuditKind, AuditOutcome, str]


@dataclass(slots=True)
class _Group:
    newest: Deed
    newest_s: float
    until_s: float
    quiet_s: float = QUIET_S
    count: int = 0

    def counted(self) -> CountedDeed:
        """What is to be told of it."""
        return CountedDeed(self.newest, self.newest_s, self.count)


class DeedGroups:
    """Puts equal deeds together."""

    def __init__(self) -> None:
        self._groups: dict[_Key, _Group] = {}
        self._new: dict[_Kind, RateLimit] = {}
        self._told_apart: Counter[_Kind] = Counter()

    def add(self, deed: Deed, now_s: float, count: int = 1) -> list[CountedDeed]:
        """Take a deed, or several equal ones; returns the deeds to report at once."""
        group = self._groups.get(_key(deed))
        if group is None and not self._may_begin(deed, now_s):
            others = ClientOrigin(client=MANY, role=deed.origin.role)
            deed = replace(deed, origin=others, robot=None, code=None, text="")
            group = self._groups.get(_key(deed))
        if group is None:
            self._groups[_key(deed)] = _Group(deed, now_s, now_s + QUIET_S)
            self._told_apart[_kind(deed)] += 1
            return [CountedDeed(deed, now_s, count)]
        group.newest, group.newest_s = deed, now_s
        group.count += count
        return []

    def due(self, now_s: float) -> list[CountedDeed]:
        """The groups that were counted for long enough, as deeds with their counts."""
        told: list[CountedDeed] = []
        for key, group in list(self._groups.items()):
            if now_s < group.until_s:
                continue
            if not group.count:
                del self._groups[key]
                self._told_apart[_kind(group.newest)] -= 1
                continue
            told.append(group.counted())
            group.count = 0
            group.quiet_s = min(2.0 * group.quiet_s, LONGEST_QUIET_S)
            group.until_s = now_s + group.quiet_s
        return told

    def rest(self) -> list[CountedDeed]:
        """The counted deeds that were not reported yet; all groups are forgotten."""
        groups, self._groups = self._groups, {}
        self._told_apart.clear()
        return [group.counted() for group in groups.values() if group.count]

    def _may_begin(self, deed: Deed, now_s: float) -> bool:
        kind = _kind(deed)
        rate = self._new.get(kind)
        if rate is None:
            rate = self._new[kind] = RateLimit(NEW_GROUPS_S, MOST_GROUPS)
        return self._told_apart[kind] < MOST_GROUPS and rate.take(now_s)


def _kind(deed: Deed) -> _Kind:
    return deed.what, deed.outcome, deed.origin.role


def _key(deed: Deed) -> _Key:
    origin = deed.origin
    # who connects again and again has another port each time
    host = origin.address.rpartition(":")[0] or origin.address
    # what was refused is equal whatever a stranger wrote; what was done is another thing each time
    text = "" if deed.outcome is AuditOutcome.REFUSED else deed.text
    return _Key(
        deed.what,
        deed.outcome,
        deed.code,
        deed.robot,
        origin.client,
        host,
        origin.role,
        origin.identity,
        text,
    )
