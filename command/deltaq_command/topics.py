"""Finding rows of the table of topics by name."""

from __future__ import annotations

import difflib

from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.topic import Kind, Party, Realm, Topic


class UnknownTopicError(DeltaqError):
    """No such topic, or none that can be watched."""


def by_name(name: str) -> Topic:
    """The row of that name.

    Raises:
        UnknownTopicError: naming those that there are.
    """
    for topic in topics.TOPICS:
        if topic.name == name:
            return topic
    names = [topic.name for topic in topics.TOPICS]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise UnknownTopicError(f"no topic {name!r}; {hint}the topics are {', '.join(names)}")


def open_streams() -> tuple[Topic, ...]:
    """What a client can watch: the streams of the open realm that the table lets clients read."""
    return tuple(
        topic
        for topic in topics.TOPICS
        if (topic.realm, topic.kind) == (Realm.OPEN, Kind.STREAM) and Party.CLIENT in topic.readers
    )


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
            if topic.kind is Kind.QUERY
            else f"is read by the {' and the '.join(topic.readers)} alone"
        )
        names = ", ".join(row.name for row in open_streams())
        raise UnknownTopicError(f"topic {name!r} {why}; those that can be watched are {names}")
    return topic
