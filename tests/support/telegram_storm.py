"""A KRC among forgers, on a bad wire: telegrams by the million, and a ledger of what explains each correction.

Everything comes from the KRC's own address, as a forger on its line can make it seem. The ledger knows what was
admitted and where the true KRC stands, and believes nothing that driver, core or guard say of themselves.
"""

import random
import re

import numpy as np
from krc_side import FR, KRC, MAX_DV, KrcSide, telegram

from deltaq_protocol.brake import brake_increment
from deltaq_protocol.messages import Phase
from deltaq_protocol.rsi import TelegramError
from deltaq_services.robot_server.probe_trial import PROBE_RAD

_ANSWER = re.compile(
    rb'<Sen Type="ImFree"><AK ' + b" ".join(rb'A%d="(-?[0-9.]+)"' % i for i in range(1, 7)) + rb"/>.*"
)
_IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
_MOST = FR.max_velocity * 0.012
_ROUNDING = 2e-8
"""What six decimals of a degree may add, twice [rad]."""


class UnexplainedError(AssertionError):
    """A correction changed, and no admission, brake, probe or new session of the true KRC is why."""


class Storm:
    """One seeded storm of telegrams.

    Attributes:
        telegrams: handed to the driver so far.
        answers: how many of them were answered.
        admitted: admissions that were taken.
        sessions: times that the true KRC began anew.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.krc = KrcSide().begin()
        self.telegrams = self.answers = self.admitted = self.sessions = 0
        self._last = self.krc.correction.copy()
        self._course: list[np.ndarray] = []
        self._older = [self.krc.own()]
        self._forged_ipoc = 0
        self._probes = False
        self._heard_s = self.krc.time_s
        self._kinds = (
            *[self._true] * 6,
            self._lost,
            self._twice,
            self._overtaken,
            self._truncated,
            self._garbled,
            self._garbled_digit,
            self._garbled_digit,
            self._moved,
            self._far,
            self._back,
            self._opening,
            self._second_krc,
            self._oversized,
        )

    def run(self, telegrams: int) -> None:
        """Hand in so many telegrams.

        Raises:
            UnexplainedError: if a correction changes that nothing explains.
        """
        while self.telegrams < telegrams:
            if self.random.random() < 1e-4:
                self._begin_anew()
            if self.krc.server.detail and self.random.random() < 0.01:
                self._calm_down()
            self.random.choice(self._kinds)()

    def _calm_down(self) -> None:
        """The wire is quiet for a while, so that the mode of the session is found out."""
        if self.krc.server.motion_stop:
            self._begin_anew()
        for _ in range(150):
            if self.krc.server.detail:
                self._true()

    # --- the true KRC -------------------------------------------------------------------------------------

    def _true(self) -> None:
        krc = self.krc
        krc.tick()
        if krc.time_s - self._heard_s > krc.cell.gate.krc_timeout_s:
            krc.server.krc_silent(krc.time_s)
            self._course = []
        own = krc.own()
        self._older = [*self._older[-20:], own]
        admission = None
        state = krc.server.state
        if state.phase is Phase.HELD:
            krc.resets = state.resets + 1
        elif self.random.random() < 0.8:
            away = np.sign(FR.home - np.array(state.q_cmd)) if self.random.random() < 0.5 else 1.0
            wanted = np.array(state.dq) + away * MAX_DV * self.random.uniform(-1.0, 1.0)
            admission = krc.admission(np.clip(wanted, -0.9 * _MOST, 0.9 * _MOST))
        self._hand(own, admission)

    def _begin_anew(self) -> None:
        """The program on the KRC is started again, where the robot stands."""
        krc = self.krc
        krc.tick(self.random.choice([30, 500]))
        krc.q_programmed, krc.correction = krc.q.copy(), np.zeros(6)
        self._last = np.zeros(6)
        self._course = []
        self.sessions += 1
        sessions = krc.counters["session_restarted"]
        while krc.counters["session_restarted"] == sessions:
            self._true()

    # --- the wire and the forgers -------------------------------------------------------------------------

    def _lost(self) -> None:
        self.krc.tick()

    def _twice(self) -> None:
        self._hand(self._older[-1])

    def _overtaken(self) -> None:
        self._hand(self.random.choice(self._older))

    def _truncated(self) -> None:
        own = self._older[-1]
        self._hand(own[: self.random.randrange(len(own))])

    def _garbled(self) -> None:
        own = bytearray(self._next())
        for _ in range(self.random.randint(1, 4)):
            own[self.random.randrange(len(own))] = self.random.randrange(256)
        self._hand(bytes(own))

    def _garbled_digit(self) -> None:
        own = bytearray(self._next())
        digits = [place for place, byte in enumerate(own) if 48 <= byte <= 57]
        own[self.random.choice(digits)] = 48 + self.random.randrange(10)
        self._hand(bytes(own))

    def _moved(self) -> None:
        off = np.array([self.random.gauss(0.0, 0.05) for _ in range(6)])
        programmed = self.krc.q_programmed + self.random.choice([0.0, 1.0]) * off
        self._hand(telegram(self.krc.ipoc + 12, self.krc.q + off, programmed))

    def _far(self) -> None:
        self._hand(self._with_ipoc(self.krc.ipoc + 12 * self.random.randrange(1, 10**6)))

    def _back(self) -> None:
        self._hand(self._with_ipoc(self.krc.ipoc - self.random.randrange(1, 5000)))

    def _opening(self) -> None:
        self._hand(KRC.encode_ipoc_only((self.krc.ipoc + 12) % 2**32))

    def _second_krc(self) -> None:
        """Somebody whose telegrams agree, for a while, and that stands somewhere else."""
        self._forged_ipoc = self._forged_ipoc or self.random.randrange(2**31)
        for _ in range(self.random.randint(1, 8)):
            self._forged_ipoc = (self._forged_ipoc + 12) % 2**32
            self._hand(telegram(self._forged_ipoc, FR.home + 0.02, FR.home + 0.02))
        if self.random.random() < 0.2:
            self._forged_ipoc = 0

    def _oversized(self) -> None:
        self._hand(self._older[-1] + b" " * 5000)

    def _next(self) -> bytes:
        return self._with_ipoc(self.krc.ipoc + 12)

    def _with_ipoc(self, ipoc: int) -> bytes:
        return _IPOC.sub(b"<IPOC>%d</IPOC>" % (ipoc % 2**32), self._older[-1])

    # --- the ledger ---------------------------------------------------------------------------------------

    def _hand(self, datagram: bytes, admission=None) -> None:
        krc = self.krc
        self.telegrams += 1
        taken, cycles = krc.counters["admissions"], krc.counters["session_restarted"]
        before = krc.server._cycle
        self._probes = bool(krc.server.detail)
        try:
            answer = krc.answer(datagram, admission)
        except TelegramError:
            return
        if krc.server._cycle != before:
            self._heard_s = krc.time_s
        if krc.counters["admissions"] != taken:
            dq = np.array(admission.dq)
            n = admission.brake_cycles
            self._course = [brake_increment(dq, n, step) for step in range(n)]
            self.admitted += 1
        if krc.counters["session_restarted"] != cycles:
            self._course = []
        if answer is None:
            return
        self.answers += 1
        match = _ANSWER.fullmatch(answer)
        assert match is not None
        correction = np.deg2rad([float(text) for text in match.groups()])
        moved = correction - self._last
        probed = self._probes and not np.any(np.abs(moved) > PROBE_RAD + _ROUNDING)
        if not probed and np.any(np.abs(moved) > _ROUNDING):
            expected = self._course[0] if self._course and krc.server._cycle != before else np.zeros(6)
            if np.any(np.abs(moved - expected) > _ROUNDING) or np.any(np.abs(moved) > _MOST):
                raise UnexplainedError(f"telegram {self.telegrams}: moved {moved}, explained {expected}")
        if krc.server._cycle != before and self._course and not krc.missed:
            self._course = self._course[1:]
        if not probed:  # it has to come back to where it was
            self._last = correction
        told = _IPOC.search(answer)
        if told is not None and int(told[1]) == krc.ipoc:
            krc.correction = correction
