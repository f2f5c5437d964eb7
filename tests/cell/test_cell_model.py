"""What is made of a whole cell: its identity, the roles of its robots, and the kinematics that clients are told."""

from pathlib import Path

import numpy as np
import pytest
from urdf_kinematics import UrdfKinematics

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell
from deltaq_cell.identity import cell_identity, content_identity
from deltaq_cell.load import load_cell
from deltaq_cell.roles import CameraRoles, RoleError, camera_roles, first_camera
from deltaq_protocol.codec import from_map, line_to_map, to_line
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import Description, RobotKinematics

LAB = content_identity(load_cell("lab"))


def _changed(folder: Path, changes: str) -> CellIdentity:
    file = folder / "changed.yaml"
    file.write_text(f"extends: lab\n{changes}", encoding="utf-8")
    return content_identity(load_cell(file))


@pytest.mark.parametrize(
    "changes",
    [
        "cycle_s: 0.004",
        "gate: {stop_distance_m: 0.051}",
        "gate: {max_request_age_s: 0.1}",
        "robots: {fr: {joints: {a1: {upper_deg: 154.0}}}}",
        "robots: {fr: {base: {position_m: [0.0, 0.0, 0.001]}}}",
        "robots: {fr: {driver: {max_correction_deg: 5.0}}}",
        "structure: {post: {shape: {kind: sphere, radius_m: 0.1}, pose: {position_m: [9, 9, 9]}}}",
        "cell: lab-of-another-name",
    ],
)
def test_every_change_of_meaning_changes_the_hash(tmp_path: Path, changes: str) -> None:
    assert not LAB.is_same(_changed(tmp_path, changes))


@pytest.mark.parametrize(
    "changes",
    [
        "# a comment",
        "hli: tcp/127.0.0.1:9999\nsim: tcp/127.0.0.1:9998\ntcp_port: 9997",
        "robots: {fr: {server: tcp/127.0.0.1:9996, driver: {port: 9995, control_port: 9994}}}",
        f"cycle_s: {load_cell('lab').cycle_s!r}0",
        "equipment: {gauge_1: null, gauge_3: {kind: gauge, bodies: [pipe_1]}}",
        "robots: {fr: {camera: {source: test, source_right: plant.mp4}}}",
    ],
)
def test_addresses_formatting_and_equipment_do_not_change_the_hash(tmp_path: Path, changes: str) -> None:
    assert LAB.is_same(_changed(tmp_path, changes))


def test_a_copy_of_the_file_is_the_same_cell(tmp_path: Path) -> None:
    copy = tmp_path / "copy.yaml"
    text = find_cell("lab").read_text(encoding="utf-8")
    copy.write_text("# written anew\n\n" + text, encoding="utf-8")
    assert LAB.is_same(content_identity(load_cell(copy)))


def test_the_hash_covers_the_geometry_of_bodies_and_not_their_file_names() -> None:
    cell = CellModel.load("lab")
    urdf = {name: robot.urdf for name, robot in cell.robots.items()}
    hulls = {name: robot.hulls for name, robot in cell.robots.items()}
    assert cell_identity(cell.description, urdf, hulls) == cell.identity
    assert not cell.identity.is_same(cell_identity(cell.description, urdf | {"fr": urdf["gr"]}, hulls))
    name = next(name for name in hulls if hulls[name])
    body, corners = next(iter(hulls[name].items()))
    dented = hulls | {name: {**hulls[name], body: corners[1:]}}
    assert not cell.identity.is_same(cell_identity(cell.description, urdf, dented))
    assert cell.identity.is_same(LAB), "who has read no bodies compares the rest"


def test_an_identity_survives_a_round_trip_through_text_and_unknown_text_gives_none() -> None:
    for identity in (LAB, CellModel.load("dawm").identity):
        assert CellIdentity.parse(str(identity)) == identity
    for text in ("", "lab", "lab ", " ", "-", "lab 0-1", "\0"):
        assert not LAB.is_same(CellIdentity.parse(text))


def test_a_mismatch_names_both_cells_and_both_hashes() -> None:
    other = content_identity(load_cell("lab-4ms"))
    assert mismatch("sim", other, LAB) == (
        f"sim has read cell lab-4ms {other.content}, and here it is lab {LAB.content}"
    )
    assert mismatch("sim", CellIdentity.parse(""), LAB).startswith(
        "sim has read cell one of a version without a hash"
    )


def cell_of(**has_camera: bool) -> CellDescription:
    """The lab's robots by other names, with a camera or without."""
    lab = load_cell("lab")
    robots = {
        name: lab.robots["fr"].model_copy(update={"camera": lab.robots["fr"].camera if camera else None})
        for name, camera in has_camera.items()
    }
    return lab.model_copy(update={"robots": robots})


@pytest.mark.parametrize(
    ("cameras", "follower", "leader", "roles"),
    [
        ({"fr": True, "gr": False}, None, None, CameraRoles("fr", "gr")),
        ({"arm": False, "eye": True}, None, None, CameraRoles("eye", "arm")),
        ({"east": True, "west": True, "gr": False}, None, None, CameraRoles("east", "gr")),
        ({"east": True, "west": True, "gr": False}, "west", None, CameraRoles("west", "gr")),
        ({"east": True, "west": True, "gr": False}, None, "east", CameraRoles("west", "east")),
        ({"east": True, "west": True}, None, None, CameraRoles("east", "west")),
        ({"east": True, "west": True, "gr": False}, "east", "west", CameraRoles("east", "west")),
    ],
)
def test_the_first_camera_watches_the_first_other_robot_by_default(
    cameras: dict[str, bool], follower: str | None, leader: str | None, roles: CameraRoles
) -> None:
    assert camera_roles(cell_of(**cameras), follower, leader) == roles


@pytest.mark.parametrize(
    ("cameras", "follower", "leader", "said"),
    [
        ({"fr": True, "gr": False}, "ghost", None, "follower: the cell has no robot 'ghost'; it has fr, gr"),
        ({"fr": True, "gr": False}, None, "ghost", "leader: the cell has no robot 'ghost'; it has fr, gr"),
        ({"fr": True, "gr": False}, "gr", None, "robot 'gr' has no camera to follow with; fr has one"),
        ({"fr": True, "gr": False}, "fr", "fr", "leader 'fr' is the follower itself; it can follow gr"),
        ({"fr": True, "gr": False}, None, "fr", "leader 'fr' is the follower itself"),
        ({"fr": True}, None, None, "there is no robot to follow"),
        ({"fr": False, "gr": False}, None, None, "no robot of cell lab carries a camera"),
    ],
)
def test_a_robot_unfit_for_its_role_is_refused(
    cameras: dict[str, bool], follower: str | None, leader: str | None, said: str
) -> None:
    with pytest.raises(RoleError, match=said):
        camera_roles(cell_of(**cameras), follower, leader)


def test_the_first_camera_is_that_of_the_first_robot_that_has_one() -> None:
    assert first_camera(cell_of(gr=False, west=True, east=True)) == "west"


def placed(told: RobotKinematics, units: tuple[str, ...], frame: str, q: np.ndarray) -> np.ndarray:
    """A frame's pose as a client would place it, by the words of the messages alone."""
    poses: list[np.ndarray] = []
    for joint, unit, value in zip(told.joints, units, q, strict=True):
        motion, axis = np.eye(4), np.array(joint.axis)
        if unit == "rad":
            x, y, z = axis
            across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            motion[:3, :3] += np.sin(value) * across + (1 - np.cos(value)) * across @ across
        else:
            motion[:3, 3] = value * axis
        before = poses[joint.parent] if joint.parent >= 0 else np.eye(4)
        poses.append(before @ np.array(joint.T_parent_joint) @ motion)
    carried = told.frames[frame]
    return (poses[carried.joint] if carried.joint >= 0 else np.eye(4)) @ np.array(carried.T_joint_frame)


@pytest.mark.parametrize("cell", ["lab", "dawm"])
def test_a_client_that_reads_neither_yaml_nor_urdf_places_every_frame(cell: str) -> None:
    model = CellModel.load(cell)
    heard = from_map(Description, line_to_map(to_line(model.description_message())))
    for name, robot in model.robots.items():
        told, rng = heard.kinematics[name], np.random.default_rng(1)
        camera = () if robot.description.camera is None else ("camera",)
        assert set(told.frames) == {"tool", *robot.hands, *camera}
        for q in rng.uniform(robot.lower, robot.upper, (5, robot.n)):
            for frame in (*robot.hands, "tool"):
                T_world_frame = placed(told, heard.robots[name].units, frame, q)
                np.testing.assert_allclose(T_world_frame, robot.forward(q, frame), atol=1e-12)
            for frame in camera:
                T_world_frame = placed(told, heard.robots[name].units, frame, q)
                np.testing.assert_allclose(T_world_frame, robot.camera_pose(q), atol=1e-12)


def test_the_urdf_places_every_frame_alike() -> None:
    model = CellModel.load("lab")
    for robot in model.robots.values():
        description = robot.description
        by_hand = UrdfKinematics(description, robot.urdf)
        for q in np.random.default_rng(2).uniform(robot.lower, robot.upper, (5, robot.n)):
            np.testing.assert_allclose(by_hand.at(q, description.tool.frame), robot.forward(q), atol=1e-9)
            if description.camera is not None:
                pose = by_hand.at(q, description.camera.pose)
                np.testing.assert_allclose(pose, robot.camera_pose(q), atol=1e-9)
