"""The Robot Server's end of the guarded realm: ring channels in, publishers out."""

from collections import Counter
from collections.abc import Callable
from typing import Any, TypeVar

from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.envelope import Envelopes, StaleMessageError, message_in
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.guarded import Admission, Health, ServerState, Supervision
from deltaq_protocol.heartbeat import Heartbeat
from deltaq_protocol.inbox import called_in_zenohs_threads
from deltaq_protocol.messages import Message
from deltaq_protocol.sayings import robot_server
from deltaq_protocol.session import declare_publisher, subscribe_newest
from deltaq_protocol.stamps import CycleOutcome, Stamps, StampStation, stamps_if_asked
from deltaq_protocol.topic import Party, Topic
from deltaq_services.guarded_realm import open_guarded_session
from deltaq_services.phases import MAY_MOVE
from deltaq_services.rate_limit import Pace

# Stamps of a Robot Server, taken only if the environment asks for them; see `deltaq_protocol.stamps`.


class CycleStamps:
    """Stamps each telegram, state and admission on arrival.

    The loop reads its ring channel only with the next telegram, so admissions have a subscriber of their own here.

    Args:
        stamps: receives the stamps.
        session: of the Robot Server.
        key: of its admissions.
    """

    def __init__(self, stamps: Stamps, session: Any, key: str) -> None:
        self._stamps = stamps
        self._last: ServerState | None = None
        self._subscriber = session.declare_subscriber(key, called_in_zenohs_threads(self._admission_came))

    def published(self, state: ServerState) -> None:
        """Stamp the telegram of a cycle, and its just published state."""
        outcome = outcome_of(state, self._last)
        self._last = state
        self._stamps.add(StampStation.STATE_OUT, state.robot, state.cycle, outcome)
        self._stamps.add(StampStation.TELEGRAM, state.robot, state.cycle, time_ns=round(state.time_s * 1e9))

    def _admission_came(self, sample: Any) -> None:
        try:
            admission = unpack(Admission, message_in(sample.payload.to_bytes()))
        except ProtocolError:
            return  # the loop counts it
        self._stamps.add(StampStation.ADMISSION_AT_SERVER, admission.robot, admission.cycle)


def outcome_of(state: ServerState, last: ServerState | None) -> CycleOutcome:
    """What the robot was sent in the cycle of `state`, `last` being the state before."""
    if state.phase not in MAY_MOVE:
        return CycleOutcome.HELD
    if last is not None and _missed(state) > _missed(last):
        return CycleOutcome.REPLY_MISSED
    fresh = state.plan.step == 0 and (last is None or state.sequence != last.sequence)
    return CycleOutcome.FRESH if fresh else CycleOutcome.BRAKED


def _missed(state: ServerState) -> int:
    return state.counters.get("reply_missed", 0)


M = TypeVar("M", bound=Message)

_WAITING = 32
"""Messages of a kind that may wait for a cycle. The gate sends one, or a few after a pause of the machine."""


class GuardedLink:
    """zenoh session of one Robot Server.

    Args:
        cell: the cell.
        robot: the robot's name.
        counters: counts malformed messages.

    Raises:
        GuardedRealmError: its endpoint is open to other users.
        RuntimeFolderError: the folder of the sockets is not this user's alone.
        ServiceUnreachableError: if its endpoint cannot be listened on.
    """

    def __init__(self, cell: CellDescription, robot: str, counters: Counter[str]) -> None:
        self._counters = counters
        self._identity = str(content_identity(cell))
        self._service = robot_server(robot)
        self._envelopes = Envelopes(self._service, cell.cell, tuple(cell.robots))
        self._session: Any = open_guarded_session(
            cell, Party.ROBOT_SERVER, self._service, listen=[self._service], robot=robot
        )
        admission_key = topics.ADMISSION.key(cell.cell, robot=robot)
        supervision_key = topics.SUPERVISION.key(cell.cell, robot=robot)
        self._admissions = subscribe_newest(self._session, admission_key, _WAITING)
        self._supervisions = subscribe_newest(self._session, supervision_key, _WAITING)
        self._state = self._publisher(topics.SERVER_STATE, cell.cell, robot=robot)
        self._health = self._publisher(topics.HEALTH, cell.cell, service=self._service)
        self._heartbeat = Heartbeat()
        self._pace = Pace(topics.HEALTH.period_s(cell.cycle_s))
        stamps = stamps_if_asked(self._service, [robot])
        self._stamps = None if stamps is None else CycleStamps(stamps, self._session, admission_key)

    def admissions(self) -> list[Admission]:
        """The admissions since the last call, in the order in which they came."""
        return self._received(self._admissions, Admission)

    def supervision(self) -> Supervision | None:
        """The newest heartbeat of the gate since the last call, if any."""
        received = self._received(self._supervisions, Supervision)
        return received[-1] if received else None

    def heard(self) -> list[Admission | Supervision]:
        """The admissions since the last call, and the newest heartbeat of the gate, if any."""
        supervision = self.supervision()
        return [*self.admissions(), *([] if supervision is None else [supervision])]

    def publish(self, state: ServerState | None, time_s: float, detail: Callable[[], str] = str) -> None:
        """Publish the state, and at the pace of the table of topics a heartbeat, for which alone `detail` is asked."""
        if state is not None:
            self._state.put(pack(state))
            if self._stamps is not None:
                self._stamps.published(state)
        if self._pace.due(time_s):
            health = Health(
                service=self._service,
                healthy=True,
                detail=detail(),
                time_s=time_s,
                counters=dict(self._counters),
                cell=self._identity,
            )
            self._health.put(pack(health))
            self._heartbeat.beat(time_s, detail=health.detail)

    def close(self) -> None:
        """End the session."""
        self._heartbeat.close()
        self._session.close()

    def _publisher(self, topic: Topic, cell: str, **fields: str) -> Any:
        return declare_publisher(self._session, topic.key(cell, **fields), self._envelopes, topic.priority)

    def _received(self, waiting: Any, message_type: type[M]) -> list[M]:
        name = message_type.__name__.lower()
        received: list[M] = []
        for _ in range(_WAITING):  # no more: others may send faster than they are read
            sample = waiting.try_recv()
            if sample is None:
                break
            try:
                opened = self._envelopes.open(str(sample.key_expr), sample.payload.to_bytes())
                received.append(unpack(message_type, opened))
            except StaleMessageError:
                self._counters[f"stale_{name}"] += 1
            except InvalidMessageError:
                self._counters[f"invalid_{name}"] += 1
        return received
