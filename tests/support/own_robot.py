"""Robots that are not deltaq's: a small arm with meshes in a ROS package, alone or several in a circle."""

from pathlib import Path

import numpy as np

from deltaq_testing.private_cell import free_ports

PACKAGE = "toy_arm"
URDF = """<robot name="toy_arm">
  <link name="pedestal">{body}</link>
  <link name="upper">{body}<visual><geometry><mesh filename="package://toy_arm/meshes/paint.dae"/></geometry></visual></link>
  <link name="Fore">{body}</link>
  <link name="tool0"/>
  <link name="probe"><collision><geometry><cylinder radius="0.02" length="0.2"/></geometry></collision></link>
  <joint name="pan" type="continuous"><parent link="pedestal"/><child link="upper"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="lift" type="revolute"><parent link="upper"/><child link="Fore"/><origin xyz="0 0 0.35"/>
    <axis xyz="0 1 0"/><limit lower="-2.2" upper="2.2" velocity="2" effort="1"/></joint>
  <joint name="Reach" type="prismatic"><parent link="Fore"/><child link="probe"/><origin xyz="0 0 0.35"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1" effort="1"/></joint>
  <joint name="flange" type="fixed"><parent link="probe"/><child link="tool0"/><origin xyz="0 0 0.1"/></joint>
  <joint name="jaw" type="prismatic"><parent link="probe"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="1"/></joint>
  <joint name="other_jaw" type="prismatic"><parent link="probe"/><child link="right"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="1"/><mimic joint="jaw" multiplier="0.5" offset="0.01"/></joint>
  <link name="left"/><link name="right"/>
</robot>
"""
JOINTS = """
      pan: {home_deg: 0, lower_deg: -170, upper_deg: 170, max_velocity_deg_s: 90, max_acceleration_rad_s2: 8}
      lift: {home_deg: 0, lower_deg: -85, upper_deg: 85, max_velocity_deg_s: 90, max_acceleration_rad_s2: 8}
      Reach: {home_m: 0.2, lower_m: 0, upper_m: 0.45, max_velocity_m_s: 0.5, max_acceleration_m_s2: 4}"""


def write_package(folder: Path) -> Path:
    """Write the package `toy_arm` below a folder; its mesh is a barrel of many corners, a visual one is missing."""
    angle = np.linspace(0, 2 * np.pi, 25)[:-1]
    rings = [
        np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(24, z)], axis=1)
        for radius, z in ((0.04, 0.05), (0.06, 0.15), (0.06, 0.2), (0.04, 0.3))
    ]
    points = np.vstack([*rings, [[0, 0, 0.05], [0, 0, 0.3]]])
    faces = []
    for ring in range(3):
        for k in range(24):
            a, b = 24 * ring + k, 24 * ring + (k + 1) % 24
            faces += [(a, b, b + 24), (a, b + 24, a + 24)]
    faces += [(96, (k + 1) % 24, k) for k in range(24)] + [(97, 72 + k, 72 + (k + 1) % 24) for k in range(24)]
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    package = folder / PACKAGE
    (package / "meshes").mkdir(parents=True)
    (package / "meshes" / "barrel.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    body = f'<collision><geometry><mesh filename="package://{PACKAGE}/meshes/barrel.obj"/></geometry></collision>'
    (package / "arm.urdf").write_text(URDF.format(body=body), encoding="utf-8")
    return package


def write_cell(folder: Path, robots: int = 1, model: str | Path = f"package://{PACKAGE}/arm.urdf") -> Path:
    """Write a cell of one or several such arms, in a circle in which they reach each other, on ports of its own."""
    hli, sim, tcp, *servers = free_ports(3 + robots)
    text = f"""cell: circle
cycle_s: 0.012
hli: tcp/127.0.0.1:{hli}
sim: tcp/127.0.0.1:{sim}
tcp_port: {tcp}
gate: {{servo_lag_s: 0.012, self_stop_distance_m: 0.01}}
structure:
  floor: {{shape: {{kind: box, size_m: [4, 4, 0.2]}}, pose: {{position_m: [0, 0, -0.1]}}}}
robots:"""
    for number, server in enumerate(servers):
        turn = 2 * np.pi * number / robots
        x, y = 0.55 * np.cos(turn), 0.55 * np.sin(turn)
        text += f"""
  arm_{number}:
    model: {model}
    server: tcp/127.0.0.1:{server}
    driver: {{kind: kinematic}}
    base: {{position_m: [{x:.6f}, {y:.6f}, 0], rpy_deg: [0, 0, {np.rad2deg(turn) + 180:.6f}]}}
    mounted_on: [floor]
    locked_joints: {{jaw: 0.02}}
    never_checked: [[Fore, probe]]
    joints:{JOINTS}"""
    file = folder / "circle.yaml"
    file.write_text(text + "\n", encoding="utf-8")
    return file
