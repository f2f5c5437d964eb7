"""Whether each correction that went over RSI's wire is explained: by an admission, its brake, a probe, or not moving.

The witness reads telegrams and replies off the wire, and admissions off the gate's topics; it asks the Robot Server
nothing. An admission that was lost on its way to the witness explains no more than an admission could do, and is
counted apart.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.guarded import Admission
from deltaq_protocol.rsi import KrcCodec, SensorCodec, TelegramError


class Pulses:
    """Knows the pulses of a session's trials, each from rest to rest, positive or negative.

    Which sign is due is not asked: a telegram that is answered out of turn may cut a pulse in two. None begins before
    the one before it has been taken back, so that all of them together lead no further than one.

    Args:
        offsets: (k, n) what a positive one adds to the setpoint, cycle by cycle [rad or m].
        within: what rounding may add to a difference of two of them [rad or m].
    """

    def __init__(self, offsets: Array, within: float) -> None:
        self._offsets = offsets
        rest = np.zeros((1, offsets.shape[1]))
        self._steps = np.diff(np.concatenate([rest, offsets, rest]), axis=0)
        self._within = within
        self._next: list[Array] = []
        self._away = np.zeros(offsets.shape[1])

    def begin(self, correction: Array) -> bool:
        """A session begins, or a telegram of another one is answered in the middle of a trial.

        Args:
            correction: (n,) of the first reply.

        Returns:
            Whether a pulse is under way there, which then goes on.
        """
        for sign in (1.0, -1.0):
            for done, offset in enumerate(self._offsets, 1):
                if np.any(offset) and self._near(correction, sign * offset):
                    self._away = sign * offset
                    self._next = [sign * step for step in self._steps[done:]]
                    return True
        self._end()
        return False

    def explains(self, moved: Array) -> bool:
        """Whether the pulse goes on with a step (n,), ends early with it, or begins with it at rest."""
        if self._next and self._near(moved, self._next[0]):
            self._step(self._next)
            return True
        if self._away.any():
            if self._near(moved, -self._away):  # a mode that is refused ends its trial
                self._end()
                return True
            return False
        for sign in (1.0, -1.0):
            steps = [sign * step for step in self._steps]
            if self._near(moved, steps[0]):
                self._step(steps)
                return True
        return False

    def __str__(self) -> str:
        return f"{self._away.tolist()} by a pulse with {len(self._next)} steps to go"

    def _end(self) -> None:
        self._next = []
        self._away = np.zeros_like(self._away)

    def _step(self, steps: list[Array]) -> None:
        self._away = self._away + steps[0]
        self._next = steps[1:]
        if self._near(self._away, np.zeros_like(self._away)):
            self._end()

    def _near(self, one: Array, other: Array) -> bool:
        return bool((np.abs(one - other) <= self._within).all())


ROUNDING = 2e-8
"""What six decimals of a degree may add to a difference of two corrections [rad or m]."""
_IN_FLIGHT = 2000
"""Admissions after the last one taken among which the next is looked for: those not taken were late or refused."""


class Admitted:
    """Admissions to one robot, each of which explains one step, in the order of their sequence.

    The gate numbers all that it admits without a gap. A number that is missing is an admission that was lost on its
    way to the listener; it may explain a step that one admission can make, and no other.

    Args:
        admissions: all that were heard of one gate, to every robot, in any order.
        robot: the robot's name; description: its limits; cycle_s: sample time.

    Attributes:
        unheard: numbers that are missing, in their order.
    """

    def __init__(
        self, admissions: Sequence[Admission], robot: str, description: RobotDescription, cycle_s: float
    ) -> None:
        heard = sorted(one.sequence for one in admissions)
        everything = range(heard[0], heard[-1] + 1) if heard else range(0)
        self.unheard = sorted(set(everything).difference(heard))
        own = sorted((one for one in admissions if one.robot == robot), key=lambda one: one.sequence)
        self._sequences = np.array([one.sequence for one in own])
        self._follows = np.array([one.follows_q_cmd for one in own])
        self._dq = np.array([one.dq for one in own])
        self._brake_cycles = [one.brake_cycles for one in own]
        self._max_dq = description.max_velocity * cycle_s
        self._max_dv = description.max_acceleration * cycle_s**2
        self._newest = -1

    def take(self, setpoint: Array, moved: Array) -> list[Array] | None:
        """Take the first heard admission not yet passed that follows a setpoint (n,) and moves by `moved` (n,).

        Returns:
            The increments of its brake; None if there is no such admission.
        """
        first = int(np.searchsorted(self._sequences, self._newest, side="right"))
        window = slice(first, first + _IN_FLIGHT)
        off = np.maximum(np.abs(self._follows[window] - setpoint), np.abs(self._dq[window] - moved))
        found = np.flatnonzero((off <= 2 * ROUNDING).all(axis=1)).tolist() if len(off) else []
        if not found:
            return None
        taken = first + found[0]
        self._newest = int(self._sequences[taken])
        return _brake(self._dq[taken], self._brake_cycles[taken])

    def take_unheard(self, before: Array, moved: Array) -> list[Array] | None:
        """Take the first unheard admission, if one admission can move by `moved` (n,) after a step `before` (n,).

        Returns:
            The increments of its brake; None if no number is missing, or the step is beyond the robot's limits.
        """
        missing = [one for one in self.unheard if self._newest < one <= self._newest + _IN_FLIGHT]
        changes = (
            np.abs(moved - before),
            np.abs(moved),
        )  # after silence of its KRC a robot goes on from rest
        possible = any((change <= self._max_dv + 2 * ROUNDING).all() for change in changes)
        if not missing or not possible or (np.abs(moved) > self._max_dq + ROUNDING).any():
            return None
        self._newest = missing[0]
        # rounding must not make the brake of a whole number of steps longer than it is
        return _brake(moved, brake_cycles(np.maximum(np.abs(moved) - ROUNDING, 0.0), self._max_dv))


def _brake(dq: Array, cycles: int) -> list[Array]:
    return [brake_increment(dq, cycles, step) for step in range(1, cycles)]


Origin = tuple[float, ...]
"""Programmed position of a session of the KRC's program [rad or m]."""

UNHEARD = "by an admission that was not heard"
_REMEMBERED = 4096
_TOLD = 24
"""Replies before the unexplained one that are told with it."""


class UnexplainedError(Exception):
    """A correction changed, and nothing explains it."""


class DatagramOrigin(Enum):
    """Whose datagram it is."""

    TELEGRAM = 0
    """Of the KRC itself."""
    FORGERY = 1
    """Of an attacker."""
    REPLY = 2


@dataclass(frozen=True)
class Passed:
    """A datagram that passed, and when [ns]."""

    kind: DatagramOrigin
    datagram: bytes
    stamp_ns: int


class Witness:
    """Judges what passed, in its order.

    Args:
        of_krc: reads telegrams; of_server: reads replies.
        pulses: (k, n) of the probe of a session's mode, see `pulse_offsets` [rad or m].

    Attributes:
        counts: replies by what explains them, telegrams, and sessions of the KRC.
    """

    def __init__(self, of_krc: SensorCodec, of_server: KrcCodec, pulses: Array) -> None:
        self.counts: Counter[str] = Counter()
        self._of_krc, self._of_server = of_krc, of_server
        self._pulses = Pulses(pulses, 2 * ROUNDING)
        self._programmed: OrderedDict[int, tuple[Origin, ...]] = OrderedDict()
        self._origins: set[Origin] = set()
        self._origin: Origin | None = None
        self._correction = np.zeros(of_krc.joints)
        self._moved = np.zeros(of_krc.joints)
        self._course: list[Array] = []
        self._last: deque[str] = deque(maxlen=_TOLD)

    def judge(self, passed: Sequence[Passed], admitted: Admitted) -> None:
        """Judge a whole run, in the order of its stamps.

        Raises:
            UnexplainedError: at the first correction that is not explained.
        """
        for one in sorted(passed, key=lambda one: one.stamp_ns):
            match one.kind:
                case DatagramOrigin.REPLY:
                    before = self.counts.copy()
                    self._reply(one.datagram, admitted)
                    self._note(self.counts - before)
                case DatagramOrigin.TELEGRAM:
                    self._telegram(one.datagram)
                case DatagramOrigin.FORGERY:
                    self._forgery(one.datagram)

    def _note(self, counted: Counter[str]) -> None:
        why = ", ".join(name for name in counted if name != "replies")
        self._last.append(f"{self.counts['replies']}: {self._correction.tolist()} {why}; {self._pulses}")

    def _telegram(self, datagram: bytes) -> None:
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError as error:
            raise UnexplainedError(f"the KRC's own telegram cannot be read: {error}") from error
        self.counts["telegrams"] += 1
        if telegram.q_programmed is not None:
            origin = tuple(telegram.q_programmed.tolist())
            self._origins.add(origin)
            self._remember(telegram.ipoc, (origin,))

    def _forgery(self, datagram: bytes) -> None:
        """What is forged may be answered, in the session whose programmed position it repeats."""
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError:
            return
        if telegram.q_programmed is not None:
            origin = tuple(telegram.q_programmed.tolist())
            known = self._programmed.get(telegram.ipoc, ())
            if origin in self._origins and origin not in known:
                self._remember(telegram.ipoc, (*known, origin))

    def _remember(self, ipoc: int, origins: tuple[Origin, ...]) -> None:
        self._programmed[ipoc] = origins
        while len(self._programmed) > _REMEMBERED:
            self._programmed.popitem(last=False)

    def _reply(self, datagram: bytes, admitted: Admitted) -> None:
        reply = self._of_server.decode(datagram)
        self.counts["replies"] += 1
        origin = self._answered_in(reply.ipoc)
        if origin != self._origin:
            # another session of the KRC's program, which begins without a correction
            self.counts["sessions"] += 1
            self._origin, self._correction, self._course = origin, np.zeros_like(reply.correction), []
            if self._pulses.begin(reply.correction):
                self._correction = reply.correction
                self.counts["by a probe"] += 1
                return
        moved = reply.correction - self._correction
        setpoint = self._correction if origin is None else np.array(origin) + self._correction
        self._correction = reply.correction
        if not self._is_at_rest(moved):
            self._step(setpoint, moved, admitted)

    def _answered_in(self, ipoc: int) -> Origin | None:
        """The session of the telegram that is answered: the present one, unless no telegram of that IPOC was of it."""
        origins = self._programmed.get(ipoc, ())
        return self._origin if self._origin in origins or not origins else origins[-1]

    def _is_at_rest(self, moved: Array) -> bool:
        if not (np.abs(moved) <= ROUNDING).all() or (self._course and _near(moved, self._course[0])):
            return False
        self.counts["unmoved"] += 1
        if not self._course:
            self._moved = np.zeros_like(
                moved
            )  # a brake that is not over may go on after a reply that was missed
        return True

    def _step(self, setpoint: Array, moved: Array, admitted: Admitted) -> None:
        if self._course and _near(moved, self._course[0]):
            self._course.pop(0)
            self.counts["by a brake"] += 1
        elif (brake := admitted.take(setpoint, moved)) is not None:
            self._course = brake
            self.counts["by an admission"] += 1
        elif self._pulses.explains(moved):
            self._course = []
            self.counts["by a probe"] += 1
        elif (brake := admitted.take_unheard(self._moved, moved)) is not None:
            self._course = brake
            self.counts[UNHEARD] += 1
        else:
            raise UnexplainedError(
                f"reply {self.counts['replies']} moved by {moved} after {self._moved}; the brake's next is "
                f"{self._course[:1]}; {self._pulses}. The replies before, as number: correction why\n"
                + "\n".join(self._last)
            )
        self._moved = moved


def _near(one: Array, other: Array) -> bool:
    """Whether two steps are the same; each may be a difference of rounded corrections."""
    return bool((np.abs(one - other) <= 2 * ROUNDING).all())
