"""What a browser is shown: the frame's bytes, the scene's kinematics, how far away a robot would come to rest."""

import math
import struct

import numpy as np
import pinocchio as pin
import pytest
from console_bench import BODIES, CELL, ConsoleBench

from deltaq_cell.cell_model import CellModel, robots_told
from deltaq_cell.load import parse_cell
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.messages import NearestPair, Outcome, Phase, Proximity, Sight, ToolPose, ViewTarget
from deltaq_services.console.feed import BRAKING, OUTCOMES, PHASES, STALE
from deltaq_services.console.scene import scene_of

HEAD = struct.Struct("<BBHdHHf6f")
ROBOT = struct.Struct("<BBBBffHHff3f")


def decoded(frame):
    """Head and robots of a frame, read as its description says."""
    head, at, robots = HEAD.unpack_from(frame), HEAD.size, []
    for _ in range(head[1]):
        fields = ROBOT.unpack_from(frame, at)
        at += ROBOT.size
        q, q_rest = np.frombuffer(frame, "<f4", 2 * fields[0], at).reshape(2, -1)
        at += 8 * fields[0]
        robots.append((fields, q, q_rest))
    assert at == len(frame)
    return head, robots


@pytest.fixture
def bench():
    return ConsoleBench()


def test_a_frame_before_the_first_message_is_marked(bench):
    head, robots = decoded(bench.core.picture.frame(bench.now_s))
    assert (head[0], head[1], head[3]) == (2, 2, bench.now_s)
    assert head[4:6] == (65535, 65535)
    assert all(math.isnan(number) for fields, _, _ in robots for number in fields[10:13])
    for fields, _, _ in robots:
        _, phase, outcome, flags, age_s, clearance_m, *_ = fields
        assert (PHASES[phase], outcome, flags) == (Phase.OFFLINE, 255, STALE)
        assert age_s == math.inf
        assert math.isnan(clearance_m)
    assert [fields[0] for fields, _, _ in robots] == [6, 9]


def test_a_frame_holds_the_newest_messages(bench):
    bench.states(Phase.ENGAGED)
    bench.verdict(Outcome.SCALED, clearance_m=0.125, pair=("fr/link_5", "structure/tank_1"))
    bench.verdict(Outcome.ADMITTED, robot="gr", clearance_m=0.25, pair=("gr/link_3", "somewhere/else"))
    bench.core.robots["fr"].feed.arrived(0.02, bench.now_s)
    near = NearestPair(pair=BODIES[:2], distance_m=0.5, points_m=((1, 2, 3), (4, 5, 6)))
    bench.core.picture.take_proximity(Proximity(time_s=0.0, pairs=(near,)))
    bench.now_s += 0.015625
    head, robots = decoded(bench.core.picture.frame(bench.now_s))
    assert head[4:] == (0, 1, 0.5, 1, 2, 3, 4, 5, 6)
    joints, phase, outcome, flags, age_s, clearance_m, a, b, admission, longest_s, *focus = robots[0][0]
    assert focus == pytest.approx((0.1, 0.2, 0.34))  # before the leader's tool
    assert all(math.isnan(number) for number in robots[1][0][10:]), "it carries no camera"
    assert (joints, PHASES[phase], OUTCOMES[outcome], flags) == (6, Phase.ENGAGED, Outcome.SCALED, 0)
    assert (age_s, clearance_m, a, b, admission) == (0.015625, 0.125, 0, 2, 0.0)
    assert longest_s == pytest.approx(0.02)
    assert robots[1][0][6:9] == (1, 65535, 1.0)
    assert robots[0][1] == pytest.approx(CELL.robots["fr"].home, abs=1e-6)
    assert (robots[0][1] == robots[0][2]).all()


def focus_shown(bench, robot=0):
    return decoded(bench.core.picture.frame(bench.now_s))[1][robot][0][10:]


def test_the_target_of_a_camera_is_marked_at_its_reported_place(bench):
    bench.states()
    half = math.sqrt(0.5)
    turned = ToolPose(position=(1.0, 2.0, 3.0), quaternion_wxyz=(half, 0.0, 0.0, half))  # x to y
    bench.state(robot="gr", tool=turned)
    assert focus_shown(bench) == pytest.approx((1.0, 2.0, 3.04)), (
        "nobody says: the tool that it is there to watch"
    )
    bench.state(target=ViewTarget(leader="gr", aim_offset_m=(0.5, 0.0, 0.25)))
    assert focus_shown(bench) == pytest.approx((1.0, 2.5, 3.25))
    bench.state(target=ViewTarget(leader="gr"))
    assert focus_shown(bench) == pytest.approx((1.0, 2.0, 3.04))
    bench.state(target=ViewTarget(focus_m=(7.0, 8.0, 9.0)))
    assert focus_shown(bench) == pytest.approx((7.0, 8.0, 9.0))
    for nowhere in (ViewTarget(leader="ghost"), ViewTarget()):
        bench.state(target=nowhere)
        assert all(math.isnan(number) for number in focus_shown(bench))


def test_each_camera_of_a_cell_has_a_focus_of_its_own():
    robots = CELL.robots | {"aide": CELL.robots["fr"]}
    bench = ConsoleBench(cell=CELL.model_copy(update={"robots": robots}))
    bench.states()
    bench.state(robot="fr", target=ViewTarget(focus_m=(1.0, 0.0, 0.0)))
    bench.state(robot="aide", target=ViewTarget(focus_m=(2.0, 0.0, 0.0)))
    assert [focus_shown(bench, robot)[0] for robot in (0, 2)] == [1.0, 2.0]


def test_the_log_names_the_target_of_a_camera_and_a_lost_sight(bench):
    gr, point = ViewTarget(leader="gr"), ViewTarget(focus_m=(1.0, 0.0, 0.0))
    for target, sight in [(gr, Sight.FRESH), (gr, Sight.FRESH), (gr, Sight.HIDDEN), (point, Sight.FRESH)]:
        bench.state(target=target, sight=sight)
    told = [(event.robot, event.text) for event in bench.core._log.news(bench.now_s) if event.kind == "view"]
    assert told == [
        ("fr", "its camera looks at gr"),
        ("fr", "a body hides its camera's target (view_hidden)"),
        ("fr", "its camera looks at 1,0,0"),
        ("fr", "its camera sees its target"),
    ]


def test_a_moving_robot_is_shown_where_its_brake_would_end(bench):
    step = 0.02
    bench.state(Phase.ENGAGED)
    bench.state(Phase.ENGAGED, moved=step)
    _, q, q_rest = decoded(bench.core.picture.frame(bench.now_s))[1][0]
    max_dv = CELL.robots["fr"].max_acceleration * CELL.cycle_s**2
    dq = np.array([step, 0, 0, 0, 0, 0])
    cycles = brake_cycles(dq, max_dv)
    travel = sum(brake_increment(dq, cycles, k)[0] for k in range(1, cycles + 1))
    assert travel > step
    assert q_rest[0] - q[0] == pytest.approx(travel, abs=1e-5)


def test_braking_and_old_states_are_flagged(bench):
    bench.state(Phase.BRAKING)
    assert decoded(bench.core.picture.frame(bench.now_s))[1][0][0][3] == BRAKING
    bench.now_s += 0.3
    assert decoded(bench.core.picture.frame(bench.now_s))[1][0][0][3] == BRAKING | STALE


def test_rates_cover_the_last_second(bench):
    bench.states(Phase.ENGAGED)
    for _ in range(3):
        bench.verdict(Outcome.HELD)
    bench.core.robots["fr"].feed.arrived(0.5, bench.now_s)
    bench.now_s += 1.1
    bench.states(Phase.ENGAGED)
    bench.verdict(Outcome.ADMITTED)
    fields = decoded(bench.core.picture.frame(bench.now_s))[1][0][0]
    assert fields[8] == 1.0
    assert fields[9] == 0.0


def matrix(numbers):
    return np.array(numbers).reshape(4, 4, order="F")


def placed(robot, q):
    """Poses of the joints from the scene alone, as its description says."""
    poses = {-1: matrix(robot["T_world_base"])}
    for index, joint in enumerate(robot["joints"]):
        motion, axis = np.eye(4), np.array(joint["axis"])
        if joint["kind"] == "revolute":
            motion[:3, :3] = pin.exp3(axis * q[index])
        else:
            motion[:3, 3] = axis * q[index]
        poses[index] = poses[joint["parent"]] @ matrix(joint["parent_T_joint"]) @ motion
    return poses


@pytest.mark.parametrize("name", ["lab-tools", "dawm"])
def test_the_scene_places_every_frame_and_body_like_pinocchio(name):
    cell = CellModel.load(name)
    scene = scene_of(cell, emulated=True)
    random = np.random.default_rng(0)
    for robot, model in zip(scene.document["robots"], cell.robots.values(), strict=True):
        data, visual = model.model.createData(), model.visual
        geometry = visual.createData()
        for _ in range(5):
            q = random.uniform(model.lower, model.upper)
            poses = placed(robot, q)
            for tool in robot["tools"]:
                T_world_tool = poses[tool["joint"]] @ matrix(tool["T_joint_tool"])
                assert T_world_tool == pytest.approx(model.forward(q, tool["name"]), abs=1e-9)
            for name, tool in robot["exchangeable"].items():
                T_world_tool = poses[tool["joint"]] @ matrix(tool["T_joint_tool"])
                assert T_world_tool == pytest.approx(model.forward(q, name), abs=1e-9)
            bodies = {(link["tool"], link["name"]) for link in robot["links"] if link["tool"]}
            assert bodies == {(tool, body) for tool, named in model.tool_bodies.items() for body in named}
            if robot["camera"] is not None:
                camera = robot["camera"]
                T_world_camera = poses[camera["joint"]] @ matrix(camera["T_joint_camera"])
                assert T_world_camera == pytest.approx(model.camera_pose(q), abs=1e-9)
            pin.updateGeometryPlacements(model.model, data, visual, geometry, q)
            expected = sorted(
                tuple(np.round(place.homogeneous.flatten(order="F"), 6)) for place in geometry.oMg
            )
            meshes = [(link["joint"], mesh) for link in robot["links"] for mesh in link["meshes"]]
            drawn = sorted(
                tuple(np.round((poses[joint] @ matrix(mesh["T_link_mesh"])).flatten(order="F"), 6))
                for joint, mesh in meshes
            )
            assert np.array(drawn) == pytest.approx(np.array(expected), abs=2e-6)


def test_the_scene_names_every_body_that_the_gate_measures_and_every_mesh_that_it_serves():
    cell = CellModel.load("lab")
    scene = scene_of(cell, emulated=False)
    robots = scene.document["robots"]
    assert scene.document["emulated"] is False
    links = {link["name"] for robot in robots for link in robot["links"]}
    structure = {body["name"] for body in scene.document["structure"]}
    shown_by = scene.document["body_links"]
    assert len(shown_by) == len(scene.bodies)
    assert set(shown_by) <= links | structure
    assert shown_by[scene.bodies.index("gr/portal_leg_1")] == "gr/portal"
    assert shown_by[scene.bodies.index("fr/link_5")] == "fr/link_5"
    urls = {mesh["url"] for robot in robots for link in robot["links"] for mesh in link["meshes"]} - {None}
    assert urls == {f"/meshes/{name}" for name in scene.meshes}
    assert all(text.startswith("v ") and "\nf " in text for text in scene.meshes.values())
    assert next(robot for robot in robots if robot["name"] == "fr")["camera"]["baseline_m"] == pytest.approx(
        0.12
    )


def test_a_robot_without_its_visual_meshes_is_drawn_by_its_hulls():
    description = CellModel.load("lab").description_message()
    cell = parse_cell(description.yaml)
    nowhere = {name: text.replace("/visual/", "/nowhere/") for name, text in description.urdf.items()}
    told = CellModel.of(cell, robots_told(cell, nowhere, description.hulls), description.yaml)
    scene = scene_of(told, emulated=True)
    assert scene.meshes
    for text in scene.meshes.values():
        corners = text.count("v ")
        faces = [line.split()[1:] for line in text.splitlines() if line.startswith("f ")]
        assert faces
        assert all(1 <= int(corner) <= corners for face in faces for corner in face)
