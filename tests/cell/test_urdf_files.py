"""A URDF from anywhere is read as its simulator reads it, or refused with a line that names the fault."""

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.check import check_cell
from deltaq_cell.description import RobotDescription
from deltaq_cell.models import RobotModelError, load_urdf
from deltaq_cell.robot import RobotModel
from deltaq_cell.robot_bodies import check_rotations, extent
from deltaq_cell.urdf_parsing import parse_model
from deltaq_protocol.messages import Outcome
from deltaq_testing.virtual_cell.cell import VirtualCell

BOX = '<box size="0.1 0.2 0.3"/>'


def link(name: str, shape: str = BOX) -> str:
    body = f'<collision><origin xyz="0 0 0.2"/><geometry>{shape}</geometry></collision>'
    return f'<link name="{name}">{body}</link>'


def joint(name: str, parent: str, child: str, axis: str = '<axis xyz="0 1 0"/>', more: str = "") -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.45"/>{axis}<limit lower="-2.6" upper="2.6" velocity="1" effort="1"/>{more}</joint>'
    )


def arm(links: int = 5, shape: str = BOX) -> str:
    """A chain of bodies, each 0.15 m from the next, turned by joints `j1`, `j2`, ..."""
    parts = [link(f"l{n}", shape) for n in range(links)]
    parts += [joint(f"j{n}", f"l{n - 1}", f"l{n}") for n in range(1, links)]
    return f'<robot name="arm">{"".join(parts)}</robot>'


def cell(folder: Path, urdf: str | bytes, joints: tuple[str, ...], more: str = "") -> Path:
    data = urdf if isinstance(urdf, bytes) else urdf.encode()
    (folder / "arm.urdf").write_bytes(data)
    limits = (
        "home_deg: 0, lower_deg: -145, upper_deg: 145, max_velocity_deg_s: 50, max_acceleration_rad_s2: 4"
    )
    lines = [f"      {name}: {{{limits}, tracking_tolerance_deg: 0.5}}" for name in joints]
    text = """cell: arm
cycle_s: 0.012
gate: {stop_distance_m: 0.05, self_stop_distance_m: 0.01, servo_lag_s: 0.012}
structure: {wall: {shape: {kind: box, size_m: [0.1, 1, 1]}, pose: {position_m: [0.35, 0, 0.5]}}}
robots:
  r:
    model: arm.urdf
    server: tcp/127.0.0.1:17451
    driver: {kind: kinematic}
    joints:
""" + "\n".join(lines)
    file = folder / "arm.yaml"
    file.write_text(f"{text}\n{more}")
    return file


def told(
    folder: Path, urdf: str | bytes, joints: tuple[str, ...] = ("j1", "j2", "j3", "j4"), more: str = ""
) -> str:
    """The only problem of a cell."""
    (problem,) = check_cell(cell(folder, urdf, joints, more)).problems
    return problem.message


def mimicking(text: str, mimics: dict[str, str]) -> str:
    """The text with a mimic, by the attributes given, in each of some joints."""
    for name, attributes in mimics.items():
        start = f'<joint name="{name}" type="revolute">'
        text = text.replace(start, f"{start}<mimic {attributes}/>")
    return text


def names(file: Path) -> list[str]:
    return [body.name for body in CellModel.load(file).robots["r"].geometry.geometryObjects]


COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}<up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g" name="g"><mesh>
<source id="p"><float_array id="pa" count="24">{corners}</float_array><technique_common><accessor source="#pa" count="8"
 stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source><vertices id="vv"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#vv" offset="0"/>
<p>0 1 3 0 3 2 4 6 7 4 7 5 0 4 5 0 5 1 2 3 7 2 7 6 0 2 6 0 6 4 1 5 7 1 7 3</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def corners(scale: float) -> str:
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return " ".join(
        f"{scale * a * b:.6g}" for point in signs for a, b in zip(point, (0.05, 0.1, 0.15), strict=True)
    )


def collada(unit: str, scale: float) -> str:
    return COLLADA.format(unit=unit, corners=corners(scale))


# bad cases first


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', r"joint 'j1': its axis '0 0 0' has no direction"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1e-200 0"/>', "axis '0 1e-200 0' has no direction"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="1e300 1e300 0"/>', "has no direction"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="nan 1 0"/>', "has no direction"),
        ('<axis xyz="0 1 0"/>', "<axis/>", "joint 'j1': xyz of <axis> is missing; it must be 3 numbers"),
        (BOX, '<box size="-0.1 0.2 0.3"/>', "link 'l0', collision 1: size of its box is -0.1; it must be more than 0"),
        (BOX, '<box size="0.1 0.2"/>', "size of <box> is '0.1 0.2'; it must be 3 numbers"),
        (BOX, '<sphere radius="-0.15"/>', "radius of its sphere is -0.15"),
        (BOX, '<sphere radius="nan"/>', "radius of its sphere is nan"),
        (BOX, '<sphere radius="1e300"/>', r"its sphere is 1e\+300; it must be more than 0 and at most 1000 m"),
        (BOX, '<cylinder radius="0.1" length="0"/>', "length of its cylinder is 0"),
        (BOX, '<cylinder radius="-0.1" length="1"/>', "radius of its cylinder is -0.1"),
        (BOX, '<capsule radius="0.1" length="inf"/>', "length of its capsule is inf"),
        (BOX, '<mesh filename="m.dae" scale="1 0 1"/>', "its mesh's scale is '1 0 1'"),
        (BOX, '<mesh filename="m.dae" scale="1 1 1 1"/>', "scale of <mesh> is '1 1 1 1'; it must be 3 numbers"),
        ('xyz="0 0 0.2"', 'xyz="0 0 inf"', "link 'l0', collision 1: xyz of its origin has inf"),
        ('xyz="0 0 0.2"', 'xyz="0 0 1e9"', r"xyz of its origin has 1e\+09; at most 1000 m"),
        ('xyz="0 0 0.45"', 'xyz="0 0 0.45" rpy="nan 0 0"', "joint 'j1': rpy of its origin has nan"),
        ('lower="-2.6"', 'lower="nan"', "joint 'j1': its limit lower is not a number"),
    ],
)  # fmt: skip
def test_an_impossible_number_is_refused_by_name(tmp_path: Path, was: str, now: str, message: str) -> None:
    with pytest.raises(RobotModelError, match=message):
        CellModel.load(cell(tmp_path, arm().replace(was, now, 1), ("j1", "j2", "j3", "j4")))


def test_meshes_in_millimetres_without_a_unit_are_an_error_that_names_body_and_size(tmp_path: Path) -> None:
    (tmp_path / "m.dae").write_text(collada("", 1000))
    assert "body 'r/l0' is 300 m long, on a robot that reaches 1.8 m" in told(
        tmp_path, arm(shape='<mesh filename="m.dae"/>')
    )


def test_a_robot_of_which_most_pairs_always_touch_is_an_error(tmp_path: Path) -> None:
    message = told(tmp_path, arm(shape='<box size="2 2 2"/>'))
    assert "6 of 6 pairs of bodies touch wherever the joints are" in message
    named = "    never_checked: [[l0, l2], [l0, l3], [l0, l4], [l1, l3]]\n"
    file = cell(tmp_path, arm(shape='<box size="2 2 2"/>'), ("j1", "j2", "j3", "j4"), named)
    assert len(CellModel.load(file).robots["r"].never_checked) == 10


def test_meshes_far_smaller_than_the_robot_are_an_error(tmp_path: Path) -> None:
    (tmp_path / "m.dae").write_text(collada('<unit meter="0.001"/>', 1))
    message = told(tmp_path, arm(shape='<mesh filename="m.dae"/>'))
    assert "body 'r/l0' is 0.0003 m long, on a robot that reaches 1.8 m" in message
    message = told(
        tmp_path, arm(shape='<mesh filename="m.dae"/>').replace('<mesh filename="m.dae"/>', BOX, 3)
    )
    assert "body 'r/l3' is 0.0003 m long" in message


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "a metre"])
def test_a_mesh_with_an_invalid_unit_is_refused(tmp_path: Path, unit: str) -> None:
    (tmp_path / "m.dae").write_text(collada(f'<unit meter="{unit}"/>', 1))
    assert "m.dae cannot be read" in told(tmp_path, arm(shape='<mesh filename="m.dae"/>'))


def test_mesh_indices_that_hang_assimp_are_refused(tmp_path: Path) -> None:
    (tmp_path / "m.dae").write_text(collada("", 1).replace("7 6 0 2", "7 inf 0 2"))
    assert "m.dae cannot be read: <p> contains a value that is no index" in told(
        tmp_path, arm(shape='<mesh filename="m.dae"/>')
    )


@pytest.mark.parametrize("by", [np.diag([0.9, 0.9, 0.9]), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)])
def test_a_placement_with_an_invalid_rotation_is_refused_by_name(by: np.ndarray) -> None:
    model = pin.buildModelFromXML(arm(3))
    check_rotations(model, [], [np.zeros(2)], "arm.urdf")
    model.jointPlacements[2] = pin.SE3(by, np.zeros(3))
    with pytest.raises(RobotModelError, match="joint 'j2' has a placement that is not a rotation"):
        check_rotations(model, [], [np.zeros(2)], "arm.urdf")


def test_a_body_silently_dropped_by_urdfdom_is_an_error(tmp_path: Path) -> None:
    text = arm().replace('<link name="l2">', '<link name="l2"><inertial><mass value="1"/></inertial>')
    assert "link 'l2': 0 of its 1 collision bodies can be read" in told(tmp_path, text)


def test_endless_nesting_of_a_urdf_is_refused_in_one_line(tmp_path: Path) -> None:
    message = told(tmp_path, "<robot>" + "<a>" * 50_000 + "</a>" * 50_000 + "</robot>")
    assert message.endswith("line 1: more than 100 elements within one another")


@pytest.mark.parametrize(
    ("mimics", "message"),
    [
        ({"j3": "j4", "j4": "j3"}, "joint 'j3' mimics itself indirectly"),
        ({"j3": "j3"}, "joint 'j3' mimics itself"),
        ({"j3": "gone"}, "joint 'j3' mimics 'gone', which is not a joint"),
    ],
)
def test_a_mimic_that_follows_nothing_is_refused(
    tmp_path: Path, mimics: dict[str, str], message: str
) -> None:
    given = {name: f'joint="{followed}"' for name, followed in mimics.items()}
    assert message in told(tmp_path, mimicking(arm(), given))


def test_another_document_than_a_robot_is_refused(tmp_path: Path) -> None:
    assert "the outermost element is <sdf>, must be <robot>" in told(tmp_path, "<sdf/>")
    assert "its encoding 'klingon' is unknown" in told(
        tmp_path, b'<?xml version="1.0" encoding="klingon"?><robot/>'
    )
    assert "not utf-8 text" in told(tmp_path, b'<robot name="\xfc"/>')


def test_a_robot_without_joints_is_refused(tmp_path: Path) -> None:
    file = cell(tmp_path, arm(), ())
    file.write_text(file.read_text().replace("    joints:\n", "    joints: {}\n"))
    (problem,) = check_cell(file).problems
    assert problem.field == "robots.r.joints"


# what public files have


@pytest.mark.parametrize(("unit", "scale"), [("0.001", 1000), ("0.0254", 1 / 0.0254), ("1", 1)])
def test_the_unit_of_a_collada_mesh_is_applied(tmp_path: Path, unit: str, scale: float) -> None:
    (tmp_path / "m.DAE").write_text(collada(f'<unit name="x" meter="{unit}"/>', 2 * scale))
    shape = '<mesh filename="m.DAE" scale="0.5 -0.5 0.5"/>'
    (body, *_) = (
        CellModel.load(cell(tmp_path, arm(shape=shape), ("j1", "j2", "j3", "j4")))
        .robots["r"]
        .geometry.geometryObjects
    )
    box = body.geometry.aabb_local
    np.testing.assert_allclose([box.min_, box.max_], [[-0.05, -0.1, -0.15], [0.05, 0.1, 0.15]], atol=1e-6)
    assert extent(body) == pytest.approx(0.3, abs=1e-6)


def test_an_axis_lengthened_by_rounding_is_normalised(tmp_path: Path) -> None:
    text = arm().replace('xyz="0 1 0"', 'xyz="0 1.0003 0"', 1).replace('xyz="0 1 0"', 'xyz="0 70 0"', 1)
    robot = CellModel.load(cell(tmp_path, text, ("j1", "j2", "j3", "j4"))).robots["r"]
    np.testing.assert_allclose(
        robot.jacobian(robot.home + 0.5)[3:].T, np.tile([0.0, 1.0, 0.0], (4, 1)), atol=1e-12
    )


def test_bodies_whose_names_clash_get_numbers(tmp_path: Path) -> None:
    two = link("l1").replace("</link>", f"<collision><geometry>{BOX}</geometry></collision></link>")
    joints = joint("j1", "l0", "l1") + joint("j2", "l1", "l1_1")
    text = f'<robot name="t">{link("l0")}{two}{link("l1_1")}{joints}</robot>'
    assert names(cell(tmp_path, text, ("j1", "j2"))) == ["r/l0", "r/l1_1_2", "r/l1_2", "r/l1_1"]
    alike = text.replace("<collision>", '<collision name="l1">')
    assert names(cell(tmp_path, alike, ("j1", "j2"))) == ["r/l0", "r/l1_l1", "r/l1_l1_2", "r/l1_1"]


def test_names_are_read_verbatim_and_unknown_extensions_are_ignored(tmp_path: Path) -> None:
    extension = (
        '<gazebo><link name="l1"/><sensor:camera/></gazebo><xacro:link name="l9"/>'
        '<transmission><joint name="j1"/></transmission>'
    )
    text = (
        arm()
        .replace('name="arm"', 'name="arm" xmlns="http://example.org/urdf"')
        .replace("</robot>", f"{extension}</robot>")
    )
    file = cell(
        tmp_path, text.replace('<link name="l2"', '<link xmlns="" name="l2"'), ("j1", "j2", "j3", "j4")
    )
    assert names(file) == [f"r/l{n}" for n in range(5)]


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "windows-1252", "UTF-16", "utf-8-sig"])
def test_a_urdf_is_read_in_its_declared_encoding(tmp_path: Path, encoding: str) -> None:
    declared = "" if encoding == "utf-8-sig" else f' encoding="{encoding}"'
    text = f'<?xml version="1.0"{declared}?>' + arm(3).replace("l1", "längs")
    robot = CellModel.load(cell(tmp_path, text.encode(encoding), ("j1", "j2"))).robots["r"]
    assert robot.geometry.geometryObjects[1].name == "r/längs"
    assert robot.urdf.startswith('<?xml version="1.0"?>')  # it is told to clients as UTF-8


def test_a_robot_of_one_joint_is_guarded(tmp_path: Path) -> None:
    file = cell(tmp_path, arm(2), ("j1",))
    assert check_cell(file).errors == ()
    virtual = VirtualCell(file)
    virtual.run_until_ready()
    virtual.acquire("r", "test")
    outcomes = []
    for _ in range(250):
        virtual.cycle()
        verdict = virtual.ask("r", np.array([0.009]))
        outcomes.append(verdict.outcome if verdict is not None else None)
    assert outcomes[:3] == [Outcome.SCALED] * 3  # until it is up to speed
    assert Outcome.ADMITTED in outcomes
    assert outcomes[-1] is Outcome.HELD  # at the wall
    assert 0.5 < virtual.arms["r"].q[0] < 2.0


def test_chained_mimics_of_a_locked_joint_stay_fixed(tmp_path: Path) -> None:
    mimics = {"j3": 'joint="j2" multiplier="-2" offset="0.1"', "j4": 'joint="j3" multiplier="0.5"'}
    text = mimicking(arm(), mimics)
    robot = CellModel.load(cell(tmp_path, text, ("j1",), "    locked_joints: {j2: 0.3}\n")).robots["r"]
    last = robot.geometry.geometryObjects[-1]
    angle = 0.3 - 0.5 - 0.25  # of j2, j3 and j4 together
    np.testing.assert_allclose(last.placement.rotation[0, 2], np.sin(angle), atol=1e-12)


def test_joints_have_the_documented_order(tmp_path: Path) -> None:
    links = "".join(link(name) for name in ("r", "x", "y", "z"))
    joints = joint("b", "r", "x") + joint("a", "x", "y") + joint("B", "r", "z")
    text = f'<robot name="t">{links}{joints}</robot>'
    assert "expected B, b, a; got" in told(tmp_path, text, ("b", "a", "B"))


def test_a_file_uri_may_have_escapes(tmp_path: Path) -> None:
    (tmp_path / "two words").mkdir()
    (tmp_path / "two words" / "m.dae").write_text(collada("", 1))
    uri = (tmp_path / "two words" / "m.dae").as_uri()
    assert "%20" in uri
    file = cell(tmp_path, arm(shape=f'<mesh filename="{uri}"/>'), ("j1", "j2", "j3", "j4"))
    assert check_cell(file).errors == ()


PUBLIC = sorted(
    file
    for place in sys.path
    for file in (Path(place) / "cmeel.prefix" / "share" / "example-robot-data" / "robots").rglob("*.urdf")
)

REFUSED = {
    "TwoDofs", "alex_psyonic_hands", "alexander_v1.lowerBodyOnly", "human", "iris_simple", "quadrotor_base",
    "simple_humanoid_classical", "talos_full_v2", "talos_full_v2_box", "ur3",
}  # fmt: skip
"""Without bodies, joints or meshes, or with a mimic of no joint."""


def described(urdf: Path) -> RobotDescription:
    """A robot with all joints of a URDF, and its limits, at most a turn."""
    model = parse_model(load_urdf(urdf), {})
    joints = {}
    if not model.nq:
        raise RobotModelError("it has no joints")
    for index, joint in enumerate(list(model.joints)[1:]):
        if joint.nq != 1:
            raise RobotModelError("a joint is neither revolute nor prismatic")
        unit, factor = ("deg", np.rad2deg(1.0)) if joint.shortname().startswith("JointModelR") else ("m", 1.0)
        lower, upper = (
            max(model.lowerPositionLimit[index], -np.pi),
            min(model.upperPositionLimit[index], np.pi),
        )
        joints[model.names[index + 1]] = {
            f"home_{unit}": (lower + upper) / 2 * factor, f"lower_{unit}": lower * factor,
            f"upper_{unit}": max(upper, lower + 1e-6) * factor, f"max_velocity_{unit}_s": 1,
            "max_acceleration_rad_s2" if unit == "deg" else "max_acceleration_m_s2": 1,
        }  # fmt: skip
    driver = {"kind": "kinematic"}
    return RobotDescription.model_validate(
        {"model": str(urdf), "server": "tcp/127.0.0.1:17451", "driver": driver, "joints": joints}
    )


def box_around(shape: Any, place: pin.SE3) -> np.ndarray:
    """(2, 3) corners of the box around a placed shape, axes of the world [m]."""
    if isinstance(shape, coal.Convex) or hasattr(shape, "vertices"):
        points = (
            [shape.point(k) for k in range(shape.num_points)]
            if isinstance(shape, coal.Convex)
            else shape.vertices()
        )
        placed = np.array(points) @ place.rotation.T + place.translation
        return np.array([placed.min(axis=0), placed.max(axis=0)])
    z = np.abs(place.rotation[:, 2])
    if isinstance(shape, coal.Box):
        half = np.abs(place.rotation) @ shape.halfSide
    elif isinstance(shape, coal.Cylinder):
        half = z * shape.halfLength + shape.radius * np.sqrt(np.maximum(0.0, 1.0 - z**2))
    else:
        half = z * getattr(shape, "halfLength", 0.0) + shape.radius
    return np.array([place.translation - half, place.translation + half])


def boxes(model: pin.Model, geometry: pin.GeometryModel, q: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """By joint and place among its bodies the box around each, axes of the world: (2, 3) corners [m]."""
    data, placed = model.createData(), pin.GeometryData(geometry)
    pin.updateGeometryPlacements(model, data, geometry, placed, q)
    found = {}
    count: Counter[int] = Counter()
    for body, place in zip(geometry.geometryObjects, placed.oMg, strict=True):
        joint = int(body.parentJoint)
        found[joint, count[joint]] = box_around(body.geometry, place)
        count[joint] += 1
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("urdf", PUBLIC, ids=lambda file: file.stem)
def test_a_public_urdf_agrees_with_pinocchio_or_is_refused_in_one_line(urdf: Path) -> None:
    try:
        robot = RobotModel(described(urdf), "r")
        assert robot.never_checked is not None
    except RobotModelError:
        assert urdf.stem in REFUSED
        return
    model = pin.buildModelFromUrdf(str(urdf))
    folders = [str(folder) for folder in urdf.parents]
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
    random = np.random.default_rng(0)
    for _ in range(3):
        q = random.uniform(robot.lower, robot.upper)
        theirs = pin.neutral(model)
        for joint, angle in zip(list(model.joints)[1:], q, strict=True):
            # a continuous joint is given by cosine and sine
            theirs[joint.idx_q : joint.idx_q + joint.nq] = (
                angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
            )
        ours = boxes(robot.model, robot.geometry, q)
        for key, box in boxes(model, geometry, theirs).items():
            beyond = np.array([box[0] - ours[key][0], ours[key][1] - box[1]])
            assert beyond.min() > -1e-6, key  # nothing of it sticks out
            assert beyond.max() < 0.25 * np.ptp(box, axis=0).max() + 1e-6, key  # a hull has 32 corners
