"""The table of topics: key, message, rate, greatest age, and whether it is recorded.

Publishing, the recorder, `deltaq hz`, the documentation and the tests all follow from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from deltaq_protocol import guarded, messages
from deltaq_protocol.messages import Message


class Realm(StrEnum):
    """Who can reach a topic: any client (open), or only HLI, SIM and Robot Servers (guarded)."""

    OPEN = "open"
    GUARDED = "guarded"


class Kind(StrEnum):
    """Published stream or query with a reply."""

    STREAM = "stream"
    QUERY = "query"


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    Attributes:
        name: what people call it, as in `deltaq echo NAME`.
        template: zenoh key with `{cell}`, `{robot}` and `{service}` to be filled in.
        message: type of the payload.
        reply: type of the reply of a query.
        rate: how often it comes.
        max_age_cycles: older data must not be acted upon; None where age does not matter.
        recorded: whether a recording holds it. What passes between a client and the HLI alone is not heard by
            anybody else: of it a recording has what the HLI makes of it, in the guarded realm.
    """

    name: str
    realm: Realm
    kind: Kind
    template: str
    message: type[Message]
    rate: str
    reply: type[Message] | None = None
    max_age_cycles: int | None = None
    recorded: bool = True

    def key(self, cell: str, **fields: str) -> str:
        """The key of one cell and robot or service; a field not given becomes the wildcard `*`."""
        wanted = {"robot": "*", "service": "*"} | fields
        return self.template.format(cell=cell, **wanted)


_OPEN = "deltaq/{cell}/"
_GUARDED = "deltaq-guarded/{cell}/"

STATE = Topic(
    "state", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/state", messages.RobotState, "every cycle",
    max_age_cycles=3,
)  # fmt: skip
INCREMENT = Topic(
    "increment", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/increment", messages.Increment, "every cycle",
    max_age_cycles=10, recorded=False,
)  # fmt: skip
VERDICT = Topic(
    "verdict", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/verdict", messages.Verdict, "every decided cycle"
)
LEASE = Topic(
    "lease", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/lease", messages.LeaseRequest, "on demand",
    reply=messages.LeaseReply, recorded=False,
)  # fmt: skip
IO = Topic(
    "io", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/io", messages.IoRequest, "on demand",
    reply=messages.IoReply, recorded=False,
)  # fmt: skip
PROXIMITY = Topic("proximity", Realm.OPEN, Kind.STREAM, _OPEN + "proximity", messages.Proximity, "10 Hz")
STOP = Topic(
    "stop", Realm.OPEN, Kind.QUERY, _OPEN + "stop", messages.StopRequest, "on demand",
    reply=messages.Done, recorded=False,
)  # fmt: skip
RESET = Topic(
    "reset", Realm.OPEN, Kind.QUERY, _OPEN + "reset", messages.ResetRequest, "on demand",
    reply=messages.Done, recorded=False,
)  # fmt: skip
DRY_RUN = Topic(
    "dry-run", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/dry-run", messages.DryRunRequest, "on demand",
    reply=messages.DryRunReply, recorded=False,
)  # fmt: skip
CONTACT = Topic(
    "contact", Realm.OPEN, Kind.QUERY, _OPEN + "contact", messages.ContactRequest, "on demand",
    reply=messages.Done, recorded=False,
)  # fmt: skip
DESCRIPTION = Topic(
    "description", Realm.OPEN, Kind.QUERY, _OPEN + "description", messages.DescribeRequest, "on demand",
    reply=messages.Description, recorded=False,
)  # fmt: skip
STATUS = Topic(
    "status", Realm.OPEN, Kind.QUERY, _OPEN + "status", messages.DescribeRequest, "on demand",
    reply=messages.Status, recorded=False,
)  # fmt: skip

SERVER_STATE = Topic(
    "server-state", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/state", guarded.ServerState,
    "every cycle", max_age_cycles=3,
)  # fmt: skip
REQUEST = Topic(
    "request", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/request", guarded.Request, "every cycle",
    max_age_cycles=10,
)  # fmt: skip
ADMISSION = Topic(
    "admission", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/admission", guarded.Admission,
    "every cycle", max_age_cycles=1,
)  # fmt: skip
SUPERVISION = Topic(
    "supervision", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/supervision", guarded.Supervision,
    "every cycle",
)  # fmt: skip
GATE_VERDICT = Topic(
    "gate-verdict", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/verdict", messages.Verdict,
    "every decided cycle",
)  # fmt: skip
COMMAND = Topic("command", Realm.GUARDED, Kind.STREAM, _GUARDED + "command", guarded.Command, "on demand")
COMMAND_REPLY = Topic(
    "command-reply", Realm.GUARDED, Kind.STREAM, _GUARDED + "command-reply", guarded.CommandReply, "on demand"
)
HEALTH = Topic(
    "health", Realm.GUARDED, Kind.STREAM, _GUARDED + "health/{service}", guarded.Health, "2 Hz",
    recorded=False,
)  # fmt: skip
GATE_KEYS = _GUARDED + "gate/*"
"""Keys of the two that follow, and of nothing else."""
GATE_LOG = Topic(
    "gate-log", Realm.GUARDED, Kind.STREAM, _GUARDED + "gate/log", guarded.GateEntry,
    "every message of the gate, while it is recorded", recorded=False,
)  # fmt: skip
GATE_MEMORY = Topic(
    "gate-memory", Realm.GUARDED, Kind.STREAM, _GUARDED + "gate/memory", guarded.GateMemory,
    "every 500 messages of the gate, while it is recorded",
)  # fmt: skip

TOPICS: tuple[Topic, ...] = (
    STATE, INCREMENT, VERDICT, LEASE, IO, PROXIMITY, STOP, RESET, DRY_RUN, CONTACT, DESCRIPTION,
    STATUS,
    SERVER_STATE, REQUEST, ADMISSION, SUPERVISION, GATE_VERDICT, COMMAND, COMMAND_REPLY, HEALTH,
    GATE_LOG, GATE_MEMORY,
)  # fmt: skip
