"""Pages of what crosses a wire."""

from collections.abc import Iterator
from enum import Enum

from deltaq_protocol import audit
from deltaq_protocol import messages as open_messages
from deltaq_protocol import topics as table_of_topics
from deltaq_protocol.messages import LeaseAction, Message, Outcome, Phase, Sight
from deltaq_protocol.reasons import EXPLANATIONS
from deltaq_protocol.topic import Realm, Topic
from deltaq_services.phases import MAY_MOVE, TRANSITIONS
from reference_pages.counters import COUNTERS
from reference_pages.markdown import fields, message_link, models, table

_ENUMS = (Phase, Outcome, LeaseAction, Sight, audit.AuditKind, audit.AuditOutcome)


def topics() -> str:
    """The table of topics, and who may use those of the open realm."""
    rights = (
        (
            f"`{topic.name}`",
            right.what,
            "the holder of its lease" if right.of_holder else right.least.name.lower(),
        )
        for topic in table_of_topics.TOPICS
        for right in topic.rights
    )
    return "\n\n".join(
        [
            "# Topics and rights",
            "Look up the zenoh key of each message, its rate, and which clients may use it. zenoh carries msgpack maps"
            " with the fields of the [message](messages.md). A message that is older than its greatest age has no"
            " effect; the cell's `gate.max_request_age_s` bounds the same age in seconds, and the lesser of the two"
            " decides.",
            "## Open realm",
            "Clients communicate with the HLI only.",
            _table_of(Realm.OPEN),
            "## Rights of clients",
            "A client proves its role by a token or an [identity](../explanation/security.md#clients). An operator may"
            " do everything that a controller may, and a controller everything that an observer may; an observer needs"
            " no proof. If no tokens are set, every client is an operator.",
            table(("topic", "what", "who may"), rights),
            "## Guarded realm",
            "Only HLI, SIM and Robot Servers communicate here, and each key has one sender. Unix permissions or"
            " [certificates](../explanation/security.md#identities) enforce this. Clients do not need this realm;"
            " `deltaq schema` prints the fields.",
            _table_of(Realm.GUARDED),
        ]
    )


def _table_of(realm: Realm) -> str:
    rows = (
        (
            f"`{topic.name}`",
            f"`{topic.template}`",
            topic.kind,
            _carried(topic),
            ", ".join(topic.publishers),
            ", ".join(topic.readers),
            topic.rate_text,
            _greatest_age(topic),
            topic.recorded,
        )
        for topic in table_of_topics.TOPICS
        if topic.realm is realm
    )
    columns = (
        "topic",
        "key",
        "kind",
        "message",
        "sent or asked by",
        "read or answered by",
        "rate",
        "greatest age",
    )
    return table((*columns, "recorded"), rows)


def _carried(topic: Topic) -> str:
    name = message_link if topic.realm is Realm.OPEN else lambda message: f"`{message.__name__}`"
    return name(topic.message) + (f" → {name(topic.reply)}" if topic.reply else "")


def _greatest_age(topic: Topic) -> str:
    cycles = [] if topic.max_age_cycles is None else [f"{topic.max_age_cycles} cycles"]
    return ", ".join([*cycles, *([] if topic.max_age_s is None else [f"{topic.max_age_s:g} s"])])


def messages() -> str:
    """The fields of every message of the open realm, and of the audit log."""
    return "\n\n".join(
        [
            "# Messages",
            "Look up what a client sends and receives. The fields are the same in msgpack and in JSON lines;"
            " `deltaq schema` prints them as JSON Schema, with the guarded realm's. A field without a default is"
            " required.",
            "- *name*: a string of 1 to 64 characters; *count*: an integer from 0, below 2⁶³\n"
            "- *joints*: a list of 1 to 32 finite numbers in joint order, in rad and m. `q` is a configuration, and"
            " `dq` an increment over one cycle\n"
            "- *pose*: a 4 by 4 matrix, a list of rows; `T_a_b` maps coordinates of b into a\n"
            "- *ReasonCode*: one of the [reason codes](reasons.md#reason-codes)\n"
            + "\n".join(_values(enum) for enum in _ENUMS),
            "## Open realm",
            *(fields(model, level=3) for model in models(open_messages, Message)),
            "## Audit log",
            *(fields(model, level=3) for model in models(audit, Message)),
        ]
    )


def _values(enum: type[Enum]) -> str:
    return f"- *{enum.__name__}*: {', '.join(f'`{member.value}`' for member in enum)}"


def reasons() -> str:
    """The reason codes, and the phases of a robot with what changes them."""
    changes = ((f"`{row.phase}`", row.event, f"`{row.next_phase}`") for row in TRANSITIONS)
    rows = ((f"`{code}`", text) for code, text in EXPLANATIONS.items())
    may_move = " and ".join(f"`{phase}`" for phase in Phase if phase in MAY_MOVE)
    return "\n\n".join(
        [
            "# Reasons and phases",
            "Look up why a request was scaled, held or refused, why a robot is held, and how its phase changes."
            " [Troubleshooting](../how-to/troubleshooting.md) says what to do.",
            "## Reason codes",
            table(("code", "meaning"), rows),
            "## Phases of a robot",
            f"A robot takes admissions only in {may_move}. It begins `{Phase.OFFLINE}`. An event that is not listed"
            " for a phase changes nothing."
            " [Proved properties](../notes/what-is-proved-of-the-phases.md).",
            table(("phase", "event", "next phase"), changes),
        ]
    )


def counters() -> str:
    """The counters; what several services count alike is one row."""
    return "\n\n".join(
        [
            "# Counters",
            "Look up what a counter of `deltaq status --json` or of the metrics counts. Each counts from the start of"
            " its process; a counter of zero is left out. A part in braces stands for a name: a"
            " [reason code](reasons.md), a [topic](topics.md), a robot.",
            table(("service", "counter", "what was counted"), _counted()),
        ]
    )


def _counted() -> Iterator[tuple[str, str, str]]:
    alike: dict[tuple[str, str], list[str]] = {}
    for row in COUNTERS:
        alike.setdefault((row.name, row.meaning), []).append(row.service.replace("_", " "))
    for (name, meaning), services in alike.items():
        yield ", ".join(services), f"`{name}`", meaning
