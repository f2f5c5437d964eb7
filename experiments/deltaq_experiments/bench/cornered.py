"""Stored situations near obstacles that cost the gate most time.

`python -m studies.cornered` found them. Adversaries drive both robots of the lab cell into each other and into
the structure, over several seeds, and each decision is timed. Kept are the gate's memory before a decision and the
request that it decided, of those that took longest.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import msgpack

from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import GateMemory, Request

CELL = "lab"
"""The cell that the situations are of."""
FILE = Path(__file__).with_name("cornered.msgpack.gz")


class CorneredError(DeltaqError):
    """The stored situations cannot be read."""


@dataclass(frozen=True)
class CorneredSituation:
    """The inputs of one decision.

    Attributes:
        memory: of the gate.
        request: the request to decide.
    """

    memory: GateMemory
    request: Request


def stored(file: Path = FILE) -> list[CorneredSituation]:
    """The stored situations.

    Raises:
        CorneredError: if the file is damaged.
        InvalidMessageError: if its messages are not those of this version.
    """
    try:
        pairs = msgpack.unpackb(gzip.decompress(file.read_bytes()))
        split = [(bytes(memory), bytes(request)) for memory, request in pairs]
    except (OSError, EOFError, ValueError, TypeError) as error:
        raise CorneredError(f"{file} holds no situations: {error}; write it anew") from error
    return [CorneredSituation(unpack(GateMemory, one), unpack(Request, other)) for one, other in split]
