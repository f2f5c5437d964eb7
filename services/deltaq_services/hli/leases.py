"""Leases: one writer a robot. Who writes is decided here and nowhere else.

Every grant has a new epoch, greater than any before, and a token that only its holder gets. Epochs begin
with the time of day; if that has been set back, the gate still knows the epochs of an earlier process.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from deltaq_protocol.messages import MOST_COUNTED_ON
from deltaq_services.containment import Part
from deltaq_services.outputs import NOBODY, ClientOrigin, Sender

# Sequence numbers that were seen: none is taken twice, and those of a long way may overtake one another.


@dataclass
class Sequence(Part):
    """Replay protection of a lease: the sliding window of sequence numbers of RFC 4303, 3.4.3.

    Attributes:
        width: size of the window; 1: only a number greater than all before is new.
        newest: greatest number seen, -1 before the first.
        seen: bit k is set if `newest` - k was seen.
    """

    width: int = 1
    newest: int = -1
    seen: int = 0

    def is_new(self, number: int) -> bool:
        """Whether a number may still come."""
        behind = self.newest - number
        return behind < 0 or (behind < self.width and not self.seen >> behind & 1)

    def take(self, number: int) -> bool:
        """Take a sequence number; returns whether it is new."""
        if not self.is_new(number):
            return False
        if number > self.newest:
            self.seen = (self.seen << min(number - self.newest, self.width) | 1) & ~(-1 << self.width)
            self.newest = number
        else:
            self.seen |= 1 << self.newest - number
        return True


@dataclass
class Lease(Part):
    """The right to write to one robot.

    Attributes:
        sequence: sequence numbers seen under this lease.
        brought: those of increments that came with a later one, and have not come themselves.
        used: True once an increment was accepted; then losing the holder is a reason to stop.
        connection: the holder's connection, if it has one.
        origin: of the holder, for the audit log.
    """

    robot: str
    epoch: int
    client: str
    token: str
    expires_s: float
    connection: Sender | None = None
    sequence: Sequence = field(default_factory=Sequence)
    used: bool = False
    origin: ClientOrigin = NOBODY
    brought: set[int] = field(default_factory=set)

    def take_brought(self, seq: int) -> bool:
        """Take an increment; returns whether a later one had repeated it already, at most once each."""
        oldest = self.sequence.newest - self.sequence.width
        self.brought = {one for one in self.brought if one > oldest}
        was_brought = seq in self.brought
        self.brought.discard(seq)
        return was_brought


class Leases(Part):
    """The leases of all robots of a cell.

    Args:
        robots: names of the robots.
        lease_s: how long a lease lasts without a renewal.
        new_token: makes a secret, different each time.
        first_epoch: greater than any epoch granted before; `count_on_from` corrects it if it is not.
    """

    def __init__(
        self, robots: Iterable[str], lease_s: float, new_token: Callable[[], str], first_epoch: int
    ) -> None:
        self._leases: dict[str, Lease | None] = dict.fromkeys(robots)
        self._ended: dict[str, str] = {}
        self._lease_s = lease_s
        self._new_token = new_token
        self._epoch = first_epoch

    @property
    def parts(self) -> Iterator[object]:
        """The objects that change."""
        yield self
        for lease in self._leases.values():
            if lease is not None:
                yield from (lease, lease.sequence)

    def of(self, robot: str) -> Lease | None:
        """The lease of a robot, with any holder."""
        return self._leases.get(robot)

    def held_with(self, robot: str, token: str | None) -> Lease | None:
        """The lease of a robot, if `token` is its token."""
        lease = self._leases.get(robot)
        return lease if lease is not None and lease.token == token else None

    def tokens(self) -> list[str]:
        """Tokens of all leases; any thread may ask."""
        return [lease.token for lease in tuple(self._leases.values()) if lease is not None]

    def newest_tokens(self, robot: str) -> tuple[str | None, str | None]:
        """Tokens of a robot's lease and of the one that ended last, where there are such; any thread may ask."""
        lease = self._leases.get(robot)
        return lease.token if lease else None, self._ended.get(robot)

    def grant(
        self,
        robot: str,
        holder: ClientOrigin,
        connection: Sender | None,
        time_s: float,
        sequence: Sequence | None = None,
    ) -> Lease:
        """A new lease, in place of the one before."""
        self._epoch += 1
        expires_s = time_s + self._lease_s
        lease = Lease(
            robot, self._epoch, holder.client, self._new_token(), expires_s, connection, origin=holder
        )
        lease.sequence = sequence or lease.sequence
        self._leases[robot] = lease
        return lease

    def count_on_from(self, epoch: int) -> list[Lease]:
        """An earlier process granted `epoch`: grant greater ones; returns the leases that are outdated by it."""
        if not self._epoch < epoch < MOST_COUNTED_ON:
            return []
        self._epoch = epoch
        return [lease for lease in self._leases.values() if lease is not None]

    def renew(self, lease: Lease, time_s: float) -> None:
        """Let a lease last from now."""
        lease.expires_s = time_s + self._lease_s

    def end(self, lease: Lease) -> None:
        """Take a lease away, unless another has taken its place already."""
        if self._leases[lease.robot] is lease:
            self._leases[lease.robot] = None
            self._ended[lease.robot] = lease.token

    def expired(self, time_s: float) -> list[Lease]:
        """The expired leases."""
        return [lease for lease in self._leases.values() if lease is not None and time_s >= lease.expires_s]
