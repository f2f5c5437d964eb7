"""Robot Servers that die in any cycle of any motion, before a KRC on a bad wire among strangers.

The oracle knows the increment that was sent last and the limits of acceleration, and computes from them alone where
the robot may be: on the straight line of its brake, one increment a cycle at most.
"""

import math
import random
import re

import numpy as np
import pytest
from crash_bench import PEER, CrashSide
from krc_side import FR, MAX_DV

from deltaq_services.robot_server.crash_brake.core import STOP_CYCLES

ROUNDING = 2e-8
_MOST = FR.max_velocity * 0.012


class Death:
    """One death, and what came after it.

    Attributes:
        course: corrections that the brake may reach, in order (m, n); the first is the one that the KRC has.
        at: which of them the KRC has.
    """

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.krc = CrashSide().begin()
        self._move()
        self.course, self.at = self._die(), 0
        self.brake = self.krc.dead()

    def _move(self):
        krc, draw = self.krc, self.random
        for _ in range(draw.randint(1, 40)):
            if draw.random() < 0.15:
                krc.cycle()  # it brakes
                continue
            wanted = np.array(krc.server.state.dq) + MAX_DV * np.array(
                [draw.uniform(-1.0, 1.0) for _ in range(6)]
            )
            krc.cycle(krc.admission(np.clip(wanted, -0.9 * _MOST, 0.9 * _MOST)))

    def _die(self):
        """The last moments: between two cycles, or with a telegram in hand, its reply unsent, or sent and not noted."""
        krc, how = self.krc, self.random.choice(["between", "read", "recorded", "on its way", "not noted"])
        begin = krc.correction.copy()
        dq, step = np.array(krc.server.state.plan.dq), krc.server.state.plan.step
        if how == "between":
            return self._line(begin, dq, step)
        krc.tick()
        own = krc.own()
        if how != "read":
            admission = krc.admission(np.clip(np.array(krc.server.state.dq) + 0.7 * MAX_DV, -_MOST, _MOST))
            answer = krc.codec.decode(krc.answer(own, admission))
            krc.leave(own, is_sent=how == "on its way")
            dq, step = np.array(krc.server.state.plan.dq), krc.server.state.plan.step
            line = self._line(answer.correction, dq, step)
            if how == "not noted":
                krc.correction = answer.correction
                return line
            krc.late += 1
            return np.vstack([begin, line]) if np.any(line[0] != begin) else line
        krc.late += 1
        return self._line(begin, dq, step)

    @staticmethod
    def _line(begin, dq, step):
        cycles = max(1, math.ceil(np.max(np.abs(dq) / MAX_DV) - 1e-6))
        left = [dq * (cycles - k) / cycles for k in range(step + 1, cycles)]
        return np.cumsum([begin, *left], axis=0)

    def run(self):
        for _ in range(400):
            if self.brake.over:
                return
            self._cycle()
        pytest.fail("it never ended")

    def _cycle(self):
        krc, draw = self.krc, self.random
        before, replies = self.brake.correction, self.brake.replies
        krc.tick()
        waiting = [self._rubbish() for _ in range(draw.choice([0, 0, 1, 3]))]
        if draw.random() < 0.9:
            waiting.insert(draw.randint(0, len(waiting)), (krc.own(), PEER))
        reply = self.brake.answer(waiting, krc.time_s)
        assert self.brake.replies - replies == (reply is not None)
        self._judge_step(np.array(before), np.array(self.brake.correction))
        told = krc.codec.decode(reply) if reply is not None else None
        # a reply to a telegram that came late is late to the KRC, which takes it as none
        arrives = told is not None and told.ipoc == krc.ipoc and draw.random() < 0.9
        if told is not None and arrives:
            self._krc_moves(told.correction)
            krc.stop = told.outputs["stop"]
            assert not krc.stop or self.at == len(self.course) - 1
        else:
            krc.late += 1

    def _judge_step(self, before, after):
        """One reply goes no further than an increment from the one before it."""
        assert np.all(np.abs(after - before) <= _MOST * (1 + 1e-6))

    def _krc_moves(self, correction):
        """The KRC may stay, or go to the next place on the line: never further, never off it, never back."""
        nexts = self.course[self.at : self.at + 2]
        off = np.abs(nexts - correction).max(axis=1)
        assert off.min() <= ROUNDING, f"it is at none of its next places: off by {off}"
        self.at += int(off.argmin()) if off.min() < off[0] else 0
        self.krc.correction = correction

    def _rubbish(self):
        own, draw = self.krc.own(), self.random
        kind = draw.randrange(6)
        if kind == 0:
            return own[: draw.randrange(len(own))], PEER
        if kind == 1:
            place = draw.randrange(len(own))
            return own[:place] + bytes([draw.choice(b"<>\x00zX/")]) + own[place:], PEER
        if kind == 2:
            return own, ("192.0.2.17", 1)
        if kind == 3:
            return own, ("192.0.2.99", PEER[1])
        shift = draw.choice([-120, -12, -5, 1, 7, 12 * 1000])
        shifted = re.sub(rb"<IPOC>(\d+)<", lambda m: b"<IPOC>%d<" % (int(m[1]) + shift), own)
        if kind == 4:
            return shifted, PEER
        return self.krc.own(programmed=FR.home + draw.uniform(0.001, 1.0)), PEER


@pytest.mark.long
@pytest.mark.parametrize(
    "block", [0, *(pytest.param(block, marks=pytest.mark.nightly) for block in range(1, 8))]
)
def test_whatever_the_wire_does_the_robot_stays_on_the_line_of_its_brake_and_comes_to_rest(block):
    rested = 0
    for seed in range(100 * block, 100 * block + 100):
        death = Death(seed)
        death.run()
        rested += death.at == len(death.course) - 1
    assert rested > 90  # others ended where the KRC was silent for too long


@pytest.mark.parametrize("seed", range(40))
def test_on_a_good_wire_no_limit_of_acceleration_is_passed_and_the_robot_rests_where_its_brake_ends(seed):
    krc = CrashSide().begin()
    draw = random.Random(seed)
    for _ in range(draw.randint(1, 40)):
        wanted = np.array(krc.server.state.dq) + MAX_DV * np.array(
            [draw.uniform(-1.0, 1.0) for _ in range(6)]
        )
        krc.cycle(krc.admission(np.clip(wanted, -0.9 * _MOST, 0.9 * _MOST)))
    brake = krc.dead()
    while not brake.over:
        krc.after(brake)
    steps = np.diff(np.array(krc.setpoints), axis=0)
    assert np.all(np.abs(np.diff(steps, axis=0)) <= MAX_DV * (1 + 1e-6) + 4 * ROUNDING)
    assert not steps[-STOP_CYCLES:].any()
    assert krc.stop
