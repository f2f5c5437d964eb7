"""Files that a model names are found where ROS and Python keep them, or the error says what to set."""

import sys
from pathlib import Path

import pytest

from deltaq_cell.find import find_file
from deltaq_cell.models import RobotModelError, load_urdf


def put(*parts: str | Path) -> Path:
    file = Path(*parts)
    file.parent.mkdir(parents=True)
    file.write_text("solid")
    return file


def test_a_package_above_the_model_is_found(tmp_path: Path) -> None:
    mesh = put(tmp_path, "arm_description", "meshes", "link.stl")
    folder = tmp_path / "arm_description" / "urdf"
    assert find_file("package://arm_description/meshes/link.stl", folder) == mesh
    assert find_file("model://arm_description/meshes/link.stl", folder) == mesh


@pytest.mark.parametrize("entry", ["ws", "ws/arm_description"])
def test_ros_package_path_names_the_folder_above_the_package_or_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    mesh = put(tmp_path, "ws", "arm_description", "meshes", "link.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / entry}")
    assert find_file("package://arm_description/meshes/link.stl") == mesh


def test_ament_prefix_path_names_the_prefix_of_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = put(tmp_path, "install", "share", "arm_description", "meshes", "link.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert find_file("package://arm_description/meshes/link.stl") == mesh


def test_python_packages_that_ship_models_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = put(tmp_path, "site", "cmeel.prefix", "share", "example-arms", "robots", "link.stl")
    module = put(tmp_path, "site", "arm_models", "link.stl")
    (tmp_path / "site" / "arm_models" / "__init__.py").write_text("raise RuntimeError('not to be run')")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "site")])
    assert find_file("package://example-arms/robots/link.stl") == wheel
    assert find_file("package://arm_models/link.stl") == module


def test_a_name_without_a_scheme_is_relative_to_the_model(tmp_path: Path) -> None:
    mesh = put(tmp_path, "robot", "meshes", "link.stl")
    assert find_file("meshes/link.stl", tmp_path / "robot") == mesh
    (tmp_path / "robot" / "urdf").mkdir()
    assert find_file("../meshes/link.stl", tmp_path / "robot" / "urdf").samefile(mesh)
    assert find_file(str(mesh)) == find_file(f"file://{mesh}") == mesh


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "package://arm_description/meshes/link.stl",
            "no file 'package://arm_description/meshes/link.stl': looked into no folder of that name; set "
            "ROS_PACKAGE_PATH to the folder that holds 'arm_description', or AMENT_PREFIX_PATH to the prefix",
        ),
        ("package://deltaq_cell/gone.obj", "looked into .*/deltaq_cell; set ROS_PACKAGE_PATH"),
        ("package://", "looked into no folder of that name"),
        ("package://__main__/x.stl", "looked into no folder of that name"),
        ("package://../../etc", "no file"),
        ("meshes/link.stl", "looked for .*/meshes/link.stl; a name without package://"),
        ("", "no file ''"),
    ],
)
def test_a_missing_file_is_reported_with_the_tried_paths_and_the_remedy(
    tmp_path: Path, name: str, message: str
) -> None:
    with pytest.raises(FileNotFoundError, match=message):
        find_file(name, tmp_path)


def test_a_relative_name_is_not_searched_in_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "link.stl").write_text("solid")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match="no folder to search is known"):
        find_file("link.stl")


def test_a_robots_model_may_be_named_by_its_package() -> None:
    urdf = load_urdf("package://deltaq_cell/robots/kr16/kr16.urdf")
    assert urdf.text == load_urdf("kr16").text
    with pytest.raises(RobotModelError, match=r"no file 'package://gone/arm\.urdf'"):
        load_urdf("package://gone/arm.urdf")
