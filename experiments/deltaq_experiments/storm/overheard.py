"""What the gate admits and the Robot Server tells, read off the guarded realm; who reads is heard by nobody."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.session import open_session, subscribe_newest
from deltaq_services.guarded_key import guarded_seal

_WAITING = 4096
"""Admissions that may wait between two looks: more than half a minute's."""


class Overheard:
    """A context manager; `take` has to be called now and then.

    Attributes:
        admissions: every one of the robot, in the order in which they came.
        counters: of the Robot Server, as its newest state has them.
    """

    def __init__(self, cell: CellDescription, robot: str) -> None:
        self.admissions: list[Admission] = []
        self.counters: dict[str, int] = {}
        self._seal = guarded_seal(cell)
        self._session = open_session(connect=[cell.sim, cell.robots[robot].server], must_connect=True)
        admission = topics.ADMISSION.key(cell.cell, robot=robot)
        self._admissions = subscribe_newest(self._session, admission, _WAITING)
        self._states = subscribe_newest(self._session, topics.SERVER_STATE.key(cell.cell, robot=robot))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()

    def take(self) -> None:
        """Take in what has come."""
        while (sample := self._admissions.try_recv()) is not None:
            data = self._seal.open(str(sample.key_expr), sample.payload.to_bytes())
            self.admissions.append(unpack(Admission, data))
        sample = self._states.try_recv()
        if sample is not None:
            data = self._seal.open(str(sample.key_expr), sample.payload.to_bytes())
            self.counters = unpack(ServerState, data).counters
