"""RSI's wire as the explorer sees it: the KRC, the Robot Server's program at the other end, and what is under way.

The driver, its sessions, the guard of replies and the peer are the service's own code. A telegram is a few numbers
packed into bytes: what cannot be read is dropped before anything is decided, and is no matter of this model.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deltaq_cell.description import CellDescription
from deltaq_proofs.model_checker.one_joint import CYCLE_S, IPOC_STEP, KRC_TIMEOUT_CYCLES, ROBOT
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.rsi import KrcTelegram, SensorCodec
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.session import DatagramSource, Peer

KRC_AT: Address = ("127.0.0.1", 1)
SECOND_AT: Address = ("127.0.0.1", 2)
STRANGER_AT: Address = ("127.0.0.9", 3)

Program = tuple[RsiDriver, Peer]
"""What the Robot Server has at its end of the wire."""

_TELEGRAM = struct.Struct("=IddI")
_REPLY = struct.Struct("=Id")


class Own(NamedTuple):
    """A telegram: IPOC, measured and programmed position [m], late packets so far."""

    ipoc: int
    q: float
    programmed: float
    delay: int = 0

    def packed(self) -> bytes:
        """As it travels."""
        return _TELEGRAM.pack(*self)


class Packed(SensorCodec):
    """Telegrams of the one joint as bare numbers."""

    def __init__(self) -> None:
        """There is no configuration to be read."""

    @property
    def joints(self) -> int:
        """One."""
        return 1

    def decode(self, datagram: bytes) -> KrcTelegram:
        """Unpack a telegram."""
        ipoc, q, programmed, delay = _TELEGRAM.unpack(datagram)
        return KrcTelegram(ipoc, np.array([q]), delay, {}, np.array([programmed]))

    def encode(
        self,
        ipoc: int,
        correction: Array,
        outputs: Mapping[str, bool] | None = None,
        stop: bool = False,
    ) -> bytes:
        """Pack a reply."""
        return _REPLY.pack(ipoc, float(correction[0]))


class TrueKrc(NamedTuple):
    """The true KRC: it follows each correction at once, and keeps the last one (HOLDON).

    Attributes:
        ipoc: of its last telegram.
        programmed: where its session began [m].
        correction: the last that it took [m].
        answered: it took the reply to its last telegram.
        delay: cycles of its session without one.
    """

    ipoc: int
    programmed: float = 0.0
    correction: float = 0.0
    answered: bool = True
    delay: int = 0

    @property
    def stands(self) -> float:
        """Its setpoint [m]."""
        return self.programmed + self.correction

    def ticked(self) -> TrueKrc:
        """A cycle later."""
        return self._replace(
            ipoc=self.ipoc + IPOC_STEP, answered=False, delay=self.delay + (not self.answered)
        )

    def begun_anew(self, off: float) -> TrueKrc:
        """Its program started again, so far off where the robot stood [m]."""
        return TrueKrc(self.ipoc, programmed=self.stands + off)


@dataclass(frozen=True, slots=True)
class RsiLine:
    """What RSI's wire adds to a moment.

    Attributes:
        driver, peer: snapshots of these two of the Robot Server.
        krc: at the other end.
        heard: tick of the last telegram that the core was handed.
        pending: how far the certified increments lead that the KRC was not seen to take, each the sum so far [m].
        sent: the KRC's last telegram.
        overtaken: one that the wire keeps back.
        silent: the KRC sends nothing.
        attacks_left: how many more attacks may begin.
        clock: IPOC of an attacker who passes for a KRC; None while nobody does.
        poses_at: where that attacker sends from.
        posed: it has sent in this cycle.
    """

    driver: RsiDriver
    peer: Peer
    krc: TrueKrc
    heard: int
    attacks_left: int
    pending: tuple[float, ...] = ()
    sent: Own | None = None
    overtaken: Own | None = None
    silent: bool = False
    clock: int | None = None
    poses_at: Address = SECOND_AT
    posed: bool = False

    def read(
        self, program: Program, datagram: Own, sender: Address, tick: int
    ) -> tuple[RsiLine, DatagramSource, Measurement | None, Own | None]:
        """Hand a datagram to the Robot Server's program as its socket does.

        Returns:
            The line after it, whom it was taken for, what is measured, and an answer without a setpoint: its IPOC and
            correction.
        """
        now_s = tick * CYCLE_S
        driver, peer = program
        driver.restore(self.driver)
        peer.restore(self.peer)
        who = peer.judge(sender, now_s)
        if who is not DatagramSource.KRC:
            return self, who, None, None
        measured = driver.read(datagram.packed(), now_s)
        peer.believed(sender, now_s)
        answer = None if driver.unmoved is None else _unpacked(driver.unmoved)
        line = replace(self, driver=driver.snapshot(), peer=peer.snapshot())
        return line, who, measured, answer

    def replied(self, program: Program, q_cmd: Array) -> tuple[RsiLine, Own]:
        """The answer with a setpoint, and the line after it; asked right after the datagram was read."""
        driver, _ = program
        answer = _unpacked(driver.reply(q_cmd, {}))
        return replace(self, driver=driver.snapshot()), answer

    def is_silent(self, tick: int) -> bool:
        """The Robot Server has heard nothing for as long as it may."""
        return tick - self.heard >= KRC_TIMEOUT_CYCLES


def new_line(driver: RsiDriver, peer: Peer, attacks: int) -> RsiLine:
    """The line as a KRC and a Robot Server find it that have just started."""
    return RsiLine(driver, peer, TrueKrc(ipoc=1000), heard=0, attacks_left=attacks)


def new_program(description: CellDescription) -> Program:
    """Driver and peer of a Robot Server's process."""
    driver = RsiDriver(Packed(), description, ROBOT, Counter())
    driver.meter = None  # the model's time is counted in the KRC's own cycles
    return driver, Peer(KRC_AT[0], description.gate.krc_timeout_s)


def _unpacked(reply: bytes) -> Own:
    ipoc, correction = _REPLY.unpack(reply)
    return Own(ipoc, correction, 0.0)
