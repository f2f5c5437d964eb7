"""The messages as protobuf: descriptors made at run time from the pydantic models, and values both ways.

The models stay the one source. Every schema is fully qualified (`deltaq.RobotState`), fields have the models'
names and are numbered in their order. Enumerations keep their names (`PHASE_HELD`), after a zero that means "not
given"; optional fields have presence; an empty list stands for None where a list may be None.
"""

import types
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from deltaq_protocol.codec import InvalidMessageError, from_map
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Message, Name, Real
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topic import Hertz, Kind, Priority, Realm, Topic
from deltaq_protocol.topics import TOPICS

PACKAGE = "deltaq"
_FILE = "deltaq.proto"
_ROW = "Row"
"""A list of numbers within a list, for which protobuf has no type."""

PICTURES_PER_S = 5.0
"""Live pictures that are kept of each stream."""

M = TypeVar("M", bound=Message)
_Proto = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    str: _Proto.TYPE_STRING,
    bool: _Proto.TYPE_BOOL,
    int: _Proto.TYPE_INT64,
    float: _Proto.TYPE_DOUBLE,
    bytes: _Proto.TYPE_BYTES,
}


class PictureReference(Message):
    """A live picture that was taken at `captured_s` (since 1970), and its file in the folder beside the recording."""

    robot: Name
    stream: str
    file: str
    captured_s: Real


PICTURE = Topic(
    "picture", Realm.OPEN, Kind.STREAM, "deltaq/{cell}/{robot}/picture", PictureReference,
    publishers=(), readers=(), rate=Hertz(PICTURES_PER_S), priority=Priority.ORDINARY,
)  # fmt: skip
"""No service publishes it: the recorder asks the service of the picture."""


class SchemaError(DeltaqError):
    """A model has a field whose type has no counterpart in protobuf."""


@dataclass(frozen=True)
class _Type:
    """Type of a field: `kind` of its values, alone, in a list, in a list of lists, or by name."""

    kind: type
    shape: Literal["one", "list", "rows", "map"]
    optional: bool


class ProtobufSchema:
    """Descriptors of some models and of all that they contain.

    Attributes:
        classes: protobuf class of each model.
    """

    def __init__(self, models: Iterable[type[Message]]) -> None:
        file = descriptor_pb2.FileDescriptorProto(name=_FILE, package=PACKAGE, syntax="proto3")
        row = file.message_type.add(name=_ROW)
        row.field.add(name="values", number=1, type=_Proto.TYPE_DOUBLE, label=_Proto.LABEL_REPEATED)
        kinds: dict[type, None] = {}
        for model in models:
            _collect(model, kinds)
        for kind in kinds:
            if issubclass(kind, StrEnum):
                _add_enum(file, kind)
            elif issubclass(kind, Message):
                _add_message(file, kind)
        pool = descriptor_pool.DescriptorPool()
        pool.Add(file)
        self.classes: dict[type, Any] = {
            kind: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{PACKAGE}.{kind.__name__}"))
            for kind in kinds
            if issubclass(kind, Message)
        }

    def encode(self, message: Message) -> Any:
        """The message as a protobuf message."""
        return self.classes[type(message)](**_fields_of(message))


def to_message(message_type: type[M], source: Any) -> M:
    """The message that a protobuf message holds, field by field by name.

    Its descriptor may be that of another version, e.g. the one in a recording.

    Raises:
        InvalidMessageError: if its fields do not make a message of that type.
    """
    try:
        values = _map_of(source, message_type)
    except (
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
    ) as error:  # its descriptor has fields of other types
        raise InvalidMessageError(f"{message_type.__name__}: {error!r}", ReasonCode.MALFORMED) from error
    return from_map(message_type, values)


@cache
def recorded_schema() -> ProtobufSchema:
    """Descriptors of all messages that a recording holds."""
    return ProtobufSchema(topic.message for topic in (*TOPICS, PICTURE) if topic.recorded)


@cache
def _fields(model: type[Message]) -> tuple[tuple[str, _Type], ...]:
    hints = get_type_hints(model)
    return tuple((name, _type_of(hints[name], f"{model.__name__}.{name}")) for name in model.model_fields)


def _type_of(hint: Any, where: str) -> _Type:
    origin, arguments = get_origin(hint), [item for item in get_args(hint) if item is not Ellipsis]
    if origin in (Union, types.UnionType):
        (inner,) = [item for item in arguments if item is not type(None)]
        found = _type_of(inner, where)
        return _Type(found.kind, found.shape, optional=True)
    if origin is Literal:
        return _Type(str, "one", optional=False)
    if origin is dict:
        return _Type(_type_of(arguments[1], where).kind, "map", optional=False)
    if origin is tuple:
        inner = _type_of(arguments[0], where)
        if inner.shape == "list" and inner.kind is float:
            return _Type(float, "rows", optional=False)
        if inner.shape == "one" and len(set(arguments)) == 1:
            return _Type(inner.kind, "list", optional=False)
    elif isinstance(hint, type) and (hint in _SCALARS or issubclass(hint, StrEnum | Message)):
        return _Type(hint, "one", optional=False)
    raise SchemaError(f"{where} is a {hint}, for which there is no protobuf type; record something simpler")


def _collect(kind: type, kinds: dict[type, None]) -> None:
    if kind in _SCALARS or kind in kinds:
        return
    kinds[kind] = None
    if issubclass(kind, Message):
        for _, field_type in _fields(kind):
            _collect(field_type.kind, kinds)


def _add_enum(file: Any, kind: type[StrEnum]) -> None:
    # protobuf wants a zero, and names that are unique in the whole package
    enum = file.enum_type.add(name=kind.__name__)
    for number, name in enumerate(["UNSPECIFIED", *kind.__members__]):
        enum.value.add(name=f"{_prefix(kind)}{name}", number=number)


def _add_message(file: Any, model: type[Message]) -> None:
    message = file.message_type.add(name=model.__name__)
    optional = []
    for number, (name, field_type) in enumerate(_fields(model), start=1):
        field = message.field.add(name=name, number=number, label=_Proto.LABEL_OPTIONAL)
        if field_type.shape == "map":
            entry = message.nested_type.add(name=f"{name.title().replace('_', '')}Entry")
            entry.options.map_entry = True
            entry.field.add(name="key", number=1, type=_Proto.TYPE_STRING, label=_Proto.LABEL_OPTIONAL)
            _set_kind(entry.field.add(name="value", number=2, label=_Proto.LABEL_OPTIONAL), field_type.kind)
            field.type, field.type_name = _Proto.TYPE_MESSAGE, f".{PACKAGE}.{model.__name__}.{entry.name}"
        elif field_type.shape == "rows":
            field.type, field.type_name = _Proto.TYPE_MESSAGE, f".{PACKAGE}.{_ROW}"
        else:
            _set_kind(field, field_type.kind)
        if field_type.shape != "one":
            field.label = _Proto.LABEL_REPEATED
        elif field_type.optional and not issubclass(field_type.kind, Message):
            optional.append(field)
    for field in optional:
        field.proto3_optional = True
        field.oneof_index = len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{field.name}")


def _set_kind(field: Any, kind: type) -> None:
    if kind in _SCALARS:
        field.type = _SCALARS[kind]
        return
    field.type = _Proto.TYPE_ENUM if issubclass(kind, StrEnum) else _Proto.TYPE_MESSAGE
    field.type_name = f".{PACKAGE}.{kind.__name__}"


@cache
def _numbers(kind: type[StrEnum]) -> dict[StrEnum, int]:
    return {member: number for number, member in enumerate(kind, start=1)}


def _fields_of(message: Message) -> dict[str, Any]:
    """The message's fields, as the constructor of its protobuf class takes them."""
    return {
        name: _shaped(value, field_type)
        for name, field_type in _fields(type(message))
        if (value := getattr(message, name)) is not None
    }


def _shaped(value: Any, field_type: _Type) -> Any:
    kind, shape = field_type.kind, field_type.shape
    if shape == "rows":
        return [{"values": row} for row in value]
    if shape == "map":
        return {key: _plain(item, kind) for key, item in value.items()}
    if shape == "list" and kind not in _SCALARS:
        return [_plain(item, kind) for item in value]
    return _plain(value, kind)


def _plain(value: Any, kind: type) -> Any:
    if kind in _SCALARS:
        return value
    return _numbers(kind)[kind(value)] if issubclass(kind, StrEnum) else _fields_of(value)


def _map_of(source: Any, model: type[Message]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    described = source.DESCRIPTOR.fields_by_name
    for name, field_type in _fields(model):
        field = described.get(name)
        if field is None:
            continue  # another version did not have it
        value = getattr(source, name)
        if field_type.shape == "one":
            if not field_type.optional or source.HasField(name):
                values[name] = _value_of(value, field_type.kind, field)
        elif field_type.shape == "map":
            item_field = field.message_type.fields_by_name["value"]
            values[name] = {key: _value_of(value[key], field_type.kind, item_field) for key in value}
        elif field_type.shape == "rows":
            values[name] = tuple(tuple(row.values) for row in value)
        elif len(value) or not field_type.optional:
            values[name] = tuple(_value_of(item, field_type.kind, field) for item in value)
    return values


def _value_of(value: Any, kind: type, field: Any) -> Any:
    if kind in _SCALARS:
        return value
    if issubclass(kind, StrEnum):
        name = field.enum_type.values_by_number[value].name
        return kind.__members__.get(name.removeprefix(_prefix(kind)), name)
    assert issubclass(kind, Message)  # there is no other kind
    return _map_of(value, kind)


def _prefix(kind: type[StrEnum]) -> str:
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in kind.__name__)
    return f"{words.strip('_').upper()}_"
