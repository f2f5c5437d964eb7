"""Storms in which replies are prepared, beside the same without: one has to be the other to the byte.

In both what the gate says is taken as it comes, before the telegram, as the process does.
"""

from __future__ import annotations

import numpy as np
import telegram_storm
from krc_side import AXES, EPOCH, FR, XML, KrcSide, preparing, telegram
from telegram_storm import Storm

from deltaq_protocol.guarded import Supervision
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.rsi import KrcCodec, TelegramError, load_ethernet_xml
from deltaq_protocol.rsi.krc_codec import MAX_PRECISION
from deltaq_services.robot_server.expected_telegram import is_expected
from deltaq_services.robot_server.krc_file import preparation
from deltaq_services.robot_server.last_steps import allows
from deltaq_services.robot_server.mode_probe import ADRIFT
from deltaq_services.robot_server.probe_trial import pulse_sums

FINE = KrcCodec(load_ethernet_xml(XML), AXES, FR.driver.inputs, precision=MAX_PRECISION)
"""A KRC that sends all the decimals that there are."""


class DecidedKrcSide(KrcSide):
    """The Robot Server reads a telegram, decides, and answers.

    Attributes:
        answers: all of them, None where there was none.
    """

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.answers = []
        self.ending = False

    def answer(self, datagram, admission=None):
        if admission is not None:
            self.server.take(admission, self.time_s)
        self.server.take(self.supervision(), self.time_s)
        self.answers.append(None)
        self.answers[-1] = self._answered(datagram)
        return self.answers[-1]

    def supervision(self):
        return Supervision(
            robot="fr", epoch=EPOCH, cycle=0, stop=self.order, resets=self.resets, cell=self._identity
        )

    def _answered(self, datagram):
        measured = self.driver.read(datagram, self.time_s)
        if measured is None:
            return self.driver.unmoved
        self.missed = measured.missed_last
        (setpoint,) = self.server.take(measured, self.time_s)
        stop = self.ending or setpoint.motion_stop
        answer = self.driver.reply(setpoint.q_cmd, setpoint.outputs, stop)
        if self.driver.fault is not None:
            self.server.reply_refused(self.driver.q_sent)
        return answer


def lets_pass(bounds, correction):
    """What machine code says of a correction right before its reply is sent."""
    return allows(np.array(correction), np.array(bounds.lower), np.array(bounds.upper))


class PreparedKrcSide(DecidedKrcSide):
    """A reply is prepared before every telegram, and sent if it is for that telegram.

    Attributes:
        prompt: replies that were sent before anything was decided.
    """

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.preparation = preparation(preparing(), self.server, self.driver, XML)
        self.newest = b""
        self.prompt = 0

    def _answered(self, datagram):
        prepared = self.preparation.after(self.newest, self.ending, self.time_s)
        is_prompt = (
            prepared is not None
            and is_expected(prepared.telegram, np.frombuffer(datagram, dtype=np.uint8), len(datagram))
            and self.driver.bounds is not None
            and lets_pass(self.driver.bounds, prepared.correction)
        )
        self.newest = b""
        cycle = self.server._cycle
        answer = super()._answered(datagram)
        if self.server._cycle != cycle:
            self.newest = datagram
        if is_prompt:
            assert answer == prepared.reply
            assert tuple(self.driver._sent.tolist()) == prepared.correction
            self.prompt += 1
        return answer


class AnsweredStorm(Storm):
    """A storm whose ledger is not kept: only what is answered counts. The true KRC is heard more often."""

    def __init__(self, seed):
        super().__init__(seed)
        self._kinds += (*[self._true] * 30, self._anew)

    def _anew(self):
        if self.random.random() < 0.05:
            self._begin_anew()

    def _hand(self, datagram, admission=None):
        krc = self.krc
        self.telegrams += 1
        cycle = krc.server._cycle
        try:
            answer = krc.answer(datagram, admission)
        except TelegramError:
            return
        if krc.server._cycle != cycle:
            self._heard_s = krc.time_s
        if answer is not None:
            told = krc.codec.decode(answer)
            if told.ipoc == krc.ipoc:
                krc.correction = told.correction


class RestlessStorm(AnsweredStorm):
    """A storm in which the true KRC, the gate and the process itself do what they seldom do, too."""

    def __init__(self, seed):
        super().__init__(seed)
        self._late = 0
        self._kinds += (self._off, self._off, self._at_an_edge, self._missed, self._stopped, self._ended)

    def _true(self):
        if self.krc.order is not None and self.random.random() < 0.2:
            self.krc.order = None
        super()._true()

    def _off(self):
        """The robot lags, or is pushed, by about what is tolerated."""
        self.krc.tick()
        off = np.array([self.random.gauss(0.0, 1.0) for _ in range(6)])
        self._hand(self.krc.own(q=self.krc.q + 0.3 * off * FR.tracking_tolerance))

    def _at_an_edge(self):
        """One joint stands at the edge of what is tolerated, to the last decimals of a telegram."""
        self.krc.tick()
        server, joint = self.krc.server, self.random.randrange(6)
        edges = [FR.tracking_tolerance, ADRIFT * pulse_sums(FR)]
        q = server._held_at.copy() if len(server._held_at) else self.krc.q
        sign = self.random.choice([-1, 1])
        hair = self.random.choice([0.0, 1e-10, -1e-10, 1e-8, -1e-8, 1e-6, -1e-6])
        q[joint] += sign * (self.random.choice(edges)[joint] + hair)
        own = telegram(self.krc.ipoc, q, self.krc.q_programmed, codec=FINE)
        self._hand(own)

    def _missed(self):
        self.krc.tick()
        self._late += 1
        self._hand(self.krc.own(delay=self._late))

    def _stopped(self):
        if self.random.random() < 0.1:
            self.krc.order = ReasonCode.OPERATOR_STOP
        self._true()

    def _ended(self):
        """The process is asked to end, and is not."""
        self.krc.ending = self.random.random() < 0.3
        self._true()


def storms(monkeypatch, kind, seed, telegrams):
    """The same storm without and with prepared replies; returns both sides of the KRC."""
    sides = []
    for side in (DecidedKrcSide, PreparedKrcSide):
        monkeypatch.setattr(telegram_storm, "KrcSide", side)
        storm = kind(seed)
        storm.run(telegrams)
        sides.append(storm.krc)
    return sides
