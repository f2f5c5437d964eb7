"""Pages of what crosses a wire."""

from __future__ import annotations

from deltaq_protocol import audit, guarded
from deltaq_protocol import messages as open_messages
from deltaq_protocol import sayings as table_of_sayings
from deltaq_protocol import topics as table_of_topics
from deltaq_protocol.client_rights import RIGHTS
from deltaq_protocol.messages import Message
from deltaq_protocol.reasons import EXPLANATIONS
from deltaq_protocol.topic import Realm
from deltaq_services.counters import COUNTERS
from reference_pages.markdown import fields, message_link, models, table


def topics() -> str:
    """The table of topics."""
    rows = (
        (
            f"`{topic.name}`",
            topic.realm,
            topic.kind,
            f"`{topic.template}`",
            message_link(topic.message) + (f" → {message_link(topic.reply)}" if topic.reply else ""),
            ", ".join(topic.publishers),
            ", ".join(topic.readers),
            topic.rate_text,
            topic.max_age_cycles,
            topic.max_age_s,
            topic.priority,
            topic.recorded,
        )
        for topic in table_of_topics.TOPICS
    )
    columns = (
        *("topic", "realm", "kind", "key", "message", "published or asked by", "read or answered by"),
        *("rate", "greatest age [cycles]", "greatest age [s]", "priority", "recorded"),
    )
    return (
        "# Topics\n\nzenoh carries msgpack maps with the fields of the message named. Clients reach the open realm;"
        " HLI, SIM and Robot Servers alone speak in the guarded realm. What is older than its greatest age is not"
        " acted upon; where the cell's `gate` bounds an age in seconds too (`max_request_age_s`), the lesser of"
        " the two decides. See [the loop](../explanation/the-loop.md).\n\n" + table(columns, rows)
    )


def sayings() -> str:
    """Who says what to whom: clients by their role, services by their name."""
    robot = "{robot}"
    known = table_of_sayings.sayings("{cell}", [robot])
    rows = (
        (
            f"`{saying.speaker}`",
            f"[`{saying.topic.name}`](topics.md)",
            f"`{saying.key}`",
            ", ".join(f"`{name}`" for name in saying.listeners),
        )
        for saying in sorted(known, key=lambda saying: saying.speaker)
    )
    unsealed = ", ".join(
        f"`{topic.name}`"
        for topic in table_of_topics.TOPICS
        if topic.realm is Realm.GUARDED and not table_of_sayings.is_sealed(topic)
    )
    rights = (
        (
            f"[`{right.topic.name}`](topics.md)",
            right.what,
            "the holder of its lease" if right.of_holder else right.least.name.lower(),
        )
        for right in RIGHTS
    )
    return (
        "# Who says what\n\n## Open realm\n\nClients communicate with the HLI only. A client proves its role by a"
        " token or an [identity](../explanation/security.md#clients). An operator may do everything that a controller"
        " may, and a controller everything that an observer may; an observer needs no proof. If no tokens are set,"
        " every client is an operator.\n\n"
        + table(("topic", "what", "who may"), rights)
        + "\n\n## Guarded realm\n\nIn the guarded realm each key has one sender. With"
        " [identities](../explanation/security.md#identities) a message there has a MAC for each of its receivers,"
        " which only the sender and that receiver can make; messages of anybody else are refused and counted. If a"
        " service is among its own receivers, observers that use its identity read the message. A line with `{robot}`"
        " stands for each robot of the cell.\n\n"
        f"{table(('who', 'says', 'under', 'to'), rows)}\n\nOnly observers read these topics;"
        f" no service acts upon them, and they have no seal: {unsealed}."
    )


def messages() -> str:
    """The fields of every message."""
    parts = [
        "# Messages\n\nThe fields are the same in msgpack and in JSON lines; `deltaq schema` prints them as JSON"
        " Schema. `q` is a configuration and `dq` an increment over one cycle, in rad and m, in joint order."
    ]
    rooms = ((open_messages, "Open realm"), (guarded, "Guarded realm"), (audit, "Audit log"))
    for module, realm in rooms:
        parts.append(f"## {realm}")
        parts += [fields(model, level=3) for model in models(module, Message)]
    return "\n\n".join(parts)


def reasons() -> str:
    """The reason codes."""
    rows = ((f"`{code}`", text) for code, text in EXPLANATIONS.items())
    return (
        "# Reason codes\n\nWhy a request was scaled, held or refused, and why a robot is held.\n\n"
        + table(("code", "meaning"), rows)
    )


def counters() -> str:
    """The counters."""
    rows = ((row.service.replace("_", " "), f"`{row.name}`", row.meaning) for row in COUNTERS)
    return (
        "# Counters\n\nWhat `deltaq status --json` and the states of the guarded realm count, each from the start of"
        " its process; a counter of zero is left out. A part in braces stands for a name: a [reason code](reasons.md),"
        " a [topic](topics.md), a robot.\n\n" + table(("service", "counter", "what was counted"), rows)
    )
