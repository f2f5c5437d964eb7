"""`RobotModel`: Jacobians, poses, bodies, and what it says when a description does not fit its model."""

import re

import numpy as np
import pinocchio as pin
import pytest
from data_sheet import describe
from pydantic import ValidationError

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Attachment, Body, BoxShape, Camera, Pose, RobotDescription, Tool
from deltaq_cell.models import RobotModelError
from deltaq_cell.robot import RobotModel

BOX = BoxShape(kind="box", size_m=(0.1, 0.1, 0.1))
CAMERA = Camera(pose=Pose(position_m=(0.02, 0.06, 0.17), rpy_deg=(10, 20, 30)))
TOOL = Tool(frame=Pose(position_m=(0.01, -0.02, 0.3), rpy_deg=(5, 0, 90)), bodies={"cube": Body(shape=BOX)})

SCARA = """<robot name="scara">
  <link name="stand"><collision><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision></link>
  <link name="slide"><collision name="rail"><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="arm"/>
  <joint name="lift" type="prismatic"><parent link="stand"/><child link="slide"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="0"/></joint>
  <joint name="swing" type="{kind}"><parent link="slide"/><child link="arm"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="0"/></joint>
</robot>"""
SCARA_JOINTS = {
    "lift": {"home_m": 0, "lower_m": 0, "upper_m": 1, "max_velocity_m_s": 1, "max_acceleration_m_s2": 1},
    "swing": {
        "home_deg": 0,
        "lower_deg": -50,
        "upper_deg": 50,
        "max_velocity_deg_s": 50,
        "max_acceleration_rad_s2": 1,
    },
}


@pytest.fixture(scope="module", params=["kr16", "kr16_gantry"])
def robot(request: pytest.FixtureRequest) -> RobotModel:
    base = Pose(position_m=(1, 2, 0.5), rpy_deg=(0, 10, 40))
    return RobotModel(describe(request.param, base=base, camera=CAMERA, tool=TOOL), "r")


@pytest.mark.parametrize("point", ["tool", "camera"])
def test_jacobians_agree_with_finite_differences(robot: RobotModel, point: str) -> None:
    rng = np.random.default_rng(2)
    pose = robot.forward if point == "tool" else robot.camera_pose
    step = 1e-6
    for q in rng.uniform(robot.lower, robot.upper, size=(10, robot.n)):
        J = robot.jacobian(q, point)
        assert J.shape == (6, robot.n)
        for joint in range(robot.n):
            ahead, behind = q.copy(), q.copy()
            ahead[joint] += step
            behind[joint] -= step
            Ta, Tb = pose(ahead), pose(behind)
            angular = pin.log3(Ta[:3, :3] @ Tb[:3, :3].T)
            numeric = np.concatenate([Ta[:3, 3] - Tb[:3, 3], angular]) / (2 * step)
            np.testing.assert_allclose(J[:, joint], numeric, atol=1e-7)


def test_revolute_joints_turn_the_tool_about_their_origins(robot: RobotModel) -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(robot.lower, robot.upper)
    origins, tool, J = robot.joint_origins(q), robot.forward(q)[:3, 3], robot.jacobian(q)
    for j in np.flatnonzero(robot.revolute):
        assert np.linalg.norm(J[3:, j]) == pytest.approx(1.0)
        np.testing.assert_allclose(J[:3, j], np.cross(J[3:, j], tool - origins[j]), atol=1e-12)


def test_the_camera_and_the_tool_sit_on_the_flange(robot: RobotModel) -> None:
    plain = RobotModel(describe(robot.description.model, base=robot.description.base), "r")
    q = robot.lower + 0.3
    x, y, z = CAMERA.pose.position_m
    flange = plain.forward(q)
    expected = flange[:3, :3] @ np.array([x, y, z]) + flange[:3, 3]
    np.testing.assert_allclose(robot.camera_pose(q)[:3, 3], expected, atol=1e-12)
    R = flange[:3, :3].T @ robot.camera_pose(q)[:3, :3]
    np.testing.assert_allclose(R, pin.rpy.rpyToMatrix(*np.radians([10, 20, 30])), atol=1e-12)
    tilt = np.radians(5)  # Rz(90) Rx(5) takes z to (sin 5, 0, cos 5)
    tool_z = flange[:3, :3].T @ robot.forward(q)[:3, 2]
    np.testing.assert_allclose(tool_z, [np.sin(tilt), 0, np.cos(tilt)], atol=1e-12)


def test_a_tool_pose_is_a_position_and_a_unit_quaternion(robot: RobotModel) -> None:
    rng = np.random.default_rng(4)
    for q in rng.uniform(robot.lower, robot.upper, size=(20, robot.n)):
        T, message = robot.forward(q), robot.tool_pose(q)
        w, x, y, z = message.quaternion_wxyz
        assert w >= 0
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).toRotationMatrix(), T[:3, :3], atol=1e-9)
        np.testing.assert_allclose(message.position, T[:3, 3])


def test_limits_are_read_only(robot: RobotModel) -> None:
    for vector in (robot.lower, robot.upper, robot.max_velocity, robot.max_acceleration, robot.home):
        assert vector.shape == (robot.n,)
        with pytest.raises(ValueError, match="read-only"):
            vector[0] = 1.0


@pytest.mark.parametrize("q", [np.zeros(5), np.zeros((1, 6)), 0.0, []])
def test_a_configuration_of_the_wrong_shape_is_refused_with_both_shapes(q: object) -> None:
    robot = RobotModel(describe("kr16"), "fr")
    with pytest.raises(RobotModelError, match=r"'fr': q must have shape \(6,\) for a1, .*, got shape \("):
        robot.forward(q)
    with pytest.raises(RobotModelError, match=r"q must have shape"):
        robot.jacobian(q)


def test_a_robot_without_camera_is_refused_with_a_reason() -> None:
    robot = RobotModel(describe("kr16"), "fr")
    with pytest.raises(RobotModelError, match=r"carries no camera; add one under robots\.fr\.camera"):
        robot.camera_pose(np.zeros(6))
    with pytest.raises(RobotModelError, match="must be one of tool, got 'elbow'"):
        robot.jacobian(np.zeros(6), "elbow")


def test_bodies_are_named_after_robot_and_link_in_the_order_of_the_joints() -> None:
    attachments = {"plate": Attachment(shape=BOX, link="link_3", pose=Pose(position_m=(0, 0.1, 0.2)))}
    robot = RobotModel(describe("kr16_gantry", tool=TOOL, attachments=attachments), "gr")
    names = [body.name for body in robot.geometry.geometryObjects]
    assert names[:2] == ["gr/portal_foot_1", "gr/portal_foot_2"]
    assert names[-3:] == ["gr/link_5", "gr/link_6", "gr/tool_cube"]
    assert names.index("gr/plate") == names.index("gr/link_3") + 1
    joints = [body.parentJoint for body in robot.geometry.geometryObjects]
    assert joints == sorted(joints)
    assert {body.name for body in robot.visual.geometryObjects} >= {"gr/plate", "gr/tool_cube"}


def test_pairs_that_touch_by_construction_are_never_checked() -> None:
    robot = RobotModel(describe("kr16", mounted_on=["floor"], tool=TOOL), "fr")
    never = robot.never_checked_pairs()
    assert {("fr/base", "fr/link_1"), ("fr/link_6", "fr/tool_cube"), ("fr/link_5", "fr/tool_cube")} <= never
    assert ("fr/base", "structure/floor") in never
    assert ("fr/link_1", "structure/floor") not in never
    assert ("fr/base", "fr/link_2") not in never
    assert ("fr/link_4", "fr/link_6") not in never


def test_the_portal_of_a_gantry_is_the_link_on_the_rails() -> None:
    never = RobotModel(describe("kr16_gantry", mounted_on=["rail"]), "gr").never_checked_pairs()
    with_rail = {a for a, b in never if b == "structure/rail"}
    assert with_rail == {
        f"gr/portal_{part}_{i}" for part, n in (("foot", 2), ("leg", 4), ("beam", 2)) for i in range(1, n + 1)
    }
    assert ("gr/base", "gr/column") in never  # fixed to one another
    assert ("gr/column", "gr/portal_beam_1") not in never


def test_any_other_arm_loads_from_urdf_text() -> None:
    robot = RobotModel(describe("kr16", joints=SCARA_JOINTS), "s", urdf=SCARA.format(kind="revolute"))
    assert robot.n == 2
    np.testing.assert_allclose(robot.forward([0.2, 0.0])[:3, 3], [0.5, 0, 0.2], atol=1e-12)
    assert [b.name for b in robot.geometry.geometryObjects] == ["s/stand", "s/slide_rail", "s/slide_2"]


def test_any_other_arm_loads_from_a_urdf_file_with_meshes_beside_it(tmp_path) -> None:
    obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "wedge.obj").write_text(obj)
    text = SCARA.format(kind="revolute").replace('<sphere radius="0.1"/>', '<mesh filename="wedge.obj"/>')
    (tmp_path / "scara.urdf").write_text(text)
    robot = RobotModel(describe(str(tmp_path / "scara.urdf"), joints=SCARA_JOINTS), "s")
    assert robot.geometry.geometryObjects[2].geometry.num_points == 4


def joints_without(*names: str) -> dict[str, object]:
    return {name: joint for name, joint in describe("kr16").joints.items() if name not in names}


@pytest.mark.parametrize(
    ("changes", "urdf", "message"),
    [
        ({"joints": joints_without("a6")}, None, "expected a1, a2, a3, a4, a5, a6; got a1, a2, a3, a4, a5"),
        ({"model": "kr61"}, None, "no robot model 'kr61'.*did you mean 'kr16'"),
        ({"model": "/nowhere/robot.urdf"}, None, "no robot model '/nowhere/robot.urdf'"),
        ({}, "<robot", "not a URDF model"),
        ({}, "no xml at all", "not a URDF model"),
        ({"joints": SCARA_JOINTS}, SCARA.format(kind="floating"), "'swing' is a .*only revolute"),
        ({"joints": SCARA_JOINTS | {"swing": SCARA_JOINTS["lift"]}}, SCARA.format(kind="revolute"), "given in m"),
        (
            {"attachments": {"box": {"shape": BOX, "link": "link_33"}}},
            None,
            "no link 'link_33'.*did you mean 'link_3'",
        ),
        (
            {"joints": SCARA_JOINTS},
            SCARA.format(kind="revolute").replace('<sphere radius="0.1"/>', '<mesh filename="package://gone/a.obj"/>'),
            "link 'slide': no file 'package://gone/a.obj': .* set ROS_PACKAGE_PATH",
        ),
        (
            {"joints": SCARA_JOINTS},
            re.sub("<collision.*?</collision>", "", SCARA.format(kind="revolute")),
            "no link has a collision body",
        ),
        ({"attachments": {"link_3": {"shape": BOX, "link": "link_3"}}}, None, "two bodies are named 'fr/link_3'"),
    ],
)  # fmt: skip
def test_a_description_that_does_not_fit_is_refused(
    changes: dict[str, object], urdf: str | None, message: str
) -> None:
    with pytest.raises(RobotModelError, match=message):
        RobotModel(describe(**({"model": "kr16"} | changes)), "fr", urdf=urdf)


def test_a_robot_with_one_of_its_tools_has_its_bodies_frame_and_mass() -> None:
    every = CellModel.load("lab-tools").robots["gr"]
    key, bare = every.with_tool("valve_key"), every.with_tool("")
    assert (every.with_tool("valve_key"), bare.with_tool("valve_key"), key.with_tool(None)) == (
        key,
        key,
        every,
    )
    q = every.home
    bodies = {name: {body.name for body in robot.geometry.geometryObjects} for name, robot in
              {"every": every, "key": key, "bare": bare}.items()}  # fmt: skip
    assert bodies["every"] - bodies["bare"] == frozenset().union(*every.tool_bodies.values())
    assert bodies["key"] - bodies["bare"] == every.tool_bodies["valve_key"]
    assert "gr/tool_tool_changer" in bodies["bare"]
    np.testing.assert_array_equal(key.forward(q), every.forward(q, "valve_key"))
    np.testing.assert_array_equal(bare.forward(q), every.forward(q))
    np.testing.assert_array_equal(every.with_tool("valve_key", frame="").forward(q), every.forward(q))
    masses = [sum(inertia.mass for inertia in robot.model.inertias) for robot in (bare, key)]
    assert masses[1] - masses[0] == pytest.approx(every.description.tools["valve_key"].mass_kg)
    named = {body.name for body in key.visual.geometryObjects if body.name.startswith("gr/")}
    assert not named & (bodies["every"] - bodies["key"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tool_changer": None}, "tools and tool_changer are given together; tool_changer is missing"),
        ({"tools": {}}, "tools and tool_changer are given together; tools is missing"),
        ({"tool_changer": {"release": "opens", "locked": "tool_locked"}}, "tool_changer.release is 'opens'"),
        ({"tools": {"camera": {}}}, "a tool cannot be named camera"),
        ({"driver": {"kind": "kinematic"}}, "tool_changer: for a robot on RSI"),
    ],
)
def test_a_tool_changer_that_cannot_be_is_an_error(change: dict[str, object], said: str) -> None:
    told = CellModel.load("lab-tools").description.robots["gr"].model_dump() | change
    with pytest.raises(ValidationError, match=re.escape(said)):
        RobotDescription.model_validate(told)
