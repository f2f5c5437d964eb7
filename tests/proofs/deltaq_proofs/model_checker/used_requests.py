"""Which request stands behind which admission: none may move the robot twice, or after a newer one.

Kept apart from the gate, which has its own account: this one sees what the gate is sent, what it answers, and which
admission the Robot Server takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from deltaq_proofs.model_checker.one_joint import LEASE, ROBOT
from deltaq_proofs.model_checker.safety_monitor import Property, Violation
from deltaq_protocol.guarded import Admission, Command, CommandReply, GateMemory, Request, ServerState
from deltaq_protocol.messages import Message, Verdict

_KEPT = 4
"""Admissions of whose requests an account is kept; with a lookahead of up to three no older one can be taken."""

Number = tuple[int, int]
"""Epoch of the gate, and a number that it has not seen twice."""


@dataclass(frozen=True, slots=True)
class UsedRequests:
    """The account.

    Attributes:
        newest: the newest request.
        barred: a stop, a reset or the end of its lease has come since, so that nothing more may be admitted for it.
        behind: the request behind each admission, the newest admission last.
        used: the newest request that moved the robot.
    """

    newest: Number = (0, -1)
    barred: bool = True
    behind: tuple[tuple[Number, Number], ...] = ()
    used: Number = (0, -1)

    def gate_took(
        self, message: Message, answers: Sequence[Message], epoch: int, gate: GateMemory
    ) -> UsedRequests:
        """The gate took a message and answered.

        Args:
            message: to the gate.
            answers: of the gate, in order.
            epoch: of the gate.
            gate: what it remembered before.

        Raises:
            Violation: if it admitted what it must not.
        """
        account = self._asked(message, answers, epoch, gate)
        for admission, verdict in pairwise(answers):
            if isinstance(admission, Admission) and isinstance(verdict, Verdict):
                request = (epoch, verdict.seq)
                if account.barred or request != account.newest:
                    raise Violation(Property.ONCE, "an increment was admitted that is in hand no more")
                behind = (*account.behind, ((epoch, admission.sequence), request))[-_KEPT:]
                account = replace(account, behind=behind)
        return account

    def _asked(
        self, message: Message, answers: Sequence[Message], epoch: int, gate: GateMemory
    ) -> UsedRequests:
        if isinstance(message, Request):
            if message.dq is not None:
                return replace(self, newest=(epoch, message.seq), barred=False)
            newest = gate.robots[ROBOT].tracker.state
            now = newest is None or message.cycle >= newest.cycle
            return replace(self, barred=True) if now and message.lease_epoch != LEASE else self
        if isinstance(message, Command):
            refused = any(isinstance(answer, CommandReply) and not answer.accepted for answer in answers)
            return self if refused else replace(self, barred=True)
        return self

    def server_took(self, before: ServerState | None, after: ServerState) -> UsedRequests:
        """The Robot Server answered a telegram.

        Raises:
            Violation: if it moved the robot by a request that is used up.
        """
        if before is None or after.sequence in (0, before.sequence):
            return self
        request = dict(self.behind)[after.epoch, after.sequence]
        if request <= self.used:
            raise Violation(Property.ONCE, "an increment moved the robot twice, or after a newer one")
        return replace(self, used=request)

    def key(self, admissions: Sequence[Admission], in_hand: bool) -> tuple[object, ...]:
        """What tells two accounts apart.

        Args:
            admissions: those that may still be taken.
            in_hand: whether the gate remembers a request, which can only be the newest.
        """
        under_way = {(one.epoch, one.sequence) for one in admissions}
        return (
            (self.barred, self.newest > self.used) if in_hand else None,
            tuple(request > self.used for admission, request in self.behind if admission in under_way),
        )
