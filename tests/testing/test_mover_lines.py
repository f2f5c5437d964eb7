"""The mover of the faults, at the other end of a real socket."""

import contextlib
import json
import socket
import threading

from deltaq_testing.faults import mover


def test_the_mover_numbers_only_its_sent_increments() -> None:
    """States that come before the lease have no answer, and take no number: who counts verdicts would miss them."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        moving = threading.Thread(target=_move, args=(listener.getsockname()[1],))
        moving.start()
        line, _ = listener.accept()
        with line, line.makefile("r") as lines:

            def say(**message: object) -> None:
                line.sendall(json.dumps(message).encode() + b"\n")

            assert [json.loads(lines.readline())["type"] for _ in range(2)] == ["hello", "lease"]
            say(type="welcome", cycle_s=0.012)
            for cycle in (1, 2):
                say(type="state", robot="fr", cycle=cycle, q=[0.0] * 6, q_cmd=[0.0] * 6)
            say(type="lease", granted=True)
            for cycle in (3, 4):
                say(type="state", robot="fr", cycle=cycle, q=[0.0] * 6, q_cmd=[0.0] * 6)
            sent = [json.loads(lines.readline()) for _ in range(2)]
    moving.join()
    assert [(one["type"], one["seq"], one["cycle"]) for one in sent] == [
        ("increment", 1, 3),
        ("increment", 2, 4),
    ]


def _move(port: int) -> None:
    with contextlib.suppress(OSError, ValueError):
        mover._move(port, "fr", 0.0)
