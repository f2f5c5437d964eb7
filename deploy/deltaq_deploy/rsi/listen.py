"""Statistics of a KRC's telegrams, and the loop under `deltaq krc` that owns socket and clock and decides nothing."""

import re
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.rsi import KrcTelegram, SensorCodec, TelegramError
from deltaq_protocol.rsi.layout import MAX_IPOC

# What a datagram of a KRC holds, read without knowing its `*_ethernet.xml`.

MAX_BYTES = 4096
"""More is no telegram."""

_HEAD = re.compile(rb'\s*<Rob\s+(?i:Type)="KUKA"\s*>')
_IPOC = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>")
_ELEMENT = re.compile(rb'<([A-Za-z0-9_][\w-]*)((?:\s+[\w.-]+="[^"<>]*")*)\s*(?:/>|>)')
_ATTRIBUTE = re.compile(rb'([\w.-]+)="([^"<>]*)"')
_DECIMALS = re.compile(rb"[-+]?[0-9]+\.([0-9]+)")


@dataclass(frozen=True)
class Seen:
    """The contents of a datagram.

    Attributes:
        ipoc: its time stamp.
        elements: `AIPos.A1`, or the name alone of an element with text; without IPOC, in their order.
        delay: late replies as the KRC counts them; None if it does not say.
        decimals: most decimals of a number in it; None if no number has any.
    """

    ipoc: int
    elements: tuple[str, ...]
    delay: int | None
    decimals: int | None


def look_at(datagram: bytes) -> Seen | None:
    """Read a datagram; None if it is no telegram of a KRC."""
    if (
        len(datagram) > MAX_BYTES
        or _HEAD.match(datagram) is None
        or (stamp := _IPOC.search(datagram)) is None
    ):
        return None
    elements: list[str] = []
    delay = decimals = None
    for name, attributes in _ELEMENT.findall(datagram):
        if name in (b"Rob", b"IPOC"):
            continue
        pairs = _ATTRIBUTE.findall(attributes)
        elements += [f"{name.decode()}.{key.decode()}" for key, _ in pairs] or [name.decode()]
        for key, value in pairs:
            if name == b"Delay" and key == b"D" and value.strip().isdigit():
                delay = int(value)
            elif (number := _DECIMALS.fullmatch(value.strip())) is not None:
                decimals = max(decimals or 0, len(number[1]))
    return Seen(int(stamp[1]), tuple(elements), delay, decimals)


KEPT = 100_000
"""Intervals that are kept: more than six minutes at 4 ms."""
MOST_PEERS = 16
MOST_STEPS = 1000
"""Largest number of distinct IPOC steps that are counted; a sender of nonsense makes more."""
_RING = 2**32
_LATE = 1.5
"""An interval of more than this many cycles is a late telegram, or a lost one."""


@dataclass(frozen=True)
class Spread:
    """A distribution of times [s]."""

    median_s: float
    p99_s: float
    longest_s: float


@dataclass(frozen=True)
class Summary:
    """Statistics of one KRC.

    Attributes:
        telegrams: datagrams that are telegrams.
        garbled: datagrams that are not telegrams.
        rate_hz: telegrams a second; None for fewer than two.
        cycle: of the KRC.
        late: intervals longer than one cycle and a half.
        ipoc_step: most frequent increase of the IPOC from one telegram to the next.
        ipoc_jumps: number of other changes of it.
        delay: late replies as the KRC counts them, at the end; None if it does not say.
        delay_growth: increase of `delay`.
        decimals: most decimals of a number.
        opened_with_ipoc_only: the first telegram had nothing but its IPOC, as a KR C2's has.
        elements: the elements of the last telegram.
        peers: telegrams by sender, `HOST:PORT`.
        reply: time from a telegram to its answer; None if none was answered.
        guess: the likely kind of KRC and cycle.
        problems: faults found, as text.
    """

    telegrams: int
    garbled: int
    rate_hz: float | None
    cycle: Spread | None
    late: int
    ipoc_step: int | None
    ipoc_jumps: int
    delay: int | None
    delay_growth: int
    decimals: int | None
    opened_with_ipoc_only: bool
    elements: tuple[str, ...]
    peers: dict[str, int]
    reply: Spread | None
    guess: str
    problems: tuple[str, ...]


class WireStatistics:
    """Collects statistics of a KRC's telegrams, one datagram at a time.

    Args:
        expected: elements that the KRC's file lists in SEND, as `AIPos.A1`; None if there is no file to compare with.
        cycle_s: the cell's cycle; None if there is no cell.
    """

    def __init__(self, expected: tuple[str, ...] | None = None, cycle_s: float | None = None) -> None:
        self._expected = expected
        self._cycle_s = cycle_s
        self._intervals: deque[float] = deque(maxlen=KEPT)
        self._replies: deque[float] = deque(maxlen=KEPT)
        self._steps: Counter[int] = Counter()
        self._peers: Counter[str] = Counter()
        self._telegrams = self._garbled = 0
        self._first_s = self._last_s = 0.0
        self._last: Seen | None = None
        self._full: Seen | None = None
        self._delays: tuple[int, int] | None = None
        self._decimals: int | None = None
        self._opened_with_ipoc_only = False

    def saw(self, time_s: float, datagram: bytes, peer: str) -> None:
        """Count a datagram from `peer`, received at `time_s` on any monotonic clock."""
        if peer in self._peers or len(self._peers) < MOST_PEERS:
            self._peers[peer] += 1
        if (seen := look_at(datagram)) is None:
            self._garbled += 1
            return
        if self._last is None:
            self._first_s = time_s
            self._opened_with_ipoc_only = not seen.elements
        else:
            self._intervals.append(time_s - self._last_s)
            step = (seen.ipoc - self._last.ipoc + _RING // 2) % _RING - _RING // 2
            self._steps[step if step in self._steps or len(self._steps) < MOST_STEPS else 0] += 1
        self._telegrams += 1
        self._last, self._last_s = seen, time_s
        if seen.elements:
            self._full = seen
        if seen.delay is not None:
            self._delays = (self._delays[0] if self._delays else seen.delay, seen.delay)
        if seen.decimals is not None:
            self._decimals = max(self._decimals or 0, seen.decimals)

    def replied(self, after_s: float) -> None:
        """Note the time between the last telegram and its reply [s]."""
        self._replies.append(after_s)

    def summary(self) -> Summary:
        """The statistics so far."""
        cycle = spread(self._intervals)
        step, usual = self._steps.most_common(1)[0] if self._steps else (None, 0)
        passed_s = self._last_s - self._first_s
        first, last = self._delays or (0, None)
        return Summary(
            telegrams=self._telegrams,
            garbled=self._garbled,
            rate_hz=(self._telegrams - 1) / passed_s if passed_s > 0 else None,
            cycle=cycle,
            late=sum(interval > _LATE * cycle.median_s for interval in self._intervals) if cycle else 0,
            ipoc_step=step,
            ipoc_jumps=self._steps.total() - usual,
            delay=last,
            delay_growth=(last or first) - first,
            decimals=self._decimals,
            opened_with_ipoc_only=self._opened_with_ipoc_only,
            elements=self._full.elements if self._full else (),
            peers=dict(self._peers),
            reply=spread(self._replies),
            guess=_guess(cycle, step, self._opened_with_ipoc_only),
            problems=tuple(self._problems(cycle, self._steps.total() - usual)),
        )

    def _problems(self, cycle: Spread | None, jumps: int) -> Iterator[str]:
        if len(self._peers) > 1:
            yield (
                f"{len(self._peers)} senders ({', '.join(self._peers)}): a second KRC, or a test program that was left "
                "running; give each robot a port of its own"
            )
        if self._garbled:
            yield f"{self._garbled} datagrams are no telegrams of a KRC: another program sends here"
        if jumps:
            yield f"IPOC jumped {jumps} times: telegrams are lost on the way, or RSI was started again"
        if self._last is not None and self._last.ipoc > MAX_IPOC:
            yield f"IPOC is {self._last.ipoc}: a KRC's has 32 bit, and the Robot Server answers no other"
        if self._decimals == 1:
            yield "positions have one decimal, a tenth of a degree: set Precision of the ETHERNET object to 4"
        if cycle and self._cycle_s and not 0.8 < cycle.median_s / self._cycle_s < 1.25:
            yield (
                f"the cycle is {cycle.median_s * 1e3:.2f} ms, the cell's {self._cycle_s * 1e3:g} ms: correct "
                "cycle_s, or the option of RSI_ON (#IPO_FAST 4 ms, #IPO 12 ms)"
            )
        if self._expected is not None and self._full is not None:
            came = self._full.elements
            missing = [name for name in self._expected if name not in came]
            extra = [name for name in came if name not in self._expected]
            if missing:
                yield f"does not send {', '.join(missing)}, which the cell's file lists in SEND: load the same file"
            if extra:
                yield f"sends {', '.join(extra)}, which the cell's file does not list in SEND: load the same file"
            if not missing and not extra and came != self._expected:
                yield "sends its elements in another order than the cell's file: load the same file"


def spread(times: deque[float]) -> Spread | None:
    """Median, p99 and longest of some times; None if there are none."""
    if not times:
        return None
    values = np.array(times)
    return Spread(float(np.median(values)), float(np.percentile(values, 99)), float(values.max()))


def _guess(cycle: Spread | None, step: int | None, ipoc_only: bool) -> str:
    if cycle is None:
        return "too few telegrams"
    milliseconds = cycle.median_s * 1e3
    kind = (
        "a KR C4 or later with RSI_ON(…, #IPO_FAST)" if milliseconds < 8 else "a KR C2, or a KR C4 with #IPO"
    )
    if ipoc_only:
        kind = "a KR C2, which opens with a telegram of its IPOC alone"
    nominal = 4 if milliseconds < 8 else 12
    unit = {1: "cycles", nominal: "ms"}.get(step or 0, "neither cycles nor ms")
    return f"{kind}; {milliseconds:.2f} ms a cycle; IPOC counts {unit}"


_DATAGRAM_BYTES = 65_536
_POLL_S = 0.2

Responder = Callable[[bytes, str], bytes | None]


def listen(
    address: str,
    port: int,
    duration_s: float,
    statistics: WireStatistics,
    answer: Responder | None = None,
    ready: Callable[[], None] = lambda: None,
) -> None:
    """Listen until the time is over or Ctrl-C, and count datagrams.

    Args:
        address: to listen on.
        port: UDP port to listen on.
        duration_s: how long; 0 is until Ctrl-C.
        statistics: gets every datagram.
        answer: returns the reply, if any; None listens only.
        ready: called once when the socket listens.

    Raises:
        ServiceUnreachableError: the address cannot be listened on.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((address, port))
        except OSError as error:
            raise ServiceUnreachableError(
                f"cannot listen on UDP {address}:{port}: {error.strerror or error}; is a Robot Server or another "
                "program on that port, or is the address not this machine's?"
            ) from error
        ready()
        end_s = time.monotonic() + duration_s if duration_s else float("inf")
        try:
            while (left_s := end_s - time.monotonic()) > 0:
                sock.settimeout(min(left_s, _POLL_S))
                try:
                    datagram, sender = sock.recvfrom(_DATAGRAM_BYTES)
                except TimeoutError:
                    continue
                arrived_s = time.monotonic()
                peer = f"{sender[0]}:{sender[1]}"
                if answer is not None and (reply := answer(datagram, peer)) is not None:
                    sock.sendto(reply, sender)
                    statistics.replied(time.monotonic() - arrived_s)
                statistics.saw(arrived_s, datagram, peer)
        except KeyboardInterrupt:
            return


AWAY = 2e-3
"""Distance from the start that rounding to one decimal, and a drive at rest, leave [rad or m]."""


MOST_REASONS = 16


class ZeroEcho:
    """Decides on the answer to each telegram; it has no way to send anything but zeros, digital outputs included.

    An absolute correction of zero means "back to where RSI was started": harmless at the start, and a jump for a robot
    that has been corrected already. So a robot that stands away from its start is not answered at all.

    Attributes:
        refusals: telegrams that got no answer, by reason.
    """

    def __init__(self, codec: SensorCodec) -> None:
        self._codec = codec
        self._zeros = np.zeros(codec.joints)
        self._peer: str | None = None
        self.refusals: dict[str, int] = {}

    def answer(self, datagram: bytes, peer: str) -> bytes | None:
        """The answer to a telegram, or None if it must not be answered."""
        try:
            telegram = self._codec.decode(datagram)
        except TelegramError as error:
            reason: str | None = f"no telegram of the cell's file: {str(error).partition('; got')[0]}"
        else:
            reason = self._objection(telegram, peer)
            if reason is None:
                return self._codec.encode(telegram.ipoc, self._zeros)
        if reason in self.refusals or len(self.refusals) < MOST_REASONS:
            self.refusals[str(reason)] = self.refusals.get(str(reason), 0) + 1
        return None

    def _objection(self, telegram: KrcTelegram, peer: str) -> str | None:
        self._peer = self._peer or peer
        if peer != self._peer:
            return f"{peer} is another sender than {self._peer}, which came first"
        if telegram.ipoc > MAX_IPOC:
            return f"IPOC has more than 32 bit, and a KRC's is at most {MAX_IPOC}"
        if telegram.q is None:  # the opening of a KR C2: the robot stands at its start
            return None
        if telegram.q_programmed is None:
            return "without DEF_ASPos in SEND the start position of RSI is unknown"
        away = np.abs(telegram.q - telegram.q_programmed)
        if (away > AWAY).any():
            axis = self._codec.axes.axes[int(np.argmax(away))]
            return (
                f"{axis} stands away from where RSI was started, and zero would let it jump back: end RSI and start it "
                "again"
            )
        return None
