"""Who watches whom in a cell, by its description and by what was asked for."""

from __future__ import annotations

import pytest

from deltaq_cell.description import CellDescription
from deltaq_cell.load import load_cell
from deltaq_cell.roles import CameraRoles, RoleError, camera_roles, first_camera


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
def test_the_first_camera_watches_the_first_other_robot_unless_told_otherwise(
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
        ({"fr": True}, None, None, "there is nobody to follow"),
        ({"fr": False, "gr": False}, None, None, "no robot of cell lab carries a camera"),
    ],
)
def test_who_cannot_be_what_it_is_to_be_is_refused(
    cameras: dict[str, bool], follower: str | None, leader: str | None, said: str
) -> None:
    with pytest.raises(RoleError, match=said):
        camera_roles(cell_of(**cameras), follower, leader)


def test_the_first_camera_is_that_of_the_first_robot_that_has_one() -> None:
    assert first_camera(cell_of(gr=False, west=True, east=True)) == "west"
