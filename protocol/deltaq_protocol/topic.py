"""A row of the table of topics: key, message, rate, greatest age, priority, publishers and readers."""

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from deltaq_protocol.messages import Message

_ROUNDING = 1e-9
"""What a division may take off a whole number of cycles."""


class Realm(StrEnum):
    """Who can reach a topic: any client (open), or only HLI, SIM and Robot Servers (guarded)."""

    OPEN = "open"
    GUARDED = "guarded"


class Kind(StrEnum):
    """Published stream or query with a reply."""

    STREAM = "stream"
    QUERY = "query"


class Party(StrEnum):
    """Who publishes a stream or asks a query, and who reads it or answers."""

    CLIENT = "client"
    HLI = "HLI"
    SIM = "SIM"
    ROBOT_SERVER = "Robot Server"
    WATCHER = "watcher"
    """The recorder and `deltaq status --service`: they only listen."""


class Priority(StrEnum):
    """How urgent a message is on a link where others wait. An urgent message is sent at once, by itself."""

    URGENT = "urgent"
    ORDINARY = "ordinary"


class ClientRole(IntEnum):
    """The roles of clients; each may do everything that the roles before it may."""

    OBSERVER = 1
    """Look on, and stop."""
    CONTROLLER = 2
    """Acquire a free lease, and move its robot; ask a follower for another view."""
    OPERATOR = 3
    """Take a lease from its holder, reset, allow contacts."""


@dataclass(frozen=True)
class Right:
    """The role that one action needs.

    Attributes:
        what: the action, if the topic has several; otherwise empty.
        least: the least role that may do it. Without tokens every client is an operator.
        of_holder: only the holder of the robot's lease may do it, in any role.
    """

    what: str = ""
    least: ClientRole = ClientRole.OBSERVER
    of_holder: bool = False


@dataclass(frozen=True)
class Cycles:
    """Once in so many cycles of a robot.

    Attributes:
        cycles: from one message to the next.
        steady: False where there may be less to say than that.
    """

    cycles: int = 1
    steady: bool = True

    def period_s(self, cycle_s: float) -> float:
        """Time from one message to the next [s]."""
        return self.cycles * cycle_s

    def __str__(self) -> str:
        often = "every cycle" if self.cycles == 1 else f"every {self.cycles} cycles"
        return often if self.steady else f"at most {often}"


@dataclass(frozen=True)
class Hertz:
    """A rate in times a second, independent of the robot's cycle."""

    hz: float
    steady: bool = True

    def period_s(self, cycle_s: float) -> float:  # noqa: ARG002 - the same for every cycle
        """Time from one message to the next [s]."""
        return 1.0 / self.hz

    def __str__(self) -> str:
        often = f"{self.hz:g} Hz"
        return often if self.steady else f"at most {often}"


@dataclass(frozen=True)
class Messages:
    """Once in so many messages that the gate takes, while it is recorded."""

    messages: int

    def __str__(self) -> str:
        if self.messages == 1:
            return "every message of the gate, while it is recorded"
        return f"every {self.messages} messages of the gate, while it is recorded"


Rate = Cycles | Hertz | Messages


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    Attributes:
        name: its name, as in `deltaq topic echo NAME`.
        template: zenoh key with `{cell}`, `{robot}` and `{service}` to be filled in.
        message: type of the payload.
        publishers: parties that publish the stream, or ask the query.
        readers: parties that read the stream, or answer the query.
        rate: how often it comes; None: on demand.
        reply: type of the reply of a query.
        max_age_cycles: older messages, in cycles of the robot, are not acted upon; None if cycles do not count.
        max_age_s: older messages are not acted upon, or count as silence; None if seconds do not count.
        priority: how urgent it is.
        recorded: whether a recording holds it. Nobody else receives messages between a client and the HLI; a
            recording has the messages that the HLI makes of them in the guarded realm.
        rights: the clients that may send or receive it; empty for topics without clients.
    """

    name: str
    realm: Realm
    kind: Kind
    template: str
    message: type[Message]
    publishers: tuple[Party, ...]
    readers: tuple[Party, ...]
    rate: Rate | None = None
    reply: type[Message] | None = None
    max_age_cycles: int | None = None
    max_age_s: float | None = None
    priority: Priority = Priority.URGENT
    recorded: bool = True
    rights: tuple[Right, ...] = ()

    def key(self, cell: str, **fields: str) -> str:
        """The key of one cell and robot or service; a field not given becomes the wildcard `*`."""
        wanted = {"robot": "*", "service": "*"} | fields
        return self.template.format(cell=cell, **wanted)

    def least_role(self, what: str = "") -> ClientRole:
        """The least role of a client that may do something on this topic.

        Raises:
            KeyError: if the table has no such action.
        """
        return {right.what: right.least for right in self.rights}[what]

    def period_s(self, cycle_s: float) -> float:
        """Time from one message to the next [s].

        Raises:
            ValueError: if the table gives this topic no rate in time.
        """
        if isinstance(self.rate, Cycles | Hertz):
            return self.rate.period_s(cycle_s)
        raise ValueError(f"{self.name} has no rate in time, it comes {self.rate_text}")

    def steady_hz(self, cycle_s: float) -> float | None:
        """The required rate [1/s]; None for a topic that is published on events."""
        if isinstance(self.rate, Cycles | Hertz) and self.rate.steady:
            return 1.0 / self.rate.period_s(cycle_s)
        return None

    def age_s(self, cycle_s: float, bound_s: float = math.inf) -> float:
        """How old it may be [s]: the least of the row's ages, and of a bound that the cell sets.

        Raises:
            ValueError: if nothing bounds it.
        """
        cycles = math.inf if self.max_age_cycles is None else self.max_age_cycles * cycle_s
        seconds = math.inf if self.max_age_s is None else self.max_age_s
        age_s = min(cycles, seconds, bound_s)
        if age_s == math.inf:
            raise ValueError(f"{self.name} has no greatest age")
        return age_s

    def age_cycles(self, cycle_s: float, bound_s: float = math.inf) -> int:
        """The greatest age in whole cycles, rounded down."""
        return math.floor(self.age_s(cycle_s, bound_s) / cycle_s + _ROUNDING)

    @property
    def rate_text(self) -> str:
        """The rate as text."""
        return "on demand" if self.rate is None else str(self.rate)
