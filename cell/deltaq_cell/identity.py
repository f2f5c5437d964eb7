"""The hash of a cell's description: of its content, not of the bytes of its file.

A comment, the order of fields, `10` or `10.0`, and whether it extends another cell change nothing. Addresses and
paths of files may differ between hosts and are left out, and so is equipment, which decides nothing; the content of
a robot's model files is hashed.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_protocol.identity import CellIdentity

_PLACES = {
    "hli",
    "sim",
    "tcp_address",
    "tcp_port",
    "console_address",
    "console_port",
    "clients_need_tokens",
    "anyone_who_connects_may_move_the_robots",
    "equipment",
}
_PLACES_OF_ROBOT = {"server", "model"}
_PLACES_OF_CAMERA = {"source", "source_right"}
_PLACES_OF_DRIVER = {"address", "port", "control_port", "krc_address", "ethernet_xml"}


def content_identity(cell: CellDescription) -> CellIdentity:
    """Identity of a cell, from its description alone."""
    fields = cell.model_dump(mode="json", exclude=_PLACES)
    for robot in fields["robots"].values():
        _leave_out(robot, _PLACES_OF_ROBOT)
        _leave_out(robot["driver"], _PLACES_OF_DRIVER)
        _leave_out(robot["camera"] or {}, _PLACES_OF_CAMERA)
    return CellIdentity(cell.cell, _hash(fields))


def cell_identity(
    cell: CellDescription, urdf: Mapping[str, str], hulls: Mapping[str, Mapping[str, Any]]
) -> CellIdentity:
    """The identity of a cell with the bodies of its robots: by robot the URDF text, and the hulls of its meshes."""
    content = content_identity(cell)
    return CellIdentity(content.name, content.content, _hash([dict(urdf), dict(hulls)]))


def _leave_out(fields: dict[str, Any], names: set[str]) -> None:
    for name in names:
        fields.pop(name, None)


def _hash(fields: Any) -> str:
    # the order of robots, joints and bodies matters: vectors and decisions follow it
    return hashlib.sha256(json.dumps(fields).encode()).hexdigest()[:16]
