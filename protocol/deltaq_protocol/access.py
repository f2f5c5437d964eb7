"""Access control of zenoh sessions, from the table of topics: who may publish, ask and answer.

By default a zenoh session forwards every message between its clients. Without these rules a client could read
another client's increments with their lease, publish states, and answer a stop in place of the server. Whatever the
table does not name is denied. Any client may subscribe; it receives what the table allows the session to send.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from deltaq_protocol import topics
from deltaq_protocol.topic import Kind, Party, Realm


def access(
    party: Party,
    realm: Realm,
    cell: str,
    robot: str = "*",
    speakers: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, Any]:
    """Access control of one party's session in one realm, in the form of zenoh's configuration.

    Args:
        party: the party whose session it is.
        realm: the realm of the session.
        cell: name of the cell.
        robot: the only robot that the session serves; `*`: all.
        speakers: over TLS, the keys under which each peer may send, by the name in its certificate; None: every peer
            may send under every key that the party reads.
    """

    def keys(kind: Kind, cell: str, *, published: bool) -> list[str]:
        return [
            topic.key(cell, robot=robot)
            for topic in topics.TOPICS
            if (topic.realm, topic.kind) == (realm, kind)
            and party in (topic.publishers if published else topic.readers)
        ]

    heard = keys(Kind.STREAM, cell, published=False)
    answered = keys(Kind.QUERY, cell, published=False)
    rules = [
        _rule("listen", ["ingress", "egress"], ["declare_subscriber"], ["**"]),
        *([] if speakers is not None else [_rule("hear", ["ingress"], ["put"], heard)]),
        _rule("say", ["egress"], ["put"], keys(Kind.STREAM, cell, published=True)),
        # a client asks for the description before it knows the cell's name
        _rule("be asked", ["ingress"], ["query"], keys(Kind.QUERY, "*", published=False)),
        _rule("answer", ["egress"], ["declare_queryable", "reply"], answered),
    ]
    rules = [rule for rule in rules if rule["key_exprs"]]
    named = {
        name: _rule(f"hear {name}", ["ingress"], ["put"], said) for name, said in (speakers or {}).items()
    }
    policies = [{"id": "table", "rules": [rule["id"] for rule in rules], "subjects": ["everybody"]}]
    policies += [{"id": name, "rules": [rule["id"]], "subjects": [name]} for name, rule in named.items()]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [*rules, *named.values()],
        "subjects": [{"id": "everybody"}, *({"id": name, "cert_common_names": [name]} for name in named)],
        "policies": policies,
    }


def _rule(name: str, flows: Sequence[str], messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows),
        "messages": list(messages),
        "key_exprs": list(keys),
    }
