"""The HLI's interface for zenoh clients, in the open realm."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import msgpack
import zenoh

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.access import access
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.codec import MAX_MESSAGE_BYTES, InvalidMessageError, pack, unpack
from deltaq_protocol.messages import (
    Challenge,
    Error,
    Increment,
    Message,
    StopRequest,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.sayings import HLI
from deltaq_protocol.session import open_session
from deltaq_protocol.stamps import StampStation, stamps_if_asked
from deltaq_protocol.topic import Party, Realm, Topic
from deltaq_services.guarded_realm import service_tls
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.leases import Sequence
from deltaq_services.hli.requests import ROWS, RequestRow
from deltaq_services.hli.zenoh_session import FloodWait, HliSession
from deltaq_services.outputs import ClientOrigin, Output, Sender
from deltaq_services.rate_limit import RateLimit

if TYPE_CHECKING:
    from deltaq_services.hli.shell import Hli

# Rate filter of increments over zenoh, before the core: checks their proofs and bounds their number.
#
# It works in zenoh's threads. An increment without a valid proof costs one MAC: it is not decoded, and takes no place
# in a queue.

MOST_A_CYCLE = 4
"""Mean number of a holder's increments that are checked in a cycle: one is passed on, newer ones replace the
rest.
"""
MOST_RARE_S = 5.0
"""Answers a second to increments under a lost lease, and to repeated or unnumbered ones. Each answer goes to every
watcher. A replayed increment uses up none of the holder's rate."""
MOST_UNPROVEN_S = 100.0
"""Unproven or excess increments a second that are read without a delay; a correct client sends none."""
_TOLD_APART = 1024
"""Size of the window of sequence numbers of a lease; a jitter buffer holds fewer."""


class Sifted(NamedTuple):
    """An undecoded increment, its robot, and the token of the lease that its proof shows."""

    robot: str
    token: str
    payload: bytes


class Sieve:
    """Rate filter of zenoh increments before the core: drops those without a valid proof, and excess ones.

    It may be called from any thread.

    Args:
        keys: zenoh key of each robot's increments, by robot.
        cycle_s: of the robots.
        authentication: checks the proofs.
        now: monotonic time [s].
    """

    def __init__(
        self,
        keys: Mapping[str, str],
        cycle_s: float,
        authentication: Authentication,
        now: Callable[[], float],
    ) -> None:
        self._robots = {key: robot for robot, key in keys.items()}
        self._authentication = authentication
        self._now = now
        self._rates = {robot: RateLimit(MOST_A_CYCLE / cycle_s) for robot in keys}
        self._rare_rates = {robot: RateLimit(MOST_RARE_S) for robot in keys}
        self._seen: dict[str, tuple[str, Sequence]] = {}
        self._flood_wait = FloodWait(MOST_UNPROVEN_S)
        self._lock = threading.Lock()
        self._counters: Counter[str] = Counter()

    def sift(self, sample: zenoh.Sample) -> Sifted | None:
        """The increment in a sample, for the core to check; None if it was dropped and counted."""
        key = str(sample.key_expr)
        robot, proof = self._robots.get(key), sample.attachment
        if robot is None or proof is None:
            self._count_unproven()
            return None
        payload = sample.payload.to_bytes()
        proven = self._authentication.holder_of_increment(robot, key, payload, proof.to_bytes())
        if proven is None:
            self._count_unproven()
            return None
        seq = _seq_in(payload)
        with self._lock:
            is_new = proven.is_present and self._is_new(robot, proven.token, seq)
            rates = self._rates if is_new else self._rare_rates
            if rates[robot].take(self._now()):
                return Sifted(robot, proven.token, payload)
            self._counters["increments_too_many"] += 1
        self._flood_wait.one_more()
        return None

    @property
    def unproven(self) -> int:
        """Number of increments without a valid proof."""
        return self._counters["increments_unproven"]

    def counters(self) -> Counter[str]:
        """Counts of increments that were not passed on."""
        with self._lock:
            return self._counters.copy()

    def _is_new(self, robot: str, token: str, seq: int | None) -> bool:
        """Whether a sequence number was not seen yet under the present lease."""
        if seq is None:
            return False
        known, sequence = self._seen.get(robot, ("", Sequence()))
        if known != token:
            sequence = Sequence(_TOLD_APART)
            self._seen[robot] = token, sequence
        return sequence.take(seq)

    def _count_unproven(self) -> None:
        with self._lock:
            self._counters["increments_unproven"] += 1
        self._flood_wait.one_more()


def _seq_in(payload: bytes) -> int | None:
    """The sequence number of an increment, which is to be decoded; None if it has none."""
    if len(payload) > MAX_MESSAGE_BYTES:
        return None
    try:
        seq = msgpack.unpackb(payload)["seq"]
    except Exception:  # invalid content raises errors of many unrelated types
        return None
    return seq if type(seq) is int and seq >= 0 else None


_ADDRESS = "zenoh"
"""Address of all zenoh clients: zenoh does not show where a query comes from."""


class QuerySender(Sender):
    """A zenoh query; it takes one answer.

    Attributes:
        key: zenoh key of the answer.
        origin: the sender, once it is known.
    """

    def __init__(self, query: zenoh.Query, key: str) -> None:
        self._query = query
        self.key = key
        self.origin = ClientOrigin(address=_ADDRESS)

    def deliver(self, message: Message) -> None:
        """Answer the query; a refusal is an error reply."""
        with self._query as query:
            if isinstance(message, Error):
                query.reply_err(pack(message))
            else:
                query.reply(self.key, pack(message))


class OpenFront:
    """The HLI's zenoh session for clients: receives increments, answers queries, publishes states and verdicts.

    It opens the session at once. Each message is handed to the core through `port.serve`.

    Args:
        cell: gives the address (`hli`), the robots and the cycle.
        port: the HLI's shell: core, authentication, roles, event loop and clock.

    Raises:
        GuardedRealmError: `cell.hli` uses TLS, and there is no identity.
        IdentityError: the identity belongs to another service, or is not valid.
        ServiceUnreachableError: if `cell.hli` cannot be listened on.
    """

    def __init__(self, cell: CellDescription, port: Hli) -> None:
        self._cell = cell.cell
        self._increment_keys = {robot: topics.INCREMENT.key(cell.cell, robot=robot) for robot in cell.robots}
        self._port = port
        self._told, self._description = port.core.description, pack(port.core.description)
        self._lock = threading.Lock()
        self._stamps = stamps_if_asked("hli", list(cell.robots))
        rules = access(Party.HLI, Realm.OPEN, cell.cell)
        tls = service_tls(cell, [cell.hli], os.environ.get(IDENTITY), HLI)
        self._opened = open_session(listen=[cell.hli], access=rules, tls=tls)
        session = self._session = HliSession(self._opened, cell.cell, port.loop)
        self._sieve = Sieve(self._increment_keys, cell.cycle_s, port.authentication, port.now)
        session.subscribe(topics.INCREMENT, self._on_increment)
        session.answer(topics.STOP, self._on_stop)
        for row in ROWS:
            if row.topic is not None and row.topic is not topics.STOP:
                # a proof takes the query past those of strangers
                session.answer(
                    row.topic, partial(self._answer, row), self._goes_first if row.proven else None
                )
        session.answer_at_once(topics.CHALLENGE, self._on_challenge)
        session.answer(topics.STATUS, self._on_status)
        # clients ask for the description first: when it is there, so is everything above
        session.answer_at_once(topics.DESCRIPTION, self._on_description)

    def publish(self, topic: Topic, robot: str, message: Message) -> None:
        """Publish a message in the open realm."""
        if robot and robot not in self._increment_keys:
            self._session.publish_once(topic, message, robot=robot)
        else:
            self._session.publish(topic, message, robot=robot)

    def counters(self) -> Counter[str]:
        """Counters of the session and of the rate filter."""
        counters = self._session.counters() + self._sieve.counters()
        counters["zenoh_sessions_open"] = len(self._opened.info.transports())
        return counters

    @property
    def unproven(self) -> int:
        """Number of increments without a valid proof."""
        return self._sieve.unproven

    def close(self) -> None:
        """Close the realm to clients."""
        self._session.close()

    def _on_increment(self, sample: zenoh.Sample) -> None:
        sifted = self._sieve.sift(sample)
        if sifted is not None:
            self._port.serve(lambda: self._judged(sifted), (sifted.robot,))

    def _judged(self, sifted: Sifted) -> list[Output]:
        port = self._port
        try:
            increment = unpack(Increment, sifted.payload)
            if increment.robot != sifted.robot:
                raise _wrong_key(increment.robot, self._increment_keys[sifted.robot])
            increment = increment.model_copy(update={"lease": sifted.token})
        except InvalidMessageError as error:
            error.data["lease"] = sifted.token
            return port.core.increments.on_bad_increment(error, None, port.now())
        if self._stamps is not None:
            self._stamps.add(StampStation.INCREMENT_AT_HLI, increment.robot, increment.cycle, increment.seq)
        return port.core.increments.on_increment(increment, None, port.now())

    def _on_challenge(self, query: zenoh.Query) -> None:
        challenge = self._port.authentication.challenge(self._port.now())
        QuerySender(query, topics.CHALLENGE.key(self._cell)).deliver(Challenge(challenge=challenge.hex()))

    def _on_stop(self, query: zenoh.Query) -> None:
        # a stop is obeyed whatever its fields are
        sender = QuerySender(query, topics.STOP.key(self._cell))
        with contextlib.suppress(Exception):
            sender.origin = self._origin(unpack(StopRequest, _payload(query)).client, None)
        on_stop, robots = self._port.core.requests.on_stop, self._increment_keys
        self._port.serve(lambda: on_stop(StopRequest(), sender, self._port.now()), robots, sender)

    def _on_status(self, query: zenoh.Query) -> None:
        QuerySender(query, topics.STATUS.key(self._cell)).deliver(self._port.status())

    def _on_description(self, query: zenoh.Query) -> None:
        with query:
            if self._told is not self._port.core.description:  # a robot has another tool
                self._told = self._port.core.description
                self._description = pack(self._told)
            query.reply(topics.DESCRIPTION.key(self._cell), self._description)

    def _answer(self, row: RequestRow, query: zenoh.Query) -> None:
        """Have the core answer a question that the table of requests has."""
        port, topic = self._port, row.topic
        assert topic is not None  # only such rows are asked here
        sender = QuerySender(query, topic.key(self._cell))

        def judged() -> list[Output]:
            try:
                request = unpack(row.model, _payload(query))
                if robot := getattr(request, "robot", ""):
                    sender.key = topic.key(self._cell, robot=robot)
                    if not query.key_expr.intersects(zenoh.KeyExpr(sender.key)):
                        raise _wrong_key(robot, str(query.key_expr))
                request = self._proven(row, request, query)
                sender.origin = self._origin_of(row, request, query)
            except InvalidMessageError as error:
                return port.core.increments.on_malformed(error, sender)
            return port.core.take(request, port.now(), sender)

        port.serve(judged, sender=sender)

    def _proven(self, row: RequestRow, request: Any, query: zenoh.Query) -> Any:
        """A request whose lease and role are replaced by the proven ones."""
        fields: dict[str, str | None] = {}
        if "lease" in row.proven:
            fields["lease"] = self._port.authentication.holder(
                request.robot, str(query.key_expr), _payload(query), _proof(query)
            )
        if "token" in row.proven:
            fields["token"] = self._role_token(query)
        return request.model_copy(update=fields)

    def _origin_of(self, row: RequestRow, request: Any, query: zenoh.Query) -> ClientOrigin:
        if "token" in row.proven:
            return self._origin(request.client, request.token, self._identity(query))
        lease = None
        if "lease" in row.proven:
            lease = self._port.core.leases.held_with(request.robot, request.lease)
        return self._origin(None, None) if lease is None else lease.origin

    def _origin(self, client: str | None, token: str | None, identity: str = "") -> ClientOrigin:
        """Whom a question is from: the name that it says, and the role and the name that it proves."""
        role = self._port.roles.of(token, identity)
        return ClientOrigin(client or "", _ADDRESS, role.name.lower(), identity)

    def _goes_first(self, query: zenoh.Query) -> bool:
        """Whether it is a holder's or the operator's, in zenoh's thread: a flood of others takes no place of theirs."""
        proof, port = _proof(query), self._port
        if not proof:
            return False
        with self._lock:
            return port.authentication.goes_first(str(query.key_expr), _payload(query), proof, port.now())

    def _identity(self, query: zenoh.Query) -> str:
        return self._port.authentication.identity(
            str(query.key_expr), _payload(query), _proof(query), self._port.now()
        )

    def _role_token(self, query: zenoh.Query) -> str | None:
        return self._port.authentication.token(
            str(query.key_expr), _payload(query), _proof(query), self._port.now()
        )


def _payload(query: zenoh.Query) -> bytes:
    return query.payload.to_bytes() if query.payload else b""


def _proof(query: zenoh.Query) -> bytes:
    return query.attachment.to_bytes() if query.attachment else b""


def _wrong_key(robot: str, key: str) -> InvalidMessageError:
    return InvalidMessageError(f"robot: the message is for {robot}, the key is {key}", ReasonCode.MALFORMED)
