"""How the increments of a leased robot leave this process: each with its proof, and with those that it repeats."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import zenoh

from deltaq_protocol import topics
from deltaq_protocol.codec import pack
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import EarlierIncrement, Increment, Sight, ViewTarget
from deltaq_protocol.proof import Prover
from deltaq_protocol.stamps import StampStation, stamps_if_asked
from deltaq_protocol.wire import Wire

REPEATED = 2
"""Increments that each one repeats where the lease has a playout buffer: of links that lose a packet in a hundred,
three in a row are lost once in three hours."""


class IncrementsOut:
    """Sends a robot's increments; any thread may.

    Args:
        wire: to the server.
        cell: name of the cell.
        robot: name of the robot.
        prover: shows that they are the holder's of the lease.
        playout: they wait in the HLI, so each repeats those before it.
    """

    def __init__(self, wire: Wire, cell: str, robot: str, prover: Prover, playout: bool) -> None:
        self._robot = robot
        self._prover = prover
        self._key = topics.INCREMENT.key(cell, robot=robot)
        self._publisher = wire.publisher(topics.INCREMENT, cell, robot)
        self._stamps = stamps_if_asked(f"client-{robot}", [robot])
        self._earlier: deque[EarlierIncrement] = deque(maxlen=REPEATED if playout else 0)

    def state_came(self, cycle: int) -> None:
        """Stamp that the controller has taken the state of a cycle."""
        if self._stamps is not None:
            self._stamps.add(StampStation.STATE_AT_CLIENT, self._robot, cycle)

    def send(
        self, dq: Iterable[float], seq: int, cycle: int, sight: Sight | None, target: ViewTarget | None
    ) -> None:
        """Send the increment `dq` (n,) [rad or m] in answer to the state of a cycle.

        Raises:
            ServiceUnreachableError: the connection was closed.
        """
        # not validated here: only the server decides what is refused
        increment = Increment.model_construct(
            robot=self._robot,
            seq=seq,
            cycle=cycle,
            dq=tuple(float(element) for element in dq),
            sight=sight,
            target=target,
            earlier=tuple(self._earlier),
        )
        self._earlier.append(EarlierIncrement.model_construct(seq=seq, cycle=cycle, dq=increment.dq))
        if self._stamps is not None:
            self._stamps.add(StampStation.INCREMENT_OUT, self._robot, cycle, seq)
        payload = pack(increment)
        try:
            self._publisher.put(payload, attachment=self._prover.prove(self._key, payload))
        except zenoh.ZError as error:
            raise ServiceUnreachableError(
                f"{self._robot} cannot be moved: the connection was closed; connect again"
            ) from error

    def end(self) -> None:
        """Send nothing more.

        Raises:
            ZError: the connection was closed already.
        """
        self._publisher.undeclare()
