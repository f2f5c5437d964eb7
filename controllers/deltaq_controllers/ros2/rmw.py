"""The names of rmw_zenoh: key expressions, liveliness tokens, quality of service, attachments.

Pure text and bytes. Source: github.com/ros2/rmw_zenoh, `docs/design.md` ("Topic and Service name mapping", "Graph
Cache", "Publishers") and, for quality of service, `qos_to_keyexpr` in `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp`.
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from typing import Self

from deltaq_controllers.ros2.messages import RefusedMessageError, RosType
from deltaq_protocol.errors import DeltaqError

MAX_DOMAIN_ID = 232
"""The most that DDS has ports for, and ROS 2 therefore documents."""

_TOKEN = "@ros2_lv"
_NODE_ID = 0
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{_GID_BYTES}s")


@dataclass(frozen=True, slots=True)
class RosNode:
    """A node, the only one of its zenoh session.

    Attributes:
        domain_id: of ROS, by which graphs are kept apart.
        session_id: zenoh's identifier of the session, in hexadecimal digits.
        namespace: e.g. `/lab`; `/` is the empty one.
        name: of the node.
    """

    domain_id: int
    session_id: str
    namespace: str
    name: str

    @property
    def token(self) -> str:
        """The liveliness token that shows the node in the graph."""
        return self._token(_NODE_ID, "NN")

    def publisher(self, number: int, topic: str, kind: RosType, depth: int) -> RosEndpoint:
        """A publisher of the node; `number` is its own among the node's endpoints, from 1."""
        return self._endpoint(number, "MP", topic, kind, depth)

    def subscription(self, number: int, topic: str, kind: RosType, depth: int) -> RosEndpoint:
        """A subscription of the node; `number` as of `publisher`."""
        return self._endpoint(number, "MS", topic, kind, depth)

    def _endpoint(self, number: int, entity: str, topic: str, kind: RosType, depth: int) -> RosEndpoint:
        parts = _mangled(topic), kind.dds_name, kind.hash, _quality(depth)
        token = "/".join((self._token(number, entity), *parts))
        return RosEndpoint(topic_key(self.domain_id, topic, kind), token)

    def _token(self, number: int, entity: str) -> str:
        no_enclave = "%"
        parts = (_TOKEN, self.domain_id, self.session_id, _NODE_ID, number, entity, no_enclave)
        return "/".join(map(str, (*parts, _mangled(self.namespace), self.name)))


@dataclass(frozen=True, slots=True)
class RosEndpoint:
    """A publisher or a subscription: zenoh's key for the data, and the token that shows it in the graph."""

    key: str
    token: str

    @property
    def gid(self) -> bytes:
        """16 bytes that identify it.

        Rmw_zenoh uses another hash of the token; receivers only compare gids with each other.
        """
        return hashlib.blake2b(self.token.encode(), digest_size=_GID_BYTES).digest()


@dataclass(frozen=True, slots=True)
class RosAttachment:
    """The attachment of every message.

    Attributes:
        sequence: number of the message, from 1.
        time_ns: when it was sent, since the epoch [ns].
        gid: of its publisher.
    """

    sequence: int
    time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """33 bytes: both numbers little-endian in 8 bytes, the length of the gid in one, and the gid."""
        return _ATTACHMENT.pack(self.sequence, self.time_ns, _GID_BYTES, self.gid)

    @classmethod
    def decode(cls, attachment: bytes | None) -> Self:
        """Read an attachment from bytes.

        Raises:
            RefusedMessageError: they are no such attachment, or there is none.
        """
        if attachment is None or len(attachment) != _ATTACHMENT.size:
            size = "missing" if attachment is None else f"{len(attachment)} bytes long"
            raise RefusedMessageError("attachment", "attachment", size, f"{_ATTACHMENT.size} bytes")
        sequence, time_ns, gid_bytes, gid = _ATTACHMENT.unpack(attachment)
        if gid_bytes != _GID_BYTES:
            raise RefusedMessageError(
                "attachment", "attachment.gid", f"of length {gid_bytes}", str(_GID_BYTES)
            )
        return cls(sequence, time_ns, gid)


def topic_key(domain_id: int, topic: str, kind: RosType) -> str:
    """The zenoh key of a topic's data."""
    return f"{domain_id}/{topic.strip('/')}/{kind.dds_name}/{kind.hash}"


def ros_name(name: str) -> str:
    """A name of deltaq as ROS allows it: `lab-4ms` is `lab_4ms`."""
    return re.sub("_+", "_", name.replace("-", "_"))


def checked_namespace(namespace: str) -> str:
    """A namespace such as `/lab` or `/plant/cell_2`; `/` is the empty one.

    Raises:
        DeltaqError: it is none.
    """
    parts = namespace.split("/")[1:]
    if namespace == "/" or (namespace[:1] == "/" and all(map(_is_name, parts))):
        return namespace
    raise DeltaqError(
        f"no ROS namespace: {namespace!r}; write / or names behind slashes, of letters, digits and single "
        "underscores, none beginning with a digit, e.g. /lab"
    )


def checked_domain_id(domain_id: int) -> int:
    """A domain.

    Raises:
        DeltaqError: it is out of bounds.
    """
    if 0 <= domain_id <= MAX_DOMAIN_ID:
        return domain_id
    raise DeltaqError(f"ROS domain {domain_id}: allowed are 0 to {MAX_DOMAIN_ID}")


def _is_name(name: str) -> bool:
    return _NAME.fullmatch(name) is not None and "__" not in name


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _quality(depth: int) -> str:
    """Reliable, volatile, the last `depth` kept: of these only the depth differs from rmw_zenoh's defaults."""
    return f"::,{depth}:,:,:,,"
