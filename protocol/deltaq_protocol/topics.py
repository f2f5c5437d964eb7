"""The table of topics: key, message, answer, rate, greatest age, priority, parties, rights and recording.

Rates and priorities, the greatest age of messages, lagging services, access to the sessions, the rights of clients
by role, the recorder, `deltaq topic hz`, documentation and tests all follow from this table.

Where the cell's `gate` bounds an age in seconds too (`max_request_age_s`), the lesser of the two decides.
"""

from deltaq_protocol import audit, guarded, messages
from deltaq_protocol.messages import LeaseAction
from deltaq_protocol.topic import (
    ClientRole,
    Cycles,
    Hertz,
    Kind,
    Messages,
    Party,
    Priority,
    Realm,
    Right,
    Topic,
)

_OPEN = "deltaq/{cell}/"
_GUARDED = "deltaq-guarded/{cell}/"

_EVERY_CYCLE = Cycles(1)
_AT_MOST_EVERY_CYCLE = Cycles(1, steady=False)
_CLIENT, _HLI, _SIM, _ROBOT_SERVER, _WATCHER = (
    (Party.CLIENT,), (Party.HLI,), (Party.SIM,), (Party.ROBOT_SERVER,), (Party.WATCHER,),
)  # fmt: skip
_ANYBODY = (Right(),)
_CONTROLLER, _OPERATOR = (Right(least=ClientRole.CONTROLLER),), (Right(least=ClientRole.OPERATOR),)

STATE = Topic(
    "state", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/state", messages.RobotState,
    publishers=_HLI, readers=_CLIENT, rate=_EVERY_CYCLE,
    rights=_ANYBODY,
)  # fmt: skip
INCREMENT = Topic(
    "increment", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/increment", messages.Increment,
    publishers=_CLIENT, readers=_HLI, rate=_AT_MOST_EVERY_CYCLE, max_age_cycles=10, recorded=False,
    rights=(Right(of_holder=True),),
)  # fmt: skip
VERDICT = Topic(
    "verdict", Realm.OPEN, Kind.STREAM, _OPEN + "{robot}/verdict", messages.Verdict,
    publishers=_HLI, readers=_CLIENT, rate=_AT_MOST_EVERY_CYCLE,
    rights=_ANYBODY,
)  # fmt: skip
LEASE = Topic(
    "lease", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/lease", messages.LeaseRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.LeaseReply, recorded=False,
    rights=(
        Right(LeaseAction.RENEW, of_holder=True), Right(LeaseAction.RELEASE, of_holder=True),
        Right(LeaseAction.ACQUIRE, ClientRole.CONTROLLER), Right(LeaseAction.TAKE, ClientRole.OPERATOR),
    ),
)  # fmt: skip
IO = Topic(
    "io", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/io", messages.IoRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.IoReply, recorded=False,
    rights=(Right("read"), Right("set", of_holder=True)),
)  # fmt: skip
"""Without a controller's token, any client may also set outputs of a robot that no client holds."""
PROXIMITY = Topic(
    "proximity", Realm.OPEN, Kind.STREAM, _OPEN + "proximity", messages.Proximity,
    publishers=_HLI, readers=_CLIENT, rate=Hertz(10.0), priority=Priority.ORDINARY,
    rights=_ANYBODY,
)  # fmt: skip
STOP = Topic(
    "stop", Realm.OPEN, Kind.QUERY, _OPEN + "stop", messages.StopRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Done, recorded=False,
    rights=_ANYBODY,
)  # fmt: skip
RESET = Topic(
    "reset", Realm.OPEN, Kind.QUERY, _OPEN + "reset", messages.ResetRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Done, recorded=False,
    rights=_OPERATOR,
)  # fmt: skip
DRY_RUN = Topic(
    "dry-run", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/dry-run", messages.DryRunRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.DryRunReply, recorded=False,
    rights=_ANYBODY,
)  # fmt: skip
VIEW = Topic(
    "view", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/view", messages.ViewRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.ViewReply, recorded=False,
    rights=_CONTROLLER,
)  # fmt: skip
CHALLENGE = Topic(
    "challenge", Realm.OPEN, Kind.QUERY, _OPEN + "challenge", messages.ChallengeRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Challenge, recorded=False,
    rights=_ANYBODY,
)  # fmt: skip
CONTACT = Topic(
    "contact", Realm.OPEN, Kind.QUERY, _OPEN + "contact", messages.ContactRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Done, recorded=False,
    rights=_OPERATOR,
)  # fmt: skip
TOOL = Topic(
    "tool", Realm.OPEN, Kind.QUERY, _OPEN + "{robot}/tool", messages.ToolRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Done, recorded=False,
    rights=(Right(of_holder=True),),
)  # fmt: skip
DESCRIPTION = Topic(
    "description", Realm.OPEN, Kind.QUERY, _OPEN + "description", messages.DescribeRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Description, priority=Priority.ORDINARY, recorded=False,
    rights=_ANYBODY,
)  # fmt: skip
STATUS = Topic(
    "status", Realm.OPEN, Kind.QUERY, _OPEN + "status", messages.DescribeRequest,
    publishers=_CLIENT, readers=_HLI, reply=messages.Status, priority=Priority.ORDINARY, recorded=False,
    rights=_ANYBODY,
)  # fmt: skip

SERVER_STATE = Topic(
    "server-state", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/state", guarded.ServerState,
    publishers=_ROBOT_SERVER, readers=_SIM + _HLI, rate=_EVERY_CYCLE, max_age_cycles=10,
)  # fmt: skip
REQUEST = Topic(
    "request", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/request", guarded.Request,
    publishers=_HLI, readers=_SIM, rate=_EVERY_CYCLE, max_age_cycles=10,
)  # fmt: skip
ADMISSION = Topic(
    "admission", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/admission", guarded.Admission,
    publishers=_SIM, readers=_ROBOT_SERVER, rate=_AT_MOST_EVERY_CYCLE, max_age_cycles=0,
)  # fmt: skip
SUPERVISION = Topic(
    "supervision", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/supervision", guarded.Supervision,
    publishers=_SIM, readers=_ROBOT_SERVER, rate=_AT_MOST_EVERY_CYCLE,
)  # fmt: skip
GATE_VERDICT = Topic(
    "gate-verdict", Realm.GUARDED, Kind.STREAM, _GUARDED + "{robot}/verdict", messages.Verdict,
    publishers=_SIM, readers=_HLI, rate=_AT_MOST_EVERY_CYCLE,
)  # fmt: skip
COMMAND = Topic(
    "command", Realm.GUARDED, Kind.STREAM, _GUARDED + "command", guarded.Command,
    publishers=_HLI, readers=_SIM, max_age_cycles=10,
)  # fmt: skip
COMMAND_REPLY = Topic(
    "command-reply", Realm.GUARDED, Kind.STREAM, _GUARDED + "command-reply", guarded.CommandReply,
    publishers=_SIM, readers=_HLI,
)  # fmt: skip
HEALTH = Topic(
    "health", Realm.GUARDED, Kind.STREAM, _GUARDED + "health/{service}", guarded.Health,
    publishers=_HLI + _SIM + _ROBOT_SERVER, readers=_HLI + _SIM + _WATCHER, rate=Hertz(10.0), max_age_s=2.0,
    priority=Priority.ORDINARY, recorded=False,
)  # fmt: skip
AUDIT_ENTRY = Topic(
    "audit-entry", Realm.GUARDED, Kind.STREAM, _GUARDED + "audit-entry", audit.AuditEntry,
    publishers=_HLI, readers=_SIM, priority=Priority.ORDINARY, recorded=False,
)  # fmt: skip
AUDIT = Topic(
    "audit", Realm.GUARDED, Kind.STREAM, _GUARDED + "audit", audit.AuditEntry,
    publishers=_SIM, readers=_WATCHER, priority=Priority.ORDINARY,
)  # fmt: skip
"""The same, handed on: a recorder is connected to the SIM, and the SIM alone can tell whose an entry is."""
GATE_KEYS = _GUARDED + "gate/*"
"""Keys of the two that follow, and of nothing else."""
GATE_LOG = Topic(
    "gate-log", Realm.GUARDED, Kind.STREAM, _GUARDED + "gate/log", guarded.GateEntry,
    publishers=_SIM, readers=_WATCHER, rate=Messages(1), priority=Priority.ORDINARY, recorded=False,
)  # fmt: skip
GATE_MEMORY = Topic(
    "gate-memory", Realm.GUARDED, Kind.STREAM, _GUARDED + "gate/memory", guarded.GateMemory,
    publishers=_SIM, readers=_WATCHER, rate=Messages(500), priority=Priority.ORDINARY,
)  # fmt: skip

TOPICS: tuple[Topic, ...] = (
    STATE, INCREMENT, VERDICT, LEASE, IO, PROXIMITY, STOP, RESET, DRY_RUN, VIEW, CHALLENGE, CONTACT, TOOL,
    DESCRIPTION, STATUS,
    SERVER_STATE, REQUEST, ADMISSION, SUPERVISION, GATE_VERDICT, COMMAND, COMMAND_REPLY, HEALTH,
    AUDIT_ENTRY, AUDIT, GATE_LOG, GATE_MEMORY,
)  # fmt: skip
