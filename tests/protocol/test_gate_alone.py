"""`deltaq.Gate`: bad input changes nothing, decisions are the core's, and foreign arms keep clear."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from ran import ran

from deltaq import Box, Capsule, Cylinder, Gate, GateError, Mesh, Sphere
from deltaq.foreign_robot import in_convex_parts, whole_body
from deltaq.obstacles import Obstacle
from deltaq_cell.models import RobotModelError, load_urdf
from deltaq_cell.never_checked import distances
from deltaq_protocol.messages import Outcome

ROBOTS = "package://example-robot-data/robots"
PANDA = f"{ROBOTS}/panda_description/urdf/panda.urdf"
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
TABLE = Box((1.2, 0.8, 0.05), at=(0.75, 0.0, -0.03))


def panda(**changed):
    options = {"cycle_s": 0.004, "obstacles": {"table": TABLE}, "q": READY, "locked": FINGERS} | changed
    return Gate.from_urdf(PANDA, **options)


@pytest.fixture(scope="module")
def arm():
    return panda()


@pytest.fixture
def gate(arm):
    for name in set(arm.obstacles) - {"table"}:
        arm.remove(name)
    arm.place("table", TABLE)
    arm.reset(READY)
    return arm


def distance_m(gate, body):
    """From the arm to an obstacle, as coal measures it."""
    robot = gate.cell.robots["arm"]
    bodies = [*robot.geometry.geometryObjects, *gate.cell.structure]
    pairs = [(link.name, f"structure/{body}") for link in bodies if int(link.parentJoint)]
    return distances(robot.model, bodies, pairs, [gate.q_cmd()]).min()


def memory(gate):
    return gate._sim.snapshot(), gate.q_cmd().tolist(), gate.obstacles


SEVEN = [0.0] * 7


@pytest.mark.parametrize(
    ("act", "field", "bound"),
    [
        (lambda gate: gate.step([math.nan, *SEVEN[1:]]), "dq", "finite"),
        (lambda gate: gate.step([1e-3j, *SEVEN[1:]]), "dq", "7 numbers"),
        (lambda gate: gate.step([math.inf, *SEVEN[1:]]), "dq", "finite"),
        (lambda gate: gate.step([1e300, *SEVEN[1:]]), "dq", r"at most 1e\+06"),
        (lambda gate: gate.step([0.0] * 6), "dq", r"shape \(7,\)"),
        (lambda gate: gate.step("fast"), "dq", "7 numbers"),
        (lambda gate: gate.step({"leg": SEVEN}), "robot", "one of arm"),
        (lambda gate: gate.step(SEVEN, time_s=-0.1), "time_s", "must be at least 0"),
        (lambda gate: gate.step(SEVEN, time_s=math.nan), "time_s", "finite"),
        (lambda gate: gate.step(SEVEN, time_s="now"), "time_s", "a number"),
        (lambda gate: gate.would_admit([9.0, *READY[1:]], SEVEN), "q_cmd", "panda_joint1 .* limits"),
        (lambda gate: gate.would_admit(READY, [0.0]), "dq", r"shape \(7,\)"),
        (lambda gate: gate.observe([0.0] * 8), "q", r"shape \(7,\)"),
        (lambda gate: gate.observe([math.nan] * 7), "q", "finite"),
        (lambda gate: gate.reset([9.0, *READY[1:]]), "q", "panda_joint1 .* limits"),
        (lambda gate: gate.remove("chair"), "name", "one of table"),
        (lambda gate: gate.place("Chair", TABLE), "obstacles", "a-z"),
        (lambda gate: gate.place(5, TABLE), "obstacles", "a-z"),
        (lambda gate: gate.place("chair", "a chair"), "obstacles.chair", "Box, Sphere"),
        (lambda gate: gate.place("chair", Box((1, 1))), "obstacles.chair.size_m", r"shape \(3,\)"),
        (lambda gate: gate.place("chair", Box((1, 1, -1))), r"obstacles.chair.size_m\[2\]", "above 0"),
        (lambda gate: gate.place("chair", Sphere(math.nan)), "obstacles.chair.radius_m", "finite"),
        (lambda gate: gate.place("chair", Capsule(0.1, 0)), "obstacles.chair.length_m", "above 0"),
        (lambda gate: gate.place("chair", Sphere(0.1, at=(9e9, 0, 0))), "obstacles.chair.at", "at most"),
        (lambda gate: gate.place("chair", Sphere(0.1, rpy=(0, 0))), "obstacles.chair.rpy", "shape"),
        (lambda gate: gate.place("chair", Mesh("no.stl")), "obstacles.chair.mesh", "must be a file"),
        (lambda gate: gate.place("chair", Mesh(np.zeros((9, 3)))), "obstacles.chair.mesh", "volume"),
        (lambda gate: gate.place("chair", Mesh(np.eye(3) * math.nan)), "obstacles.chair.mesh", "within"),
        (lambda gate: gate.place("chair", Mesh(np.eye(3), scale=0)), "obstacles.chair.scale", "above 0"),
        (lambda gate: gate.place("chair", Box((2, 2, 2))), "obstacles.chair", "must not overlap"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(gate, act, field, bound):
    gate.step([1e-5] * 7)
    before = memory(gate)
    with pytest.raises(GateError, match=f"^{field}: .*{bound}.*, got .*; ") as told:
        act(gate)
    assert memory(gate) == before
    assert told.value.remedy
    assert told.value.bound in str(told.value)
    assert gate.step([1e-5] * 7).admitted


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"cycle_s": 0.0}, "cycle_s"),
        ({"cycle_s": 0.0001}, "cycle_s"),
        ({"cycle_s": math.nan}, "cycle_s"),
        ({"stop_distance_m": -0.1}, "stop_distance_m"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"lag_s": -1.0}, "lag_s"),
        ({"q": [0.0] * 7}, "q"),
        ({"q": [0.0] * 3}, "q"),
        ({"joint_limits": "missing.yaml"}, "joint_limits"),
        ({"srdf": "missing.srdf"}, "srdf"),
        ({"obstacles": {"box": Box((3, 3, 3))}}, "q"),
        ({"self_stop_distance_m": 0.5}, "self_stop_distance_m"),
        ({"obstacles": [TABLE]}, "obstacles"),
        ({"locked": {"panda_finger_joint1": "open"}}, "locked.panda_finger_joint1"),
    ],
)
def test_impossible_arguments_of_a_gate_are_refused(options, field):
    with pytest.raises(GateError, match=rf"^{field}: "):
        panda(**options)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('lower="-2" upper="2"', "", "elbow.upper: must be above lower"),
        ('velocity="1"', 'velocity="0"', "elbow.velocity: must be above 0"),
        ('velocity="1"', "", "elbow.velocity: must be given"),
        ('<limit lower="-2" upper="2" velocity="1" effort="1"/>', "", "elbow.velocity: must be given"),
        ('size="0.5 0.1 0.1"', 'size="500 100 100"', "is 500 m long"),
        ('velocity="1"', 'velocity="1" acceleration="-3"', "elbow.acceleration: must be above 0"),
        (
            'velocity="1"',
            'velocity="1" acceleration="fast"',
            "elbow.acceleration: must be a number, got .*fast",
        ),
    ],
)
def test_a_urdf_without_limits_or_in_other_units_is_refused(tmp_path, old, new, message):
    urdf = tmp_path / "one.urdf"
    urdf.write_text(ONE.replace(old, new), encoding="utf-8")
    with pytest.raises((GateError, RobotModelError), match=message):
        Gate.from_urdf(urdf, 0.004)


def test_boolean_limits_and_obstacles_without_a_shape_are_refused(tmp_path):
    urdf, limits = tmp_path / "one.urdf", tmp_path / "joint_limits.yaml"
    urdf.write_text(ONE, encoding="utf-8")
    limits.write_text(
        "joint_limits: {elbow: {has_velocity_limits: true, max_velocity: true}}", encoding="utf-8"
    )
    with pytest.raises(GateError, match=r"^joint_limits\.elbow\.max_velocity: must be a number"):
        Gate.from_urdf(urdf, 0.004, joint_limits=limits)
    with pytest.raises(TypeError, match="abstract"):
        Obstacle()


ONE = """<robot name="one"><link name="base"/>
<link name="lever"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="lever"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""


def test_every_limit_names_its_source(tmp_path):
    urdf, limits = tmp_path / "one.urdf", tmp_path / "joint_limits.yaml"
    urdf.write_text(ONE, encoding="utf-8")
    srdf = tmp_path / "one.srdf"
    srdf.write_text('<robot><disable_collisions link1="base" link2="lever"/></robot>', encoding="utf-8")
    assert "velocity / 0.4 s" in Gate.from_urdf(urdf, 0.004).sources["elbow.acceleration"]
    limits.write_text(
        "joint_limits: {elbow: {has_velocity_limits: true, max_velocity: 0.5, has_acceleration_limits: true, "
        "max_acceleration: 3.0, max_position: 9.0}}",
        encoding="utf-8",
    )
    gate = Gate.from_urdf(urdf, 0.004, srdf=srdf)
    assert gate.sources == {
        "elbow.lower": "-2, URDF",
        "elbow.upper": "2, URDF",
        "elbow.velocity": "0.5, joint_limits.yaml",
        "elbow.acceleration": "3, joint_limits.yaml",
    }


def test_an_increment_is_admitted_limited_or_held_with_a_reason(gate):
    assert gate.step([5e-5] * 7).admitted
    step = gate.step([0.1] * 7)
    assert step.outcome is Outcome.SCALED
    assert step.why.startswith("acceleration_limit panda_joint1: ")
    down = np.array([0, 1, 0, 0, 0, 0, 0]) * 0.004
    steps = [gate.step(down) for _ in range(600)]
    last = steps[-1]
    assert last.outcome is Outcome.HELD
    assert last.reasons[0].code == "clearance"
    assert last.verdict.receipt
    assert 0.02 <= distance_m(gate, "table") < 0.021
    np.testing.assert_allclose(last.dq, 0.0, atol=1e-12)
    assert gate.step(-down).scale > 0.0


def test_a_query_gives_the_verdict_of_the_step_without_effect(gate):
    asked = np.array([0, 1, 0, 0, 0, 0, 0]) * 0.004
    for _ in range(400):
        before = memory(gate)
        told = gate.would_admit(None, asked)
        assert memory(gate) == before
        done = gate.step(asked)
        np.testing.assert_array_equal(told.dq, done.dq)
        np.testing.assert_array_equal(told.q_cmd, done.q_cmd)
        assert (told.outcome, told.reasons) == (done.outcome, done.reasons)
    assert gate.would_admit(READY, [1e-5] * 7).admitted


def test_omitted_cycles_brake_the_arm(gate):
    moving = np.array([1, 0, 0, 0, 0, 0, 0]) * 0.0005
    for number in range(50):
        step = gate.step(moving, time_s=number * 0.004)
    assert step.dq[0] > 0.0
    at = gate.q_cmd()
    late = gate.step(SEVEN, time_s=49 * 0.004 + 1.0)
    assert not late.dq.any()
    assert gate.q_cmd()[0] > at[0]
    with pytest.raises(GateError, match=r"^time_s: "):
        gate.step(SEVEN, time_s=0.0)


def test_an_arm_off_its_path_is_held_until_a_reset(gate):
    gate.observe(np.array(READY) + 5e-5)
    assert gate.step([1e-5] * 7).admitted
    gate.observe(np.array(READY) + 0.1)
    assert gate.step([1e-5] * 7).outcome is Outcome.REFUSED
    refused = gate.step([1e-5] * 7)
    assert refused.why.startswith("tracking_error")
    assert refused.scale == 0.0
    gate.reset(READY)
    assert gate.step([1e-5] * 7).admitted


def test_obstacles_are_added_moved_and_removed_between_steps(gate):
    hand = gate.cell.robots["arm"].forward(READY)[:3, 3]
    turn = [0.004, *SEVEN[1:]]
    far = Sphere(0.05, at=(2.0, 2.0, 2.0))
    gate.place("ball", far)
    assert gate.step([1e-5] * 7).admitted
    gate.place("ball", Sphere(0.05, at=(0.7 * hand[0], 0.7 * hand[0], hand[2])))
    while gate.step(turn).outcome is not Outcome.HELD:
        pass
    held = gate.step(turn)
    assert "structure/ball" in held.why
    assert held.verdict.receipt
    gate.place("ball", far)
    assert gate.step(turn).scale > 0.0
    gate.remove("ball")
    assert set(gate.obstacles) == {"table"}
    assert gate.step(turn).scale > 0.0


def test_within_the_stop_distance_of_an_obstacle_the_arm_may_only_retreat(gate):
    down = np.array([0, 1, 0, 0, 0, 0, 0]) * 0.004
    while gate.step(down).dq.any():
        pass
    gap = distance_m(gate, "table")
    gate.place("table", Box((1.2, 0.8, 0.05), at=(0.75, 0.0, gap / 2 - 0.03)))
    for _ in range(20):
        nearer = gate.step(down)
        assert distance_m(gate, "table") > gap / 2 - 1e-4
    assert nearer.outcome is Outcome.HELD
    for _ in range(500):
        gate.step(-down)
    assert distance_m(gate, "table") > 0.02


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5
CUBES_FACES = np.array([int(corner) for corner in "124143578586156162348387137175268284"]).reshape(-1, 3)


def write_boxes(path, *boxes):
    """A mesh of boxes, each with the lengths of its edges and its middle [m]."""
    corners = np.concatenate([CUBE * size + at for size, at in boxes])
    faces = np.concatenate([CUBES_FACES + 8 * number for number in range(len(boxes))])
    lines = [f"v {x} {y} {z}\n" for x, y, z in corners] + [f"f {a} {b} {c}\n" for a, b, c in faces]
    path.write_text("".join(lines), encoding="utf-8")


BODY = "<collision{}><geometry>{}</geometry></collision>"
MESH = '<mesh filename="bent.obj"/>'


@pytest.mark.parametrize(
    ("bodies", "names"),
    [
        (BODY.format("", MESH), ["lever"]),
        (BODY.format("", MESH) + BODY.format("", '<sphere radius="0.1"/>'), ["lever_1", "lever_2"]),
        (BODY.format(' name="a"', MESH) + BODY.format(' name="a"', MESH), ["lever_a", "lever_a_2"]),
    ],
)
def test_a_bent_link_is_split_and_what_a_file_says_of_it_holds_for_all_parts(tmp_path, bodies, names):
    write_boxes(tmp_path / "bent.obj", ((1, 0.2, 0.2), (0.5, 0, 0)), ((0.2, 0.2, 1), (0, 0, 0.5)))
    urdf, srdf = tmp_path / "one.urdf", tmp_path / "one.srdf"
    urdf.write_text(
        ONE.replace(
            '<collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision>',
            bodies,
        ),
        encoding="utf-8",
    )
    _, hulls = in_convex_parts(urdf, {})
    assert len(hulls) > bodies.count("mesh")
    srdf.write_text('<robot><disable_collisions link1="lever" link2="lever"/></robot>', encoding="utf-8")
    gate = Gate.from_urdf(urdf, 0.004, {"ball": Sphere(0.05, at=(0.5, 0.5, 1.5))}, srdf=srdf)
    parts = [body.name.removeprefix("arm/") for body in gate.cell.robots["arm"].geometry.geometryObjects]
    assert list(dict.fromkeys(map(whole_body, parts))) == names
    assert set(hulls) <= set(parts)
    assert distance_m(gate, "ball") > 0.02


def test_a_mesh_without_a_volume_is_refused_by_file_and_link(tmp_path):
    write_boxes(tmp_path / "bent.obj", ((1, 0.2, 0), (0.5, 0, 0)))
    urdf = tmp_path / "one.urdf"
    urdf.write_text(ONE.replace('<box size="0.5 0.1 0.1"/>', MESH), encoding="utf-8")
    with pytest.raises(RobotModelError, match=r"one\.urdf: link 'lever', body 'lever': .* lie in a plane"):
        Gate.from_urdf(urdf, 0.004)


def test_the_arm_keeps_clear_of_meshes_and_shapes(tmp_path):
    urdf = tmp_path / "one.urdf"
    urdf.write_text(ONE, encoding="utf-8")
    cube = tmp_path / "cube.obj"
    write_boxes(cube, ((1, 1, 1), (0, 0, 0)))
    angles, prints = [], []
    for obstacle in (
        Box((1, 1, 1), at=(0.4, 0, 0)),
        Mesh(cube, at=(0.4, 0, 0)),
        Mesh(CUBE * 1000, scale=0.001, at=(0.4, 0, 0)),
        Cylinder(0.5, 1.0, at=(0.4, 0, 0.1), rpy=(math.pi / 2, 0, 0)),
    ):
        gate = Gate.from_urdf(urdf, 0.004, {"body": obstacle})
        for _ in range(900):
            last = gate.step([0.004])
        assert last.why.startswith("clearance arm/lever structure/body")
        angles.append(gate.q_cmd()[0])
        prints.append(gate._sim.fingerprint)
        assert distance_m(gate, "body") == pytest.approx(0.02, abs=5e-4)
    assert angles[0] == pytest.approx(angles[1], abs=1e-3)
    assert angles[1] == angles[2]
    assert prints[0] != prints[1]


def test_several_arms_of_a_cell_keep_clear_of_each_other():
    gate = Gate.from_cell("lab")
    assert set(gate.robots) == {"gr", "fr"}
    start = {name: gate.q_cmd(name) for name in gate.robots}
    for _ in range(300):
        steps = gate.step({"fr": [0.004, 0, 0, 0, 0, 0]})
    assert set(steps) == {"fr"}
    other = next(name for name in gate.robots if name != "fr")
    np.testing.assert_array_equal(gate.q_cmd(other), start[other])
    assert gate.q_cmd("fr")[0] != start["fr"][0]
    with pytest.raises(GateError, match=r"^robot: must be one of"):
        gate.step([0.0] * 6)


def test_importing_deltaq_does_not_load_the_gate():
    program = (
        "import sys, deltaq; print([name for name in ('pinocchio', 'coal', 'numba') if name in sys.modules])"
    )
    done = ran([sys.executable, "-c", program])
    assert done.stdout == "[]\n"


def test_the_urdf_may_be_a_path(tmp_path):
    assert Path(load_urdf(PANDA).source).is_file()
    assert Gate.from_urdf(load_urdf(PANDA).source, 0.004, q=READY, locked=FINGERS).robots == ("arm",)


@pytest.mark.parametrize(
    ("name", "prints"),
    [
        ("gate_in_gymnasium", "held: clearance arm/wrist_3_link structure/table"),
        ("gate_as_action_filter", "'structure/wall'"),
    ],
)
def test_the_example_is_short_and_keeps_clear(name, prints):
    program = Path(__file__).parents[2] / "examples" / f"{name}.py"
    assert len(program.read_text(encoding="utf-8").splitlines()) < 40
    done = ran([sys.executable, str(program)])
    assert prints in done.stdout
