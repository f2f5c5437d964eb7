"""A stop over the lines, when no session can be had."""

from __future__ import annotations

import pytest
from served import Server
from small_cell import small_cell

from deltaq_launch.line_stop import stop_over_a_line
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError


def test_where_nobody_listens_it_is_said() -> None:
    with pytest.raises(ServiceUnreachableError):
        stop_over_a_line(small_cell())


def test_it_is_obeyed_and_confirmed_or_said_not_to_be() -> None:
    with Server() as server:
        assert stop_over_a_line(server.description).what == "stop"
        assert server.peer.commands.get_nowait().kind == "stop"
        server.peer.obeys = False
        with pytest.raises(RefusedError, match="did not answer"):
            stop_over_a_line(server.description)
