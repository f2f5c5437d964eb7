"""The quadratic programme, led away from an attacker by a plan that looks seconds ahead.

What corners a reactive follower is a joint's limit a few seconds on. So courses of the arm are tried on a model of
both robots, and while the best one is in danger the programme follows it in place of the evasion of (12): limits,
least distances and the view stay above it, as they stand above the evasion. Only the distance that others need to
brake in is left to the course, which has foreseen where they go.
"""

from __future__ import annotations

import math

import numpy as np

from deltaq_controllers.camera.escape.arm import arm_of
from deltaq_controllers.camera.escape.gains import EscapeGains
from deltaq_controllers.camera.escape.plan import EscapePlan
from deltaq_controllers.camera.escape.pursuit import Pursuit
from deltaq_controllers.camera.escape.rollout import CourseStart
from deltaq_controllers.camera.qp_follower import QpFollower, Withdrawal
from deltaq_controllers.camera.qp_tasks import Evasion
from deltaq_controllers.surroundings.barriers import Keeping
from deltaq_protocol.arrays import Array


class EscapingFollower(QpFollower):
    """Arguments and attributes as of `QpFollower`."""

    def _warm_up(self) -> None:
        """Make the plan, of which the first cycles are part, and make it anew after them."""
        led = self._escape_gains = EscapeGains()
        self._gains_led = self._gains_near._replace(
            evasion_weight=led.led_evasion_weight, distance_weight=led.led_weight, room_weight=led.led_weight
        )
        self._arm = arm_of(self._scene)
        self._led = np.eye(len(self._arm.leads))[self._arm.leads > 0.0]
        self._keeping_led = self._keeping._replace(reaction_s=0.0, others_brake_m_s2=math.inf)
        self._think_anew()
        super()._warm_up()
        self._think_anew()  # warming up it has seen an attacker that is none

    def _think_anew(self) -> None:
        self._plan = EscapePlan(self._arm, self._escape_gains, self._cycle_s)
        self._pursuit = Pursuit(self._scene)

    def _retreat(self, q: Array, dq_last: Array, focus: Array, evade: bool) -> Withdrawal:
        camera = self._camera
        attacker = self._pursuit.update(self.leader_seen, camera.origins(), camera.position)
        start = CourseStart(q, dq_last / self._cycle_s, focus, float(self.desired_distance_m))
        rates = self._plan.rates(attacker, start)
        if not self._is_led:
            return super()._retreat(q, dq_last, focus, evade)
        # a row for each joint: along the course alone, the joint with the greatest acceleration would do it all
        return Withdrawal(Evasion(self._led, self._led @ rates, self._room(q)), self._gains_led)

    @property
    def _is_led(self) -> bool:
        return self._plan.cost > self._escape_gains.acts_above

    def _kept(self) -> Keeping:
        return self._keeping_led if self._is_led else super()._kept()
