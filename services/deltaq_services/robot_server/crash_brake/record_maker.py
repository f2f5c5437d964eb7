"""Makes the records that a Robot Server leaves, of what it is about to send."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.robot_server.crash_brake.core import CrashPlan
from deltaq_services.robot_server.crash_brake.record import CrashRecord, CrashRecords
from deltaq_services.robot_server.rsi_driver import RsiDriver


class CrashRecordMaker:
    """Makes the records of one robot.

    Args:
        plan: of the robot.
        rsi: its driver, which is only looked at.
        outputs: names of its digital outputs, in the order of the cell.
    """

    def __init__(self, plan: CrashPlan, rsi: RsiDriver, outputs: tuple[str, ...]) -> None:
        self._telegrams = plan.telegrams()
        self._records = CrashRecords(len(plan.most), plan.outputs)
        self._rsi, self._outputs = rsi, outputs

    def body(self, record: CrashRecord | None) -> bytes | None:
        """The bytes of a record, see `CrashRecords.body`; None if a number does not fit into it."""
        try:
            return None if record is None else self._records.body(record)
        except struct.error:
            return None

    def of_last(
        self, datagram: bytes, ipoc: int, outputs: Mapping[str, bool], motion: SetpointMotion
    ) -> CrashRecord | None:
        """The record of the reply that the driver made last.

        Args:
            datagram: the telegram that is answered.
            ipoc: of that telegram.
            outputs: of the reply, by name.
            motion: the motion that the reply belongs to.

        Returns:
            None if no process could continue from it, because the telegram does not have the usual layout.
        """
        telegram, ipoc_step = self._telegrams.read(datagram), self._rsi.session.step
        if telegram is None or ipoc_step is None:
            return None
        if self._rsi.fault is not None:
            motion = SetpointMotion.at_rest(motion.q_cmd)  # the KRC gets its last correction again, and stays
        lower, upper = self._rsi.limits
        return CrashRecord(
            ipoc=ipoc,
            late=telegram.late,
            programmed=telegram.programmed,
            ipoc_step=ipoc_step,
            outputs=tuple([bool(outputs.get(name)) for name in self._outputs]),
            correction=self._rsi.correction,
            plan_dq=tuple(motion.plan_dq.tolist()),
            brake_cycles=motion.brake_cycles,
            step=motion.step,
            lower=lower,
            upper=upper,
        )
