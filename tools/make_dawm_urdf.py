"""Write the model of the DAWM: `python tools/make_dawm_urdf.py`.

Hooper and Noakes say how the joints are arranged and nothing of dimensions: every length, limit, speed, shape and mass
here is a stand-in. The two sides are equal but for the sign of y. The file is committed; running this again changes
nothing.
"""

import math
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).parents[1] / "cell/deltaq_cell/robots/dawm/dawm.urdf"

TORSO_HEIGHT = 1.2
SHOULDER = 0.35
YAW_LINK, PITCH_LINK = 0.45, 0.25
AZIMUTH, UPPER_ARM, FOREARM, WRIST, TOOL = 0.12, 0.84, 0.48, 0.17, 0.31

HEADER = """\
<?xml version="1.0"?>
<!--
  Dual Arm Work Module (DAWM) with two Schilling Titan II: a torso that turns, and on each side a shoulder that yaws,
  a link that pitches and an arm of six joints. Written by make_dawm_urdf.py. Lengths in m, angles in rad.
  Only the arrangement of the joints is published: ALL LENGTHS, LIMITS, SPEEDS, SHAPES AND MASSES ARE STAND-INS
  (the arms' lengths add up to the reach of a TITAN 4). Efforts are not known: 0.
  An arm's base frame has x up along its azimuth axis and z ahead; all zero is the arm stretched out level.
-->
<robot name="dawm">
  <material name="yellow"><color rgba="0.93 0.72 0.10 1"/></material>
  <material name="black"><color rgba="0.13 0.13 0.14 1"/></material>
  <material name="steel"><color rgba="0.72 0.73 0.75 1"/></material>
"""


@dataclass(frozen=True)
class Cylinder:
    """A cylinder from `start` to `end` along one axis of its link; also what the link's mass is spread over."""

    axis: str
    start: float
    end: float
    radius: float
    colour: str
    mass: float

    def xml(self) -> str:
        """Inertia, collision and visual body."""
        length, middle = self.end - self.start, 0.5 * (self.start + self.end)
        xyz = f"{middle:g} 0 0" if self.axis == "x" else f"0 0 {middle:g}"
        rpy = "0 1.5707963267948966 0" if self.axis == "x" else "0 0 0"
        along = 0.5 * self.mass * self.radius**2
        across = self.mass * (3 * self.radius**2 + length**2) / 12
        ixx, izz = (along, across) if self.axis == "x" else (across, along)
        inertia = f'ixx="{ixx:.4g}" ixy="0" ixz="0" iyy="{across:.4g}" iyz="0" izz="{izz:.4g}"'
        shape = f'<geometry><cylinder radius="{self.radius:g}" length="{length:g}"/></geometry>'
        place = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
        return f"""\
    <inertial>
      <origin xyz="{xyz}"/>
      <mass value="{self.mass:g}"/>
      <inertia {inertia}/>
    </inertial>
    <collision>
      {place}
      {shape}
    </collision>
    <visual>
      {place}
      {shape}
      <material name="{self.colour}"/>
    </visual>
"""


TORSO = """\
    <inertial>
      <origin xyz="0 0 -0.15"/>
      <mass value="150"/>
      <inertia ixx="12" ixy="0" ixz="0" iyy="1.5" iyz="0" izz="12.5"/>
    </inertial>
    <collision>
      <origin xyz="0 0 -0.15"/>
      <geometry><box size="0.24 0.94 0.1"/></geometry>
    </collision>
    <visual>
      <origin xyz="0 0 -0.15"/>
      <geometry><box size="0.24 0.94 0.1"/></geometry>
      <material name="yellow"/>
    </visual>
"""


def link(name: str, body: str) -> str:
    """A link with its bodies."""
    return f'\n  <link name="{name}">\n{body}  </link>\n' if body else f'\n  <link name="{name}"/>\n'


def joint(name: str, parent: str, child: str, origin: str, axis: str, deg: tuple[float, float, float]) -> str:
    """A revolute joint; `deg` is its lower and upper limit and its speed, in degrees."""
    lower, upper, speed = (f"{math.radians(value):.9f}" for value in deg)
    return f"""
  <!-- {deg[0]:g} to {deg[1]:g} deg, {deg[2]:g} deg/s -->
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/>
    <child link="{child}"/>
    <origin {origin}/>
    <axis xyz="{axis}"/>
    <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="0"/>
  </joint>
"""


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, rpy: str = "") -> str:
    """Attributes of an origin."""
    return f'xyz="{x:g} {y:g} {z:g}"' + (f' rpy="{rpy}"' if rpy else "")


def side(name: str, y: float) -> str:
    """The joints and links of one side, its shoulder at `y`."""
    arm_base = at(PITCH_LINK, rpy="3.141592653589793 -1.5707963267948966 0")
    rows = [
        joint(f"{name}_yaw", "torso", f"{name}_yaw_link", at(0, y), "0 0 1", (-90, 90, 30)),
        link(f"{name}_yaw_link", Cylinder("x", 0, 0.38, 0.08, "yellow", 40).xml()),
        # positive lifts, as in the arm
        joint(
            f"{name}_pitch", f"{name}_yaw_link", f"{name}_pitch_link", at(YAW_LINK), "0 -1 0", (-60, 60, 30)
        ),
        link(f"{name}_pitch_link", Cylinder("x", 0, 0.13, 0.06, "yellow", 20).xml()),
        joint(f"{name}_1", f"{name}_pitch_link", f"{name}_link_1", arm_base, "-1 0 0", (-120, 120, 60)),
        link(f"{name}_link_1", Cylinder("z", -0.02, AZIMUTH, 0.055, "black", 12).xml()),
        joint(f"{name}_2", f"{name}_link_1", f"{name}_link_2", at(z=AZIMUTH), "0 1 0", (-30, 90, 60)),
        link(f"{name}_link_2", Cylinder("z", 0.07, 0.69, 0.06, "steel", 30).xml()),
        joint(f"{name}_3", f"{name}_link_2", f"{name}_link_3", at(z=UPPER_ARM), "0 1 0", (-135, 135, 70)),
        link(f"{name}_link_3", Cylinder("z", -0.05, 0.42, 0.05, "steel", 18).xml()),
        joint(f"{name}_4", f"{name}_link_3", f"{name}_link_4", at(z=FOREARM), "0 1 0", (-90, 90, 90)),
        link(f"{name}_link_4", Cylinder("z", 0.04, 0.12, 0.045, "black", 8).xml()),
        joint(f"{name}_5", f"{name}_link_4", f"{name}_link_5", at(z=WRIST), "1 0 0", (-90, 90, 90)),
        link(f"{name}_link_5", ""),
        joint(f"{name}_6", f"{name}_link_5", f"{name}_link_6", at(), "0 0 1", (-180, 180, 210)),
        link(f"{name}_link_6", Cylinder("z", 0.08, 0.2, 0.05, "black", 9).xml()),
        f"""
  <joint name="{name}_6_hand" type="fixed">
    <parent link="{name}_link_6"/>
    <child link="{name}_hand"/>
    <origin {at(z=TOOL)}/>
  </joint>
""",
        link(f"{name}_hand", ""),
    ]
    return "".join(rows)


def text() -> str:
    """The whole model."""
    rows = [
        HEADER,
        link("base", Cylinder("z", 0, 0.95, 0.2, "black", 300).xml()),
        joint("torso", "base", "torso", at(z=TORSO_HEIGHT), "0 0 1", (-170, 170, 30)),
        link("torso", TORSO),
        side("left", SHOULDER),
        side("right", -SHOULDER),
        "</robot>\n",
    ]
    return "".join(rows)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
