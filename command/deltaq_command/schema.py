"""`deltaq schema`."""

from __future__ import annotations

from typing import Annotated, Any

import typer


def schema(
    topic: Annotated[str | None, typer.Argument(help="Only this topic.", show_default=False)] = None,
) -> None:
    """Print the JSON Schema of every message, enough to write a controller in another language."""
    import json

    from deltaq_command.topics import by_name
    from deltaq_protocol.topics import TOPICS

    chosen = TOPICS if topic is None else (by_name(topic),)
    document: dict[str, Any] = {
        row.name: {
            "key": row.template,
            "realm": row.realm.value,
            "kind": row.kind.value,
            "publishers": [party.value for party in row.publishers],
            "readers": [party.value for party in row.readers],
            "rate": row.rate_text,
            "max_age_cycles": row.max_age_cycles,
            "max_age_s": row.max_age_s,
            "priority": row.priority.value,
            "message": row.message.model_json_schema(),
            "reply": row.reply.model_json_schema() if row.reply else None,
        }
        for row in chosen
    }
    if topic is None:
        document["json-lines"] = _lines()
    typer.echo(json.dumps(document, indent=2))


def _lines() -> dict[str, Any]:
    from deltaq_protocol import messages

    types = (messages.Hello, messages.Welcome, messages.Error, messages.Done)
    return {"only over TCP": [message.model_json_schema() for message in types]}
