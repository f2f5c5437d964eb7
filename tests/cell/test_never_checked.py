"""Which bodies of a robot are never checked against each other: what always touches, and what the cell names."""

from pathlib import Path

import numpy as np
import pytest
from data_sheet import describe

from deltaq_cell.cell_model import CellModel
from deltaq_cell.check import check_cell
from deltaq_cell.models import RobotModelError
from deltaq_cell.never_checked import SAMPLES, Why, distances, samples
from deltaq_cell.robot import RobotModel

BALL = '<collision><geometry><sphere radius="{radius}"/></geometry></collision>'
LINKS = ("one", "two", "three")


def chain(radius: float = 0.12, gap: float = 0.1) -> str:
    """Three balls in a row, each turned about its own middle: the first and the last touch if `radius > gap`."""
    links = "".join(f'<link name="{name}">{BALL.format(radius=radius)}</link>' for name in LINKS)
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{gap} 0 0"/><axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="2" effort="1"/></joint>'
        for name, parent, child, axis in (("a", "one", "two", "1 0 0"), ("b", "two", "three", "0 0 1"))
    )
    return f'<robot name="chain">{links}{joints}</robot>'


def robot(urdf: str, **changes: object) -> RobotModel:
    joint = {
        "home_deg": 0, "lower_deg": -150, "upper_deg": 150, "max_velocity_deg_s": 50, "max_acceleration_rad_s2": 1,
    }  # fmt: skip
    return RobotModel(describe("kr16", joints={"a": joint, "b": joint}, **changes), "r", urdf=urdf)


def test_bodies_that_touch_at_home_and_everywhere_are_not_checked() -> None:
    pairs = robot(chain()).never_checked
    assert pairs["r/one", "r/three"] is Why.ALWAYS_TOUCH
    assert pairs["r/one", "r/two"] is Why.ADJACENT


def test_bodies_that_touch_in_no_sample_are_checked() -> None:
    assert ("r/one", "r/three") not in robot(chain(radius=0.05)).never_checked


def test_bodies_that_touch_at_home_but_not_everywhere_are_checked() -> None:
    # the last ball swings about the middle one: it touches the first where it is folded back, as at home
    swinging = chain(radius=0.12, gap=0.2).replace('axis xyz="1 0 0"', 'axis xyz="0 0 1"')
    folded = swinging.replace(
        '<child link="three"/><origin xyz="0.2', '<child link="three"/><origin xyz="-0.19'
    )
    model = robot(folded)
    pair = ("r/one", "r/three")
    bodies = list(model.geometry.geometryObjects)
    assert distances(model.model, bodies, [pair], [model.home]).max() < 0
    assert pair not in model.never_checked


def test_the_same_configurations_are_drawn_always_and_lie_within_the_limits() -> None:
    lower, upper = np.array([-1.0, 0.0]), np.array([1.0, 0.5])
    drawn = samples(lower, upper)
    assert drawn.shape == (SAMPLES, 2)
    assert np.all((drawn >= lower) & (drawn <= upper))
    np.testing.assert_array_equal(drawn, samples(lower, upper))


def test_shipped_robots_omit_only_pairs_that_touch_by_construction() -> None:
    for cell in ("lab", "dawm"):
        for model in CellModel.load(cell).robots.values():
            assert set(model.never_checked.values()) <= {Why.ONE_LINK, Why.ADJACENT, Why.MOUNTED}


def test_a_cell_names_links_or_bodies_that_are_never_checked() -> None:
    tool = {"bodies": {"cube": {"shape": {"kind": "box", "size_m": [0.1, 0.1, 0.1]}}}}
    description = describe("kr16", tool=tool, never_checked=[["base", "link_3"], ["tool_cube", "link_2"]])
    never = RobotModel(description, "fr").never_checked
    assert never["fr/base", "fr/link_3"] is Why.NAMED
    assert never["fr/link_2", "fr/tool_cube"] is Why.NAMED


def test_a_link_of_several_bodies_stands_for_all_of_them() -> None:
    two = chain(radius=0.05).replace('<link name="one">', f'<link name="one">{BALL.format(radius=0.04)}')
    never = robot(two, never_checked=[["three", "one"]]).never_checked
    assert never["r/one_1", "r/three"] is never["r/one_2", "r/three"] is Why.NAMED


def test_an_unknown_body_is_refused_with_its_line() -> None:
    model = RobotModel(describe("kr16", never_checked=[["base", "link_3"], ["base", "link3"]]), "fr")
    with pytest.raises(RobotModelError, match=r"no body 'link3'.*did you mean 'link_3'") as caught:
        _ = model.never_checked
    assert caught.value.field == ("never_checked", "1", "1")


CELL = """\
cell: chain
cycle_s: 0.012
robots:
  r:
    model: chain.urdf
    server: tcp/127.0.0.1:17451
    driver: {kind: kinematic}
    joints:
      a: {home_deg: 0, lower_deg: -150, upper_deg: 150, max_velocity_deg_s: 50, max_acceleration_rad_s2: 1}
      b: {home_deg: 0, lower_deg: -150, upper_deg: 150, max_velocity_deg_s: 50, max_acceleration_rad_s2: 1}
"""


def written(folder: Path, radius: float, more: str = "") -> Path:
    (folder / "chain.urdf").write_text(chain(radius, gap=0.1))
    file = folder / "chain.yaml"
    file.write_text(CELL + more)
    return file


def test_a_home_with_overlapping_neighbours_passes_and_the_check_lists_the_omitted_pairs(
    tmp_path: Path,
) -> None:
    report = check_cell(written(tmp_path, 0.12))
    assert report.problems == ()
    assert report.never_checked["r"]["r/one", "r/three"] is Why.ALWAYS_TOUCH
    told = report.as_dict()["never_checked"]["r"]
    assert {"pair": ["r/one", "r/three"], "why": str(Why.ALWAYS_TOUCH)} in told


def test_bodies_too_near_in_every_configuration_are_an_error_with_a_remedy(
    tmp_path: Path,
) -> None:
    # two centimetres are asked for, one is there
    (problem,) = check_cell(written(tmp_path, 0.095)).problems
    assert (
        "r/three and r/one may be 0.0097 m apart" in problem.message
        or "r/one and r/three may be 0.0097 m" in problem.message
    )
    assert f"in none of {SAMPLES} configurations" in problem.message
    assert "farther apart than 0.010 m: lower gate.self_stop_distance_m" in problem.message
    assert check_cell(written(tmp_path, 0.095, "    never_checked: [[one, three]]\n")).ok
    assert check_cell(written(tmp_path, 0.095, "gate: {self_stop_distance_m: 0.005}\n")).ok


def test_an_unknown_name_is_an_error_with_its_line(tmp_path: Path) -> None:
    (problem,) = check_cell(written(tmp_path, 0.05, "    never_checked:\n    - [one, tree]\n")).problems
    assert (problem.field, problem.suggestion) == ("robots.r.never_checked.0.1", "three")
    assert problem.line == len(CELL.splitlines()) + 2


def test_colliding_bodies_within_a_joint_range_are_a_warning_with_range_and_depth(tmp_path: Path) -> None:
    # two balls on either side of a hinge, 0.24 m from it, meet where it is folded
    def link(name: str, x: float) -> str:
        ball = BALL.format(radius=0.1).replace("<collision>", f'<collision><origin xyz="{x} 0 0"/>')
        return f'<link name="{name}">{ball}</link>'

    def joint(name: str, parent: str, child: str, x: float) -> str:
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="{x} 0 0"/><limit lower="-3" upper="3" velocity="2" effort="1"/></joint>'
        )

    links = link("one", -2) + link("two", -0.24) + link("three", 0.24)
    urdf = f'<robot name="t">{links}{joint("a", "one", "two", 0)}{joint("b", "two", "three", 0)}</robot>'
    (tmp_path / "chain.urdf").write_text(urdf)
    (tmp_path / "chain.yaml").write_text(CELL)
    report = check_cell(tmp_path / "chain.yaml")
    assert report.ok
    (problem,) = report.problems
    assert problem.field == "robots.r.joints.b"
    # their middles are 0.48 cos(b / 2) apart: 0.2 m at 130.8 degrees, 0.124 m at 150
    for part in ("r/three and r/two", "by up to 0.076 m", "at -150 to -132.5 and 132.5 to 150 deg"):
        assert part in problem.message
    (tmp_path / "chain.yaml").write_text(CELL + "    never_checked: [[two, three]]\n")
    assert check_cell(tmp_path / "chain.yaml").problems == ()


def test_a_limit_that_no_message_can_carry_is_an_error_of_the_cell(tmp_path: Path) -> None:
    file = written(tmp_path, 0.05)
    file.write_text(file.read_text().replace("upper_deg: 150", "upper_deg: 1.0e+300", 1))
    assert not check_cell(file).ok
