"""A law of forces that folds the arm onto itself, or into the structure, is bent by barriers and by nothing else."""

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_controllers.camera.error import CameraPose, look_on, view_angle, view_jacobians
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera.standing_barriers import StandingBarriers
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.limits import IncrementLimits

FR = lab().robots["fr"]
SCENE = Scene(lab(), "fr", "gr")
LIMITS = IncrementLimits.of(FR, CYCLE_S)
GATE = lab().description.gate
PROXIMITY = CompiledProximity(lab())


@pytest.fixture(scope="module")
def barriers():
    return StandingBarriers(SCENE, LIMITS)


def room_m(q):
    """Distance that is left to the gate's stop distance, from its own bodies and the structure [m]."""
    PROXIMITY.place("fr", q, np.zeros_like(q))
    tightest = PROXIMITY.look(PROXIMITY.alone["fr"], 0.0).tightest
    assert tightest is not None  # the robot has bodies
    same = all(name.startswith("fr/") for name in tightest.pair)
    return tightest.distance_m - (GATE.self_stop_distance_m if same else GATE.stop_distance_m)


def driven(rates, cycles, barriers=None, focus=None):
    """Drive all joints by constant rates (n,) [rad/s]; returns the setpoints, and of each cycle the view's angle."""
    q, dq = np.array(FR.home), np.zeros(FR.n)
    focus = q_focus() if focus is None else focus
    setpoints, angles = [], []
    for _ in range(cycles):
        wanted = LIMITS.admissible(CYCLE_S * rates, q, dq)
        if barriers is not None:
            wanted = LIMITS.admissible(barriers.increment(wanted, q, dq, focus, 1.2), q, dq)
        assert limit_violations(FR, q, wanted, dq) == 0
        q, dq = q + wanted, wanted
        pose = FR.camera_pose(q)
        setpoints.append(q)
        angles.append(view_angle(pose[:3, :3], pose[:3, 3], focus))
    return setpoints, angles


def q_focus():
    """A point in front of the lens at home [m]."""
    pose = FR.camera_pose(FR.home)
    return pose[:3, 3] + 1.2 * pose[:3, 2]


FOLDS = np.array([[0.0, 0.6, 0.8, 0.0, 0.9, 0.0], [0.3, 0.8, -0.3, 0.0, -0.9, 0.0]])


@pytest.mark.parametrize("rates", FOLDS, ids=["onto itself", "onto the floor"])
def test_an_arm_that_its_law_folds_keeps_clear_of_itself_and_of_the_structure(barriers, rates):
    unbent, _ = driven(rates, 300)
    assert min(map(room_m, unbent)) < 0.0  # the law alone would be held
    bent, _ = driven(rates, 300, barriers)
    assert min(map(room_m, bent)) > 0.0


def test_an_increment_that_breaks_no_barrier_is_returned_itself(barriers):
    dq = np.full(FR.n, 1e-4)
    assert barriers.increment(dq, np.array(FR.home), np.zeros(FR.n), q_focus(), 1.2) is dq


@pytest.mark.parametrize("rates", FOLDS, ids=["onto itself", "onto the floor"])
def test_an_increment_that_is_bent_turns_the_view_as_it_was_asked_to(barriers, rates):
    camera = Kinematics(FR, "camera")
    q, dq, bent = np.array(FR.home), np.zeros(FR.n), 0
    for _ in range(300):
        if bent == 20:
            break
        wanted = LIMITS.admissible(CYCLE_S * rates, q, dq)
        kept = barriers.increment(wanted, q, dq, q_focus(), 1.2)
        if kept is not wanted:
            camera.update(q)
            pose = CameraPose(camera.rotation, camera.position, camera.twists)
            view = look_on(pose.rotation, pose.position, q_focus(), pose.twists)
            turning, _ = view_jacobians(view, pose.position, q_focus(), pose.twists)
            assert np.linalg.norm(turning @ (kept - wanted)) < 0.1 * np.linalg.norm(turning @ wanted)
            assert np.linalg.norm(kept - wanted) > 1e-6
            bent += 1
        dq = LIMITS.admissible(kept, q, dq)
        q = q + dq
    assert bent == 20
