"""Messages with extreme values, derived from the schema of their model: a new message needs no code here."""

import copy
from collections.abc import Iterator
from functools import cache
from random import Random
from typing import Any

import msgpack
from pydantic import TypeAdapter

from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.messages import Message

NUMBERS = (
    0.0,
    -0.0,
    5e-324,
    -5e-324,
    1e-300,
    1.0,
    -1.0,
    1e6,
    -1e6,
    1e30,
    -1e30,
    1e300,
    -1e300,
    1.7e308,
    -1.7e308,
)
COUNTS = (0, 1, -1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, -(2**63), 2**64 - 1)
TEXTS = ("", "a", "fr", "gr", "gripper", "ä" * 60, "a" * 64, "a" * 65, "\0", "x" * 5000, "*", "../gr")
ROBOTS = ("fr", "gr")
INVALID = 0.2


@cache
def schema_of(kind: Any) -> dict[str, Any]:
    """Its JSON schema."""
    adapter = kind if isinstance(kind, TypeAdapter) else TypeAdapter(kind)
    return adapter.json_schema()


class Extremes:
    """Changes messages of one type.

    Args:
        kind: the model, or whatever `TypeAdapter` takes.
        random: what it draws from.

    Attributes:
        invalid: share of values that may lie outside their bounds.
    """

    def __init__(self, kind: Any, random: Random) -> None:
        self._schema = schema_of(kind)
        self._random = random
        self.invalid = INVALID

    def valid(self) -> Any:
        """A message as a map, in all likelihood a valid one."""
        before, self.invalid = self.invalid, 0.0
        made, self.invalid = self._fresh(self._schema), before
        return made

    def changed(self, data: Any) -> Any:
        """A valid message as a map, with values in some places that are extreme or of no message at all."""
        data = copy.deepcopy(data)
        for _ in range(self._random.choice((1, 1, 2, 4))):
            data = self._changed(self._schema, data)
        return data

    def _changed(self, schema: dict[str, Any], old: Any) -> Any:
        draw, schema = self._random, self._resolved(schema, old)
        if isinstance(old, dict) and (fields := schema.get("properties")):
            name = draw.choice([*fields])
            old[name] = self._changed(fields[name], old.get(name))
            return old
        if isinstance(old, list | tuple) and old and draw.random() < 0.9:
            old, items = list(old), schema.get("items", {})
            everywhere = draw.random() < 0.3
            for place in range(len(old)) if everywhere else [draw.randrange(len(old))]:
                each = schema["prefixItems"][place] if "prefixItems" in schema else items
                old[place] = self._changed(each, old[place])
            return old
        return self._fresh(schema)

    def _resolved(self, schema: dict[str, Any], old: Any = None) -> dict[str, Any]:
        while True:
            if "$ref" in schema:
                schema = self._schema["$defs"][schema["$ref"].rpartition("/")[2]]
            elif branches := schema.get("anyOf") or schema.get("oneOf"):
                kinds = [self._resolved(branch) for branch in branches]
                like = [kind for kind in kinds if kind.get("type") != "null"] if old is not None else kinds
                tagged = [
                    kind
                    for kind in like
                    if _tag(kind) and isinstance(old, dict) and _tag(kind) in old.values()
                ]
                schema = self._random.choice(tagged or like or kinds)
            else:
                return schema

    def _fresh(self, schema: dict[str, Any]) -> Any:
        draw, schema = self._random, self._resolved(schema)
        if "const" in schema or "enum" in schema:
            named = schema.get("enum", [schema.get("const")])
            return draw.choice(TEXTS if draw.random() < self.invalid else named)
        match schema.get("type"):
            case "number":
                return self._bounded(schema, NUMBERS)
            case "integer":
                return self._bounded(schema, COUNTS)
            case "boolean":
                return draw.random() < 0.5
            case "null":
                return None
            case "array":
                if "prefixItems" in schema:
                    return [self._fresh(item) for item in schema["prefixItems"]]
                counts = [0, 1, 6, 6, 9, schema.get("minItems", 0), schema.get("maxItems", 33)]
                return [self._fresh(schema.get("items", {})) for _ in range(draw.choice(counts))]
            case "object" if "properties" in schema:
                return {name: self._fresh(field) for name, field in schema["properties"].items()}
            case "object":
                inner = schema.get("additionalProperties") or {}
                return {draw.choice(TEXTS): self._fresh(inner) for _ in range(draw.choice((0, 1, 3, 70)))}
        return draw.choice(ROBOTS if "pattern" in schema and draw.random() >= self.invalid else TEXTS)

    def _bounded(self, schema: dict[str, Any], values: tuple[Any, ...]) -> Any:
        low, high = schema.get("minimum", float("-inf")), schema.get("maximum", float("inf"))
        bounds = [value for value in (low, high) if abs(value) != float("inf")]
        inside = [value for value in (*values, *bounds) if low <= value <= high]
        return self._random.choice(values if self._random.random() < self.invalid or not inside else inside)


def _tag(schema: dict[str, Any]) -> Any:
    """What tells a message of a union from the others."""
    return next((field["const"] for field in schema.get("properties", {}).values() if "const" in field), None)


def extreme(message: Message, random: Random, count: int) -> Iterator[Message]:
    """Of so many changed messages those that are valid, as they come from a wire."""
    extremes, data = Extremes(type(message), random), message.model_dump()
    for _ in range(count):
        try:
            payload = msgpack.packb(extremes.changed(data))
        except (OverflowError, UnicodeEncodeError):
            continue
        try:
            yield unpack(type(message), payload)
        except InvalidMessageError:
            continue


def sent_and_read(message: Message) -> None:
    """What a core says has to be a message to whoever reads it."""
    assert unpack(type(message), pack(message)) == message
