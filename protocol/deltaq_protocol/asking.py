"""Requests of a client to its server, each answered with a message of its own."""

from __future__ import annotations

from functools import partial
from typing import TypeVar

from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.messages import Challenge, ChallengeRequest, Message
from deltaq_protocol.role_prover import RoleProver
from deltaq_protocol.topic import Topic
from deltaq_protocol.wire import Wire

M = TypeVar("M", bound=Message)


class Asking:
    """Asks the server of a cell; `robot` where the topic's key has one.

    Args:
        wire: to the server.
        cell: name of the cell.
        role: shows the client's role; None if it has none to show.
    """

    def __init__(self, wire: Wire, cell: str, role: RoleProver | None) -> None:
        self._wire = wire
        self._cell = cell
        self._role = role

    async def ask(self, answer: type[M], topic: Topic, request: Message, robot: str = "") -> M:
        """Ask for what anybody may.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: no answer in time.
        """
        return unpack(answer, await self._wire.ask(topic, self._cell, request, robot))

    async def ask_with_role(self, answer: type[M], topic: Topic, request: Message, robot: str = "") -> M:
        """Ask for what a role may; the token or identity, where there is one, answers a challenge and is not sent.

        Raises:
            RefusedError: the server refused the request.
            ServiceUnreachableError: no answer in time.
        """
        prove = None
        if self._role is not None:
            challenge = await self.ask(Challenge, topics.CHALLENGE, ChallengeRequest())
            prove = partial(self._role.prove, nonce=bytes.fromhex(challenge.challenge))
        return unpack(answer, await self._wire.ask(topic, self._cell, request, robot, prove=prove))
