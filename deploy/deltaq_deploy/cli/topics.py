"""Finding rows of the table of topics by name."""

from __future__ import annotations

import difflib

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.topics import TOPICS, Kind, Realm, Topic


class UnknownTopicError(DeltaqError):
    """No such topic, or none that can be watched."""


def by_name(name: str) -> Topic:
    """The row of that name.

    Raises:
        UnknownTopicError: naming those that there are.
    """
    for topic in TOPICS:
        if topic.name == name:
            return topic
    names = [topic.name for topic in TOPICS]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise UnknownTopicError(f"no topic {name!r}; {hint}the topics are {', '.join(names)}")


def open_streams() -> tuple[Topic, ...]:
    """The topics that a client can watch."""
    return tuple(topic for topic in TOPICS if topic.realm is Realm.OPEN and topic.kind is Kind.STREAM)


def open_stream(name: str) -> Topic:
    """The row of that name, if it can be watched.

    Raises:
        UnknownTopicError: if there is none, or it is a query, or belongs to the guarded realm.
    """
    topic = by_name(name)
    if topic not in open_streams():
        why = (
            "is in the guarded realm, which no client reaches"
            if topic.realm is Realm.GUARDED
            else "is a query"
        )
        names = ", ".join(row.name for row in open_streams())
        raise UnknownTopicError(f"topic {name!r} {why}; those that can be watched are {names}")
    return topic
