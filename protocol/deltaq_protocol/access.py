"""Access to a session, from the table of topics: who may say what, and who is answered.

A zenoh session hands on between its clients whatever it is not told to keep: without these rules one client could read
another's increments with their lease, publish states, and answer a stop in the server's stead. All that the table does
not name is denied; anybody may listen, and gets what the table lets the session say.
"""

from __future__ import annotations

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
    """The access control of one party's session in one realm, as zenoh's configuration has it.

    Args:
        party: the party whose session it is.
        realm: the realm of the session.
        cell: name of the cell.
        robot: the only one that it is concerned with; `*`: all.
        speakers: over TLS, the keys that each is heard under, by the name that its certificate proves; None: everybody
            is heard under all that the party reads.
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
