"""A robot with files of its own: found, modelled, told to clients, and modelled by them without those files."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from own_robot import PACKAGE, write_cell, write_package

from deltaq_cell.cell_model import MOST_TOLD_BYTES, CellModel, LongDescriptionError, robots_told
from deltaq_cell.check import check_cell
from deltaq_cell.load import parse_cell
from deltaq_cell.models import RobotModelError
from deltaq_cell.proximity import ProximityEngine
from deltaq_protocol.codec import pack, to_line, unpack
from deltaq_protocol.messages import Description
from deltaq_services.sim.fingerprint import fingerprint


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    return write_package(tmp_path / "ws")


def test_a_robot_of_a_ros_package_is_found_and_its_cell_is_good(package: Path, tmp_path: Path) -> None:
    report = check_cell(write_cell(tmp_path))
    assert report.problems == ()
    arm = CellModel.load(tmp_path / "circle.yaml").robots["arm_0"]
    assert arm.joint_names == ("pan", "lift", "Reach")
    assert [len(corners) for corners in arm.hulls.values()] == [32, 32, 32]


def test_a_client_models_the_robot_without_its_files_and_measures_to_the_bit(
    package: Path, tmp_path: Path
) -> None:
    cell = CellModel.load(write_cell(tmp_path, robots=2))
    message = unpack(Description, pack(cell.description_message()), MOST_TOLD_BYTES)
    assert len(to_line(message)) < 64 * 1024
    shutil.rmtree(package)
    description = parse_cell(message.yaml)
    rebuilt = CellModel.of(description, robots_told(description, message.urdf, message.hulls), message.yaml)
    assert fingerprint(rebuilt) == fingerprint(cell)
    assert rebuilt.robots["arm_0"].visual is rebuilt.robots["arm_0"].geometry  # there is no paint here either
    random = np.random.default_rng(5)
    models = [ProximityEngine(cell), ProximityEngine(rebuilt)]
    for _ in range(50):
        distances = []
        drawn = {name: random.uniform(robot.lower, robot.upper) for name, robot in cell.robots.items()}
        for proximity in models:
            for name, q in drawn.items():
                proximity.place(name, q, np.full(3, 0.01))
            groups = [g for lists in (*proximity.alone.values(), *proximity.between.values()) for g in lists]
            distances.append([proximity.least(group).hex() for group in groups])
        assert distances[0] == distances[1]


def test_a_description_without_hulls_is_refused_where_the_meshes_are_not_found(
    package: Path, tmp_path: Path
) -> None:
    message = CellModel.load(write_cell(tmp_path)).description_message()
    description = parse_cell(message.yaml)
    robots_told(description, message.urdf, {})  # they are found here
    shutil.rmtree(package)
    with pytest.raises(
        RobotModelError, match=r"link 'pedestal': no file .*barrel.obj'.* set ROS_PACKAGE_PATH"
    ):
        robots_told(description, message.urdf, {})


def test_invalid_hulls_are_refused_by_name(package: Path, tmp_path: Path) -> None:
    message = CellModel.load(write_cell(tmp_path)).description_message()
    flat = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0))
    with pytest.raises(RobotModelError, match="body 'Fore': no convex hull of 4 points that lie in a plane"):
        robots_told(
            parse_cell(message.yaml), message.urdf, {"arm_0": message.hulls["arm_0"] | {"Fore": flat}}
        )


def test_a_description_that_no_message_holds_is_an_error_of_the_cell(package: Path, tmp_path: Path) -> None:
    urdf = (package / "arm.urdf").read_text()
    (package / "arm.urdf").write_text(urdf.replace("</robot>", f"<!-- {'x' * MOST_TOLD_BYTES} --></robot>"))
    (problem,) = check_cell(write_cell(tmp_path)).problems
    assert "the longest part is the URDF of arm_0" in problem.message
    assert problem.bound == MOST_TOLD_BYTES
    with pytest.raises(LongDescriptionError):
        CellModel.load(tmp_path / "circle.yaml").description_message()


def test_a_flat_mesh_is_an_error_that_names_the_link(package: Path, tmp_path: Path) -> None:
    (package / "meshes" / "barrel.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    (problem,) = check_cell(write_cell(tmp_path)).problems
    assert "link 'pedestal', body 'pedestal': no convex hull of" in problem.message


def test_a_continuous_joint_takes_the_limits_of_the_cell(package: Path, tmp_path: Path) -> None:
    arm = CellModel.load(write_cell(tmp_path)).robots["arm_0"]
    np.testing.assert_allclose(np.rad2deg([arm.lower[0], arm.upper[0]]), [-170, 170])
    turned = arm.forward([np.pi / 2, 1.0, 0.2])[:3, 3] - arm.T_world_base[:3, 3]
    straight = arm.forward([0.0, 1.0, 0.2])[:3, 3] - arm.T_world_base[:3, 3]
    np.testing.assert_allclose([turned[0], turned[1]], [-straight[1], straight[0]], atol=1e-12)


def test_a_locked_joint_and_the_one_that_mimics_it_stay_where_they_are(package: Path, tmp_path: Path) -> None:
    arm = CellModel.load(write_cell(tmp_path)).robots["arm_0"]
    model = arm.model
    probe, left, right = (
        model.frames[model.getFrameId(name)].placement for name in ("probe", "left", "right")
    )
    np.testing.assert_allclose((probe.inverse() * left).translation, [0, 0.02, 0], atol=1e-12)
    np.testing.assert_allclose((probe.inverse() * right).translation, [0, -0.02, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("locks", "field", "message"),
    [
        ("{jaw: 0.02, lifft: 0}", "locked_joints.lifft", "no joint 'lifft' .*did you mean 'lift'"),
        ("{jaw: 0.05}", "locked_joints.jaw", "cannot be locked at 0.05: it goes from 0 to 0.04"),
        ("{jaw: 0.02, pan: 0}", "joints", "expected lift, Reach; got pan, lift, Reach"),
        ("{}", "joints", "expected pan, lift, Reach, jaw, other_jaw; got pan, lift, Reach"),
    ],
)
def test_a_joint_that_cannot_be_locked_is_reported_with_its_line(
    package: Path, tmp_path: Path, locks: str, field: str, message: str
) -> None:
    file = write_cell(tmp_path)
    file.write_text(file.read_text().replace("{jaw: 0.02}", locks))
    (problem,) = check_cell(file).problems
    assert problem.field == f"robots.arm_0.{field}"
    assert problem.line > 0
    with pytest.raises(RobotModelError, match=message):
        CellModel.load(file)


def test_a_mimicking_joint_may_be_driven_as_a_joint_of_its_own(package: Path, tmp_path: Path) -> None:
    file = write_cell(tmp_path)
    jaws = "".join(
        f"\n      {name}: {{home_m: 0.01, lower_m: 0, upper_m: 0.04, max_velocity_m_s: 0.1, max_acceleration_m_s2: 1}}"
        for name in ("jaw", "other_jaw")
    )
    text = file.read_text().rstrip().replace("    locked_joints: {jaw: 0.02}\n", "") + jaws
    file.write_text(text)
    arm = CellModel.load(file).robots["arm_0"]
    assert arm.joint_names == ("pan", "lift", "Reach", "jaw", "other_jaw")
    assert check_cell(file).ok


def test_a_model_beside_the_cell_file_resolves_its_own_package(tmp_path: Path) -> None:
    write_package(tmp_path)
    cell = CellModel.load(write_cell(tmp_path, model=f"{PACKAGE}/arm.urdf"))
    assert len(cell.robots["arm_0"].hulls) == 3
