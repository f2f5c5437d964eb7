"""The end of a Robot Server's process: the robot comes to rest first, and its KRC gets the signal to end the motion."""

from __future__ import annotations

import signal
from types import FrameType

from deltaq_services.robot_server.core import RobotServer

_STOP_CYCLES = 3
"""Replies that carry the stop before the process ends: one or two may be lost."""


class Ending:
    """Takes SIGTERM and Ctrl-C: the first asks for an end, the second ends at once.

    Args:
        server: brings the robot to rest.

    Attributes:
        stop: whether the KRC has to end the motion, because no process will answer it any more.
        over: the process may end.
    """

    def __init__(self, server: RobotServer) -> None:
        self.stop = False
        self.over = False
        self._server = server
        self._asked = False
        self._stops_sent = 0
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def cycle_passed(self) -> None:
        """The KRC was answered, or is silent."""
        if not self._asked:
            return
        self._server.end()
        self._stops_sent += self.stop
        self.stop = self._server.at_rest
        self.over = self._stops_sent >= _STOP_CYCLES

    def krc_silent(self) -> None:
        """The KRC cannot be answered: there is nothing to wait for."""
        self.over = self._asked

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True
