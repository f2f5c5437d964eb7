"""What the gate admits and the Robot Server tells, read off the guarded realm; who reads is heard by nobody.

zenoh drops what a link cannot take at once. So each admission is read twice: as the Robot Server gets it, and from the
gate's own log.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import message_in
from deltaq_protocol.guarded import Admission, GateEntry, ServerState
from deltaq_protocol.sayings import SIM, robot_server
from deltaq_protocol.session import subscribe_newest
from deltaq_services.guarded_realm import guarded_links, open_watching_session

_WAITING = 4096
"""Messages that may wait between two looks: more than ten seconds' of the gate's log."""


class Overheard:
    """A context manager; `take` has to be called now and then.

    Attributes:
        admissions: every one to any robot that was heard, by its sequence.
        counters: of the Robot Server, as its newest state has them.
    """

    def __init__(self, cell: CellDescription, robot: str) -> None:
        self.admissions: dict[int, Admission] = {}
        self.counters: dict[str, int] = {}
        self._session = open_watching_session(cell, SIM, [guarded_links(cell)[robot_server(robot)]])
        admission = topics.ADMISSION.key(cell.cell, robot="*")
        self._admissions = subscribe_newest(self._session, admission, _WAITING)
        self._log = subscribe_newest(self._session, topics.GATE_LOG.key(cell.cell), _WAITING)
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
            self._heard(message_in(sample.payload.to_bytes()))
        while (sample := self._log.try_recv()) is not None:
            for name, data in unpack(GateEntry, sample.payload.to_bytes()).outputs:
                if name == topics.ADMISSION.name:
                    self._heard(data)
        sample = self._states.try_recv()
        if sample is not None:
            self.counters = unpack(ServerState, message_in(sample.payload.to_bytes())).counters

    def _heard(self, data: bytes) -> None:
        admission = unpack(Admission, data)
        self.admissions[admission.sequence] = admission
