"""Which robot of a cell watches which: the first with a camera watches the first other one, unless others are named."""

from dataclasses import dataclass

from deltaq_cell.description import CellDescription
from deltaq_protocol.errors import DeltaqError


class RoleError(DeltaqError):
    """A robot is unfit for its given role."""


@dataclass(frozen=True)
class CameraRoles:
    """The robots' roles.

    Attributes:
        follower: the robot with the camera.
        leader: the robot that is watched.
    """

    follower: str
    leader: str


def first_camera(cell: CellDescription) -> str:
    """The first robot that carries a camera.

    Raises:
        RoleError: none does.
    """
    for name, robot in cell.robots.items():
        if robot.camera is not None:
            return name
    raise RoleError(
        f"no robot of cell {cell.cell} carries a camera: give one a `camera` under `robots.NAME` of its description"
    )


def camera_roles(
    cell: CellDescription, follower: str | None = None, leader: str | None = None
) -> CameraRoles:
    """The follower and its leader.

    If no leader is named, it is the first other robot without a camera, or else the first other robot.

    Args:
        cell: the cell.
        follower: name of the robot with the camera; None for the first one.
        leader: name of the robot that is watched; None for the first other one.

    Raises:
        RoleError: there is no such robot, the follower has no camera, or the two are one robot.
    """
    names = ", ".join(cell.robots)
    for role, name in (("follower", follower), ("leader", leader)):
        if name is not None and name not in cell.robots:
            raise RoleError(f"{role}: the cell has no robot {name!r}; it has {names}")
    if follower is None:
        having = [name for name, robot in cell.robots.items() if robot.camera is not None and name != leader]
        follower = having[0] if having else first_camera(cell)
    if cell.robots[follower].camera is None:
        raise RoleError(f"robot {follower!r} has no camera to follow with; {first_camera(cell)} has one")
    others = [name for name in cell.robots if name != follower]
    if leader is None:
        if not others:
            raise RoleError(f"cell {cell.cell} has {names} alone: there is no robot to follow")
        leader = next((name for name in others if cell.robots[name].camera is None), others[0])
    if leader == follower:
        raise RoleError(
            f"leader {leader!r} is the follower itself; it can follow {', '.join(others) or 'nobody'}"
        )
    return CameraRoles(follower, leader)
