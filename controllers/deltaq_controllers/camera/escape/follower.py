"""The quadratic programme, led away from an attacker by a plan that looks seconds ahead.

What corners a reactive follower is a joint's limit a few seconds on. So courses of the arm are tried on a model of
both robots, and while the best one is in danger the programme follows it in place of the evasion of (12): every
limit, every barrier and the view stay above it, as they stand above the evasion.
"""

from __future__ import annotations

from deltaq_controllers.camera.escape.arm import arm_of
from deltaq_controllers.camera.escape.gains import EscapeGains
from deltaq_controllers.camera.escape.plan import EscapePlan
from deltaq_controllers.camera.escape.pursuit import Pursuit
from deltaq_controllers.camera.escape.rollout import CourseStart
from deltaq_controllers.camera.qp_follower import Evasion, QpFollower
from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_controllers.camera.qp_tasks import TaskGains
from deltaq_controllers.camera.scene import Scene
from deltaq_protocol.arrays import Array


class EscapingFollower(QpFollower):
    """Arguments and attributes as of `QpFollower`; `escape_gains` are those of the plan."""

    def __init__(
        self,
        scene: Scene,
        desired_distance_m: float,
        focus: Array | None = None,
        gains: QpGains | None = None,
        escape_gains: EscapeGains | None = None,
    ) -> None:
        led = self._escape_gains = escape_gains or EscapeGains()
        self._gains_led = TaskGains.of(gains or QpGains())._replace(
            evasion_weight=led.led_evasion_weight, distance_weight=led.led_weight, room_weight=led.led_weight
        )
        self._arm = arm_of(scene)
        self._think_anew(scene)
        super().__init__(scene, desired_distance_m, focus, gains)
        self._think_anew(scene)  # warming up it has seen an attacker that is none

    def _think_anew(self, scene: Scene) -> None:
        self._plan = EscapePlan(self._arm, self._escape_gains, scene.cycle_s)
        self._pursuit = Pursuit(scene)

    def _retreat(self, q: Array, dq_last: Array, focus: Array, evade: bool) -> Evasion:
        camera = self._camera
        attacker = self._pursuit.update(self.leader_seen, camera.origins(), camera.position)
        start = CourseStart(q, dq_last / self._cycle_s, focus, float(self.desired_distance_m))
        rates = self._plan.rates(attacker, start)
        if self._plan.cost <= self._escape_gains.acts_above:
            return super()._retreat(q, dq_last, focus, evade)
        return Evasion(rates * self._arm.leads, self._room(q), self._gains_led)
