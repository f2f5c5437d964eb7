"""Another arm, by its URDF alone: seven axes, spherical shoulder and wrist, camera off the last axis."""

from closed_loop import lab

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Camera, JointDescription, RobotDescription
from deltaq_cell.robot import RobotModel

# height of each joint above the one before it [m] and its axis; the arm stands straight up at zero
CHAIN = [
    (0.30, "0 0 1"),
    (0.0, "0 1 0"),
    (0.42, "0 0 1"),
    (0.0, "0 -1 0"),
    (0.40, "0 0 1"),
    (0.0, "0 1 0"),
    (0.12, "0 0 1"),
]
HOME_DEG = (-90.0, 10.0, 0.0, -95.0, 0.0, 40.0, 0.0)


def urdf() -> str:
    links = [_link("base", 0.09, 0.2)]
    for index, (height_m, axis) in enumerate(CHAIN, start=1):
        parent = "base" if index == 1 else f"l{index - 1}"
        links.append(
            f'<joint name="j{index}" type="revolute"><parent link="{parent}"/><child link="l{index}"/>'
            f'<origin xyz="0 0 {height_m}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.9" upper="2.9" effort="100" velocity="2.5"/></joint>'
        )
        links.append(_link(f"l{index}", 0.06, 0.16 if index % 2 else 0.10))
    return f'<robot name="seven">{"".join(links)}</robot>'


def _link(name: str, radius_m: float, length_m: float) -> str:
    body = f'<geometry><cylinder radius="{radius_m}" length="{length_m}"/></geometry>'
    return f'<link name="{name}"><collision>{body}</collision></link>'


def cell() -> CellModel:
    """The lab cell with this arm in the place of the floor robot, in the air so that it reaches what it looks at."""
    kr16 = lab().robots["fr"].description
    joints = {
        f"j{index}": JointDescription(
            home_deg=home,
            lower_deg=-165.0,
            upper_deg=165.0,
            max_velocity_deg_s=140.0,
            max_acceleration_rad_s2=12.0,
        )
        for index, home in enumerate(HOME_DEG, start=1)
    }
    description = RobotDescription(
        model="seven.urdf",
        server=kr16.server,
        driver=kr16.driver,
        joints=joints,
        servo_lag=kr16.servo_lag,
        base=kr16.base.model_copy(update={"position_m": (-0.402, 0.486, 0.4)}),
        camera=Camera.model_validate({"pose": {"position_m": [0.05, 0.03, 0.1], "rpy_deg": [0, 0, 0]}}),
    )
    arm = RobotModel(description, "fr", urdf())
    return CellModel.of(lab().description, {"fr": arm, "gr": lab().robots["gr"]})
