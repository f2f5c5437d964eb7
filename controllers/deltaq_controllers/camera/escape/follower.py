"""The quadratic programme, led away from an attacker by a plan that looks seconds ahead.

A reactive follower is cornered by joint limits a few seconds ahead. So candidate trajectories (courses) of the arm
are tried on a model of both robots, and while the best one is in danger the programme follows it in place of the
evasion of (12): limits, least distances and the view stay above it, as they stand above the evasion. Only the braking
distance of others is left to the course, which has predicted their motion.
"""

import math

import numpy as np

from deltaq_controllers.camera.escape.arm import EscapingArm, arm_of
from deltaq_controllers.camera.escape.rollout import (
    ATTACKERS_M_S2,
    LENS,
    NOTHING,
    Attacker,
    Courses,
    CourseStart,
    EscapeGains,
    Simulation,
    best_course,
)
from deltaq_controllers.camera.qp_follower import QpFollower, Withdrawal
from deltaq_controllers.camera.qp_problem import Evasion
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.spheres import PlacedSpheres, Spheres
from deltaq_controllers.surroundings.barriers import Keeping
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array

# The target of an attacker, estimated from the motion of its tool.

_OUTER_JOINTS = 6
"""Bodies on joints before the last six, as on a gantry, are assumed to come near no robot."""

_SMOOTHS = 0.02
"""Fraction of a new error in the smoothed one, per cycle."""
_FOLLOWS = 0.15
"""Fraction of its error that an expected velocity makes good in a cycle."""
_MOVES_M_S = 0.08
"""Least speed at which a tool is taken to have a target [m/s]."""
_EXPLAINS = 0.22
"""Greatest error of the velocity that a target leads to expect, as a fraction of the greatest speed."""
_STAYS = 0.8
"""Factor of the error of the present target, so that two that are as likely do not alternate."""
_FORGETS = 0.9995
"""Fraction of the greatest speed seen that is still expected a cycle later."""
_LEAST_M_S = 0.05


class Pursuit:
    """The leader as an attacker.

    For each point that its tool may attack, the velocity of a tool that homes in on it is predicted from cycle to
    cycle. The target is the point with the least recent prediction error; there is none if all errors are large. The
    direction of the velocity alone is not enough: a tool that an arm has evaded still turns.

    Args:
        scene: the cell and the roles of its robots.
    """

    def __init__(self, scene: Scene) -> None:
        leader = scene.leader
        self._spheres = PlacedSpheres(leader)
        self._outer = Spheres.of(leader).joints > leader.n - _OUTER_JOINTS
        self._tool = Kinematics(leader, "tool")
        points = 1 + scene.robot.n  # the lens comes first, then the joints
        self._expected, self._errors = np.zeros((points, 3)), np.zeros(points)
        self._speed, self._target, self._cycle_s = _LEAST_M_S, NOTHING, scene.cycle_s

    def update(self, leader: Foreseen, joints: Array, lens: Array) -> Attacker:
        """The attacker with its present target.

        Args:
            leader: how it is seen.
            joints: (n, 3) origins of the own joints, which it may be after [m].
            lens: (3,) which it may be after too [m].
        """
        q = leader.ahead()
        self._tool.update(q)
        tip = self._tool.position
        velocity = self._tool.at_point(tip) @ leader.velocity
        self._speed = max(float(np.linalg.norm(velocity)), _FORGETS * self._speed, _LEAST_M_S)
        self._target = self._aims_at(tip, velocity, np.vstack([lens, joints]))
        centres, radii = self._spheres.at(q)[self._outer], self._spheres.radii[self._outer]
        return Attacker(centres, radii, tip, velocity, self._speed, self._target)

    def _aims_at(self, tip: Array, velocity: Array, points: Array) -> int:
        ways = points - tip
        far = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        toward = np.minimum(self._speed, np.sqrt(2.0 * ATTACKERS_M_S2 * far)) / far
        change = toward[:, None] * ways - self._expected
        size = np.maximum(np.linalg.norm(change, axis=1), 1e-9)
        self._expected += np.minimum(ATTACKERS_M_S2 * self._cycle_s / size, 1.0)[:, None] * change
        error = velocity - self._expected
        self._expected += _FOLLOWS * error
        self._errors += _SMOOTHS * (np.linalg.norm(error, axis=1) - self._errors)
        if self._speed < _MOVES_M_S:
            return NOTHING
        errors = self._errors.copy()
        if self._target != NOTHING:
            errors[self._target - LENS] *= _STAYS
        best = int(np.argmin(errors))
        return LENS + best if errors[best] < _EXPLAINS * self._speed else NOTHING


# The plan: candidates, and the best of them.

_SETS = 256
"""Sets of rivals that are drawn in advance and tried in turn, one a cycle; the choice depends only on the cycle."""

_ANYWHERE, _ABOUT_HELD = 0.5, 0.8
"""Cumulative shares of goals: anywhere in joint space, and near the first goal of the present course."""

_FREE = 0.05
"""Distance of goals from a joint's limits, as a fraction of its range."""

_NEARBY_RAD = 0.35
"""Spread of goals that are drawn about another one."""

_FIRST_STEPS = 3
"""Least time at a course's first goal, in steps."""

_AHEAD = 2
"""Steps of a course from which the leading rates are computed."""


class EscapePlan:
    """Keeps a course, and searches for a better one, with bounded time in every cycle.

    Args:
        arm: the robot.
        gains: horizon and costs.
        cycle_s: time between two calls [s].

    Attributes:
        cost: of the present course, in the last cycle.
    """

    def __init__(self, arm: EscapingArm, gains: EscapeGains, cycle_s: float) -> None:
        n, random = len(arm.lower), np.random.default_rng(0)
        margin = _FREE * (arm.upper - arm.lower)
        self._low, self._high = arm.lower + margin, arm.upper - margin
        shape = (_SETS, 2, gains.rivals, n)
        self._anywhere = random.uniform(self._low, self._high, shape)
        self._nearby = random.normal(0.0, _NEARBY_RAD, shape)
        self._kind = random.random((*shape[:3], 1))
        self._until = random.integers(_FIRST_STEPS, gains.steps + 1, (_SETS, gains.rivals))
        self._set = 0
        self._arm, self._gains, self._cycle_s = arm, gains, cycle_s
        self._simulation = Simulation.of(arm, gains)
        # the held one, the best rival of the last cycle, staying where one is, and new ones
        count = 3 + gains.rivals
        self._courses = Courses(np.zeros((count, n)), np.zeros(count, dtype=np.intp), np.zeros((count, n)))
        self._held: tuple[Array, int, Array] | None = None
        self._rival: tuple[Array, int, Array] | None = None
        self._since_s = 0.0
        self.cost = 0.0

    def rates(self, attacker: Attacker, start: CourseStart) -> Array:
        """(n,) rates along the best known course [rad/s or m/s]."""
        q, gains = start.q, self._gains
        stay = (q, gains.steps, q)
        held = self._held or stay
        self._put(0, held)
        self._put(1, self._rival or stay)
        self._put(2, stay)
        self._draw_rivals(q, held[0])
        best, rival, self.cost = best_course(
            self._arm, attacker, gains, start, self._courses, self._simulation
        )
        self._held, self._rival = self._aged(self._course(best)), self._course(rival)
        rates: Array = (self._simulation.best[_AHEAD - 1] - q) / (_AHEAD * gains.step_s)
        return rates

    def _draw_rivals(self, q: Array, held: Array) -> None:
        """The next candidates; each goal is random, near the first one of the present course, or near `q`."""
        kind, nearby = self._kind[self._set], self._nearby[self._set]
        about = np.where(kind < _ABOUT_HELD, held, q)
        near = np.clip(about + nearby, self._low, self._high)
        self._courses.first[3:], self._courses.then[3:] = np.where(
            kind < _ANYWHERE, self._anywhere[self._set], near
        )
        self._courses.until[3:] = self._until[self._set]
        self._set = (self._set + 1) % _SETS

    def _put(self, place: int, course: tuple[Array, int, Array]) -> None:
        self._courses.first[place], self._courses.until[place], self._courses.then[place] = course

    def _course(self, place: int) -> tuple[Array, int, Array]:
        first, until, then = self._courses
        return first[place].copy(), int(until[place]), then[place].copy()

    def _aged(self, course: tuple[Array, int, Array]) -> tuple[Array, int, Array]:
        """The candidate trajectory, one cycle later."""
        first, until, then = course
        self._since_s += self._cycle_s
        if self._since_s < self._gains.step_s:
            return course
        self._since_s -= self._gains.step_s
        return (first, until - 1, then) if until > 1 else (then, self._gains.steps, then)


class EscapingFollower(QpFollower):
    """Arguments and attributes as of `QpFollower`."""

    def _warm_up(self) -> None:
        """Make the plan, run its first cycles to compile it, and make it again."""
        led = self._escape_gains = EscapeGains()
        self._gains_led = self._gains_near._replace(
            evasion_weight=led.led_evasion_weight, distance_weight=led.led_weight, room_weight=led.led_weight
        )
        self._arm = arm_of(self._scene)
        self._led = np.eye(len(self._arm.leads))[self._arm.leads > 0.0]
        self._keeping_led = self._keeping._replace(reaction_s=0.0, others_brake_m_s2=math.inf)
        self._think_anew()
        super()._warm_up()
        self._think_anew()  # during the warm-up it has seen an attacker that does not exist

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
