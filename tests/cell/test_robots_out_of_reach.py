"""How far robots reach: a ball that no body leaves, whatever the joints do."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.reach import apart_m
from studies.scale import plant

SHARES = st.lists(st.floats(0.0, 1.0), min_size=17, max_size=17).map(np.array)


@cache
def cell_model(name):
    return CellModel.load(name)


@cache
def compiled_proximity(name):
    return CompiledProximity(cell_model(name))


@pytest.mark.parametrize(("cell", "robot"), [("lab", "fr"), ("lab", "gr"), ("dawm", "dawm")])
@given(shares=SHARES)
def test_no_corner_of_a_body_leaves_its_ball(cell, robot, shares):
    proximity, model = compiled_proximity(cell), cell_model(cell).robots[robot]
    q = model.lower + shares[: model.n] * (model.upper - model.lower)
    proximity.place(robot, q, np.zeros_like(q))
    reach, (_, (first, last)) = proximity.reach[robot], proximity._ranges[robot]
    distances = [
        np.linalg.norm(
            proximity._where.corners[body, : proximity._anatomy.corner_count[body]] - reach.centre_m, axis=1
        ).max()
        + proximity._anatomy.disc[body]
        + proximity._anatomy.ball[body]
        for body in range(first, last)
    ]
    assert max(distances) <= reach.radius_m(np.abs(q))


def test_a_ball_is_not_much_larger_than_the_arm():
    reach = compiled_proximity("lab").reach["fr"]
    assert 1.6 < reach.radius_m(np.zeros(6)) < 2.6  # a KR 16 reaches 1.6 m to the wrist's centre
    assert not reach.slides.any()


def test_a_prismatic_joint_adds_its_travel():
    reach = compiled_proximity("lab").reach["gr"]
    out = np.array([0.5, 4.0, 1.0, *np.full(6, 3.0)])
    added = reach.radius_m(out) - reach.radius_m(np.zeros(9))
    assert 0.0 < added <= 5.5
    assert reach.radius_m(out * [1, 1, 1, 0, 0, 0, 0, 0, 0]) == reach.radius_m(out)
    assert added == pytest.approx(5.5)  # the tool travels with all three


def in_a_row(folder: Path, distance_m):
    cell = plant(2, 1)
    cell["robots"]["r1"]["base"]["position_m"] = [distance_m, 0.0, 0.0]
    file = folder / "row.yaml"
    file.write_text(yaml.safe_dump(cell), encoding="utf-8")
    return CompiledProximity(CellModel.load(file))


@pytest.mark.long
def test_only_robots_out_of_each_others_reach_are_declared_apart(tmp_path):
    far, near = in_a_row(tmp_path, 6.0), in_a_row(tmp_path, 2.2)
    assert apart_m(near.reach["r0"], near.reach["r1"]) < 0.0
    bound = apart_m(far.reach["r0"], far.reach["r1"])
    assert 0.5 < bound < 3.0
    for q in (np.array([0.0, 0, 0, 0, 0, 0]), np.array([np.pi, 0, 0, 0, 0, 0])):
        far.place("r0", q, np.zeros(6))
        far.place("r1", q, np.zeros(6))
        nearest = far.look(far.between["r0", "r1"], 0.0).tightest
        assert nearest.distance_m >= bound
