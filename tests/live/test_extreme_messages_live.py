"""A flood of extreme messages at a running cell: both robots go on, and no service has failed."""

from __future__ import annotations

import json
from random import Random

import msgpack
import pytest
from extremes import Extremes
from test_socket_script import connected

from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol import topics
from deltaq_protocol.messages import Phase
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Kind, Party, Realm

pytestmark = pytest.mark.live
ROUNDS = 15


def test_a_flood_of_extreme_messages_stops_no_robot_and_ends_no_service(moving_stack):
    random, cell = Random(5), moving_stack.cell
    rows = [row for row in topics.TOPICS if row.realm is Realm.OPEN and Party.CLIENT in row.publishers]
    rows = [row for row in rows if row is not topics.STOP]  # it is obeyed, whatever it says
    session = open_session(connect=[cell.hli], must_connect=True)
    try:
        with connected(moving_stack, "flood") as lines:
            lines.send(type="lease", robot="gr", action="acquire")
            assert lines.receive("lease")["granted"]
            for number in range(ROUNDS):
                cycle = lines.receive("state", robot="gr")["cycle"]
                for dq in ([3e304] * 9, [-1e6] * 9, [5e-324] * 9):
                    lines.send(type="increment", robot="gr", seq=3 * number, cycle=cycle, dq=dq)
                    lines.send(type="dry_run", robot="fr", dq=dq[:6])
                for row in rows:
                    extremes = Extremes(row.message, random)
                    said = extremes.changed(extremes.valid())
                    if said.get("action") == "take":
                        continue  # whoever may does
                    if said.get("type") != "stop":
                        lines.send_text(json.dumps(said))
                    payload = msgpack.packb(said)
                    key = row.key(cell.cell, robot="fr")
                    if row.kind is Kind.QUERY:
                        assert [*session.get(key, payload=payload, timeout=20)], row.name
                    else:
                        session.put(key, payload)
            lines.send(type="describe")
            lines.receive("description")
            with connect(cell, "test") as running:
                status = running.status()
    finally:
        session.close()
    assert status.robots["fr"].phase in (Phase.ENGAGED, Phase.BRAKING)
    assert status.robots["gr"].phase is not Phase.HELD
    assert "internal_errors" not in status.gate | status.hli
    assert "failed" not in status.hli
