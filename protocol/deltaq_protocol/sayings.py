"""Who sends what to whom in the guarded realm: the table of topics, by the services of one cell.

Envelopes, access control over TLS and the reference follow from this table.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from deltaq_protocol import topics
from deltaq_protocol.topic import Party, Realm, Topic

SIM, HLI = "sim", "hli"


@dataclass(frozen=True)
class Saying:
    """One row: a zenoh key has one sender, even if others could publish under it.

    Attributes:
        topic: row of the table of topics.
        key: zenoh key.
        speaker: the service that sends it.
        listeners: the services that act upon it.
    """

    topic: Topic
    key: str
    speaker: str
    listeners: tuple[str, ...]


def robot_server(robot: str) -> str:
    """Name of the service of one robot."""
    return f"robot-server-{robot}"


def services(robots: Sequence[str]) -> tuple[str, ...]:
    """The services of a guarded realm, all that speak and listen there."""
    return (*map(robot_server, robots), SIM, HLI)


def sayings(cell: str, robots: Sequence[str]) -> tuple[Saying, ...]:
    """All that services of a cell send to one another in the guarded realm.

    Args:
        cell: its name.
        robots: their names.
    """
    rows = (topic for topic in topics.TOPICS if is_acted_upon(topic))
    return tuple(saying for topic in rows for saying in _of_topic(topic, cell, robots))


def speakers_to(service: str, cell: str, robots: Sequence[str]) -> dict[str, list[str]]:
    """The services that a service listens to, and the zenoh keys."""
    heard: dict[str, list[str]] = {}
    for saying in sayings(cell, robots):
        if service in saying.listeners:
            heard.setdefault(saying.speaker, []).append(saying.key)
    return heard


def is_acted_upon(topic: Topic) -> bool:
    """Whether a topic is of the guarded realm and a service acts upon it; other topics there are for observers."""
    return topic.realm is Realm.GUARDED and any(reader is not Party.WATCHER for reader in topic.readers)


def _of_topic(topic: Topic, cell: str, robots: Sequence[str]) -> Iterator[Saying]:
    is_of_robot = "{robot}" in topic.template
    for party in topic.publishers:
        for speaker, own in _named(party, robots):
            concerned = [name for name in robots if own in (None, name)] if is_of_robot else [None]
            for robot in concerned:
                key = topic.key(cell, service=speaker, **({"robot": robot} if robot else {}))
                listeners = tuple(_listeners(topic, party, [robot] if robot else robots))
                yield Saying(topic, key, speaker, listeners)


def _listeners(topic: Topic, party: Party, robots: Sequence[str]) -> Iterator[str]:
    for reader in topic.readers:
        if reader not in (Party.WATCHER, party):  # Robot Servers have nothing to say to one another
            yield from (name for name, _ in _named(reader, robots))


def _named(party: Party, robots: Sequence[str]) -> list[tuple[str, str | None]]:
    """The services of a party, each with the robot that it serves alone."""
    if party is Party.ROBOT_SERVER:
        return [(robot_server(robot), robot) for robot in robots]
    return [(SIM if party is Party.SIM else HLI, None)]
