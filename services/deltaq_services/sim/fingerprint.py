"""The gate's fingerprint: one hash of its code and one of its configuration.

Two gates with the same fingerprint give the same verdicts for the same messages, so it shows that an emulated
and a real cell pass the same gate. Where services listen and how a robot is reached belong to neither hash.
"""

import hashlib
import json
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from deltaq_cell.cell_model import CellModel

_CODE = (
    "deltaq_services.sim",
    "deltaq_services.phases",
    "deltaq_cell",
    "deltaq_protocol.brake",
    "deltaq_protocol.guarded",
    "deltaq_protocol.messages",
    "deltaq_protocol.receipts",
    "deltaq_protocol.topic",
    "deltaq_protocol.topics",
)
"""Packages and modules that decide."""

_LIBRARIES = ("coal", "pin", "numpy", "numba", "llvmlite")
"""Libraries whose arithmetic verdicts depend on, and those that compile it."""

_ELSEWHERE = {
    "hli",
    "sim",
    "tcp_address",
    "tcp_port",
    "lease_s",
    "clients_need_tokens",
    "anyone_who_connects_may_move_the_robots",
    "equipment",
}
_ELSEWHERE_OF_ROBOT = {"server", "driver", "servo_lag", "camera", "model"}


def fingerprint(cell: CellModel) -> str:
    """`CODE-CONFIGURATION`, each sixteen hexadecimal digits."""
    return f"{_code_hash()}-{_configuration_hash(cell)}"


@cache
def _code_hash() -> str:
    digest = hashlib.sha256()
    for name in _CODE:
        spec = find_spec(name)
        assert spec is not None
        assert spec.origin is not None  # this very package
        origin = Path(spec.origin)
        for file in code_files(origin):
            place = file.relative_to(origin.parent).as_posix()
            digest.update(place.encode() + b"\0" + file.read_bytes() + b"\0")
    for library in _LIBRARIES:
        digest.update(f"{library} {version(library)}\n".encode())
    return digest.hexdigest()[:16]


def code_files(origin: Path) -> list[Path]:
    """Source files of a module, or of a package with all packages in it, in an order of their own."""
    return sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]


def _configuration_hash(cell: CellModel) -> str:
    digest = hashlib.sha256()
    left_out = _ELSEWHERE | {"robots"}
    digest.update(cell.description.model_dump_json(exclude=left_out).encode())
    for name, robot in cell.robots.items():
        digest.update(name.encode())
        digest.update(robot.description.model_dump_json(exclude=_ELSEWHERE_OF_ROBOT).encode())
        digest.update(robot.urdf.encode())
        # not the meshes, since a replay has but their hulls
        digest.update(json.dumps(robot.hulls).encode())
    return digest.hexdigest()[:16]
