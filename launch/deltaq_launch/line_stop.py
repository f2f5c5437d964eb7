"""A stop over the JSON lines, where places are kept for it: for when no zenoh session can be had."""

from __future__ import annotations

import json
import socket

from deltaq_cell.description import CellDescription
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Done, Error
from deltaq_protocol.reasons import ReasonCode

_DEADLINE_S = 2.0


def stop_over_a_line(cell: CellDescription) -> Done:
    """Bring every robot of a running cell to rest.

    Raises:
        RefusedError: `unreachable`, if not all have shown in time that they are held; they were told all the same.
        ServiceUnreachableError: nobody listens there, or no answer came in time.
    """
    try:
        with socket.create_connection((cell.tcp_address, cell.tcp_port), _DEADLINE_S) as line:
            line.sendall(b'{"type":"stop"}\n')
            with line.makefile("rb") as answers:
                for answer in map(json.loads, answers):
                    if answer["type"] == "done":
                        return Done.model_validate(answer)
                    if answer["type"] == "error" and answer["request"] == "stop":
                        error = Error.model_validate(answer)
                        raise RefusedError(ReasonCode(error.code), error.message, error.hint)
    except (OSError, ValueError) as error:
        raise ServiceUnreachableError(f"no stop over {cell.tcp_address}:{cell.tcp_port}: {error}") from error
    raise ServiceUnreachableError(f"no answer to a stop from {cell.tcp_address}:{cell.tcp_port}")
