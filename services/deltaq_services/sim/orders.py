"""Standing orders of the gate to one Robot Server: stop, reset, digital outputs.

Orders are levels that supervision messages repeat, so that a lost message costs one cycle. While increments are
admitted it costs up to four (`SparedSupervision`); a stop ends the admissions.
"""

from __future__ import annotations

from collections import Counter

from deltaq_protocol.guarded import Admission, OrdersMemory, ServerState, Supervision
from deltaq_protocol.messages import Message, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE
from deltaq_services.sim.tracker import Tracker

_MOST_AWAITED = 64
"""Commands of one kind whose answer may be outstanding."""


class Orders:
    """The orders to one robot, and when they are given or refused.

    Attributes:
        standing_stop: reason of a stop that the robot has not shown yet.
        resets: the count of resets that the Robot Server shall reach.
        outputs: digital outputs by name.
    """

    def __init__(self, robot: Tracker, hli_timeout_cycles: int) -> None:
        self.standing_stop: ReasonCode | None = None
        self.resets = 0
        self.outputs: dict[str, bool] = {}
        self._robot = robot
        self._hli_timeout_cycles = hli_timeout_cycles
        self._cycles_without_hli: int | None = None
        self._krc_silent = False
        self._awaited_resets: list[int] = []
        self._awaited_stops: list[int] = []

    def snapshot(self) -> OrdersMemory:
        """Snapshot for `restore`."""
        return OrdersMemory(
            standing_stop=self.standing_stop,
            resets=self.resets,
            outputs=dict(self.outputs),
            cycles_without_hli=self._cycles_without_hli,
            krc_silent=self._krc_silent,
            awaited_resets=tuple(self._awaited_resets),
            awaited_stops=tuple(self._awaited_stops),
        )

    def restore(self, memory: OrdersMemory) -> None:
        """Restore a snapshot of other orders to this robot."""
        self.standing_stop, self.resets = memory.standing_stop, memory.resets
        self.outputs = dict(memory.outputs)
        self._cycles_without_hli, self._krc_silent = memory.cycles_without_hli, memory.krc_silent
        self._awaited_resets = list(memory.awaited_resets)
        self._awaited_stops = list(memory.awaited_stops)

    def hli_heard(self) -> None:
        """The HLI gave a heartbeat."""
        self._cycles_without_hli = 0

    def cycle_passed(self) -> None:
        """The robot's KRC began another cycle."""
        self._krc_silent = False
        if self._cycles_without_hli is not None:
            self._cycles_without_hli += 1

    def repeated(self, state: ServerState) -> None:
        """Take a repeated state of a Robot Server whose KRC is silent."""
        if state is self._robot.state:  # a state that was overtaken is not used
            self._krc_silent = state.reason is ReasonCode.KRC_LOST

    def judge(self) -> None:
        """Order a stop if the newest state or the HLI's silence requires one; drop a completed stop."""
        state = self._robot.state
        assert state is not None  # judged on a state
        self.resets = max(self.resets, state.resets)
        if state.phase is Phase.HELD:
            # while a reset is on its way, this is the hold that it ends, and no answer to a stop taken since
            if state.resets >= self.resets:
                self.standing_stop = None
        elif state.phase in MAY_MOVE:
            if self._robot.off_path() is not None:
                self.stop(ReasonCode.TRACKING_ERROR)
            if self._cycles_without_hli is not None and self._cycles_without_hli > self._hli_timeout_cycles:
                self.stop(ReasonCode.HLI_LOST)

    def server_restarted(self, state: ServerState) -> None:
        """Another Robot Server process took the place of the one that knew of holds and resets: hold it."""
        self.resets = state.resets
        self._awaited_resets = []  # they belonged to a hold that is forgotten
        self.stop(ReasonCode.SERVER_LOST)

    def stop(self, reason: ReasonCode) -> None:
        """Order the robot to brake and hold; the first reason is kept."""
        self.standing_stop = self.standing_stop or reason

    def awaits_stop(self, command_id: int) -> bool:
        """Whether a stop is still to be shown by the robot."""
        return command_id in self._awaited_stops

    def answer_when_stopped(self, command_id: int) -> None:
        """Answer a stop once the robot shows it; one that is held already shows it now."""
        if not self._is_latched() and command_id not in self._awaited_stops:
            self._awaited_stops = [*self._awaited_stops, command_id][-_MOST_AWAITED:]

    def latched(self) -> list[int]:
        """Ids of the stops that the newest state shows as done."""
        if not self._is_latched():
            return []
        done, self._awaited_stops = self._awaited_stops, []
        return done

    def _is_latched(self) -> bool:
        state = self._robot.state
        # while a reset is on its way, this is the hold that it ends; and one that is offline takes no admission
        return state is not None and (
            state.phase is Phase.OFFLINE or (state.phase is Phase.HELD and state.resets >= self.resets)
        )

    def reset(self, command_id: int) -> tuple[ReasonCode, str] | None:
        """Order a reset, to be answered once the robot shows it; returns why not if it is refused."""
        state = self._robot.state
        if state is None:
            return ReasonCode.UNREACHABLE, f"no state from the Robot Server of {self._robot.name}"
        if self._krc_silent:
            return ReasonCode.CAUSE_STANDS, f"the KRC of {self._robot.name} is silent"
        if state.reason is ReasonCode.RSI_MODE:
            return ReasonCode.CAUSE_STANDS, (
                f"the probe did not confirm that the KRC of {self._robot.name} runs RSI_ON(#ABSOLUTE)"
            )
        if state.reason is ReasonCode.CYCLE_MISMATCH:
            return ReasonCode.CAUSE_STANDS, (
                f"the KRC of {self._robot.name} does not run at the cell's cycle; its Robot Server's "
                "status has both figures"
            )
        if state.reason is ReasonCode.DRIVE_LAG:
            lags_ms = ", ".join("-" if lag_s is None else f"{lag_s * 1e3:.0f}" for lag_s in state.lag_s)
            return ReasonCode.CAUSE_STANDS, (
                f"the axes of {self._robot.name} lag {lags_ms} ms, more than gate.servo_lag_s: correct the cell's file"
            )
        if self.standing_stop is not None:
            return ReasonCode.NOT_AT_REST, f"{self._robot.name} is only now being stopped"
        if state.phase is Phase.HELD:
            if not self._robot.at_rest():
                return ReasonCode.NOT_AT_REST, f"{self._robot.name} is still coming to rest"
            off_path = self._robot.off_path()
            if off_path is not None:
                joint, distance, tolerance = off_path
                unit = self._robot.units[joint]
                return ReasonCode.CAUSE_STANDS, (
                    f"joint {joint + 1} of {self._robot.name} is {distance:.4f} {unit} off its setpoint, "
                    f"at most {tolerance:.4f} {unit} is allowed"
                )
            self.resets = state.resets + 1
        self._awaited_resets.append(command_id)
        return None

    def fulfilled(self) -> list[int]:
        """Ids of the reset commands that the newest state shows as done."""
        state = self._robot.state
        if state is None or state.phase is Phase.HELD or state.resets < self.resets:
            return []
        done, self._awaited_resets = self._awaited_resets, []
        return done


_MOST_SPARED = 3
"""Supervision messages in a row that are not sent; fewer if a Robot Server holds soon without them."""


class SparedSupervision:
    """Finds the supervision messages that are not sent: they follow an admission, and repeat orders without a stop.

    It spares fewer in a row than a Robot Server waits for. It is no part of the gate's decisions: the gate's log has
    every message.

    Args:
        gate_timeout_cycles: a Robot Server that hears nothing for so long holds its robot.
    """

    def __init__(self, gate_timeout_cycles: int) -> None:
        self._most = min(_MOST_SPARED, gate_timeout_cycles // 4)
        self._sent: dict[str, tuple[object, ...]] = {}
        self._spared: Counter[str] = Counter()
        self._admitted: set[str] = set()

    def spares(self, message: Message) -> bool:
        """Whether a message of the gate is not sent; to be asked of every message, in order."""
        if isinstance(message, Admission):
            self._admitted.add(message.robot)
        if not isinstance(message, Supervision):
            return False
        robot = message.robot
        orders = (
            message.epoch,
            message.stop,
            message.resets,
            dict(message.outputs),
            message.cell,
            message.tool,
        )
        is_repeated = message.stop is None and orders == self._sent.get(robot)
        if is_repeated and robot in self._admitted and self._spared[robot] < self._most:
            self._admitted.discard(robot)
            self._spared[robot] += 1
            return True
        self._sent[robot], self._spared[robot] = orders, 0
        self._admitted.discard(robot)
        return False
