"""A Robot Server that dies, and its KRC, in virtual time: what it left, and what goes on from there."""

from krc_side import CELL, FR, XML, KrcSide

from deltaq_services.robot_server.crash_brake.core import CrashBrake
from deltaq_services.robot_server.crash_brake.record import SENT, CrashRecords
from deltaq_services.robot_server.crash_brake.watch import CrashRecordMaker
from deltaq_services.robot_server.rsi_driver import crash_plan

PEER = ("192.0.2.17", 49152)
PLAN = crash_plan(CELL, "fr", XML)
TELEGRAMS = PLAN.telegrams()
RECORDS = CrashRecords(len(PLAN.most), PLAN.outputs)


class CrashSide(KrcSide):
    """A KRC before a Robot Server that leaves a record of each reply, as its shell does.

    Attributes:
        memory: what it left.
        late: the KRC's count of cycles without a reply.
        setpoints: corrections in each of the KRC's cycles.
    """

    def __init__(self) -> None:
        super().__init__()
        self.memory = bytearray(RECORDS.total)
        self.number = 0
        self.late = 0
        self.setpoints = [self.correction.copy()]
        self.maker = CrashRecordMaker(PLAN, self.driver, tuple(FR.driver.outputs))

    def own(self, **changes):
        return super().own(**{"delay": self.late, **changes})

    def record(self, datagram):
        """The record of the reply that was made last."""
        state = self.server.state
        return self.maker.body(
            self.maker.of_last(datagram, state.ipoc, self.server.outputs, self.server.motion)
        )

    def leave(self, datagram, is_sent=True):
        """Leave the record of the reply to a telegram, and say that it was sent."""
        self.number += 1
        place, record = RECORDS.sealed(self.record(datagram), self.number, PEER, self.time_s)
        self.memory[place : place + len(record)] = record
        if is_sent:
            SENT.pack_into(self.memory, RECORDS.sent_at, self.number)

    def cycle(self, admission=None, **changes):
        self.tick()
        datagram = self.own(**changes)
        told = self.hand(datagram, admission)
        if self.server.state is not None:
            self.leave(datagram)
        self.setpoints.append(self.correction.copy())
        return told

    def dead(self):
        """What brakes the robot now."""
        return CrashBrake(PLAN, RECORDS.newest(bytes(self.memory)), TELEGRAMS)

    def after(self, brake, *waiting, lost=False):
        """One cycle of the KRC after the death; its telegram comes behind those that wait.

        Returns:
            The reply as the KRC reads it, or None.
        """
        self.tick()
        datagrams = [*waiting] if lost else [*waiting, (self.own(), PEER)]
        reply = brake.answer(datagrams, self.time_s)
        told = None if reply is None else self.codec.decode(reply)
        if told is not None and told.ipoc == self.ipoc:
            self.correction, self.stop = told.correction, told.outputs["stop"]
        else:
            self.late += 1
        self.setpoints.append(self.correction.copy())
        return told

    def until_over(self, brake):
        """The replies to the KRC's cycles until the brake is over, which takes less than two hundred."""
        for _ in range(200):
            if brake.over:
                return
            yield self.after(brake)
        raise AssertionError("the brake goes on and on")
