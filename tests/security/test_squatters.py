"""Whoever sits where SIM and Robot Servers should be, without the key, is nobody to the HLI."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from guarded_peer import guarded_peer
from small_cell import server_state, small_cell, told, tool_pose

from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_protocol import topics
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import CommandReply, Health
from deltaq_protocol.messages import Message, Outcome, Phase, Verdict
from deltaq_protocol.seal import Seal
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey
from deltaq_protocol.session import open_session
from deltaq_services.hli.shell import Hli

NAME = "small"


def lies(cell: CellDescription) -> Iterator[tuple[str, Message]]:
    """What a cell that runs would say."""
    identity = str(content_identity(cell))
    for name, robot in cell.robots.items():
        zeros = (0.0,) * len(robot.joints)
        yield topics.SERVER_STATE.key(NAME, robot=name), server_state(name, cell=identity)
        verdict = Verdict(robot=name, cycle=100, seq=1, outcome=Outcome.ADMITTED, scale=1.0, dq=zeros)
        yield topics.GATE_VERDICT.key(NAME, robot=name), verdict
    health = Health(service="sim", healthy=True, time_s=1.0, cell=identity, epoch=1, newest_id=2**60)
    yield topics.HEALTH.key(NAME, service="sim"), health
    yield topics.COMMAND_REPLY.key(NAME), CommandReply(id=1, accepted=True)


async def until(reached: Callable[[], Any], say: Callable[[], None]) -> None:
    """Say it again until something comes of it: who connects is not there at once."""
    async with asyncio.timeout(300):
        while not reached():
            say()
            await asyncio.sleep(0)


def believes_nobody(hli: Hli) -> bool:
    status = hli.status()
    phases = {robot.phase for robot in status.robots.values()}
    return status.gate_age_s is None and not status.gate and phases == {Phase.OFFLINE}


@pytest.mark.parametrize("key", [None, bytes(KEY_BYTES)], ids=["unsealed", "a guessed key"])
async def test_the_hli_believes_nobody_who_lacks_the_key(key: bytes | None) -> None:
    cell = small_cell()
    squatter = open_session(listen=[cell.sim, *(robot.server for robot in cell.robots.values())])
    guessed = None if key is None else Seal(RealmKey(key))
    try:
        async with Hli(cell, told(cell), tool_pose) as hli:

            def lie() -> None:
                for where, message in lies(cell):
                    packed = pack(message)
                    squatter.put(where, packed if guessed is None else guessed.close(where, packed))

            await until(lambda: hli.status().hli.get("forged_guarded", 0) > 50, lie)
            assert believes_nobody(hli)
    finally:
        squatter.close()


async def test_a_recording_says_nothing_to_an_hli_that_has_just_started() -> None:
    cell = small_cell()
    endpoints = [cell.sim, *(robot.server for robot in cell.robots.values())]
    recording: list[tuple[str, bytes]] = []
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose):
        ear = open_session(connect=endpoints, must_connect=True)
        heard = ear.declare_subscriber(f"deltaq-guarded/{NAME}/**", zenoh.handlers.RingChannel(1000))
        health = Health(
            service="sim", healthy=True, time_s=1.0, cell=str(content_identity(cell)), epoch=1, newest_id=1
        )
        await peer.turn(cycles=20)

        def listen() -> None:
            peer.publish_from_sim(topics.HEALTH.key(NAME, service="sim"), health)
            while (sample := heard.try_recv()) is not None:
                recording.append((str(sample.key_expr), sample.payload.to_bytes()))

        await until(lambda: {"sim", "state"} <= {key.rpartition("/")[2] for key, _ in recording}, listen)
        ear.close()
    squatter = open_session(listen=endpoints)
    try:
        async with Hli(cell, told(cell), tool_pose) as hli:

            def repeat() -> None:
                for where, sealed in recording:
                    squatter.put(where, sealed)

            await until(lambda: hli.status().hli.get("unbound_guarded", 0) > 50, repeat)
            assert believes_nobody(hli)
    finally:
        squatter.close()
