"""What coal says of boxes depends on no query that came before."""

import json
import subprocess
import sys

import pytest

ASK = """
import json, sys
import coal, numpy as np, pinocchio as pin
from deltaq_cell.group import make_reproducible

def distance():
    geometry = pin.GeometryModel()
    for name, size, place in (("low", (0.2, 6.18, 0.161), (1.335, 0.0085, 0.0695)),
                              ("high", (1.285, 0.25, 0.3), (0.7995, -3.155, 0.392))):
        placement = pin.SE3(np.eye(3), np.array(place))
        geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, coal.Box(*size)))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    model, data = pin.Model(), geometry.createData()
    make_reproducible(data)
    pin.updateGeometryPlacements(model, model.createData(), geometry, data, np.zeros(0))
    return pin.computeDistance(geometry, data, 0).min_distance

first = distance()
if sys.argv[1] == "a cell":
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.compiled_proximity import CompiledProximity
    CompiledProximity(CellModel.load("lab"))
print(json.dumps([first, distance()]))
"""


@pytest.mark.long
@pytest.mark.parametrize("before", ["nothing", "a cell"])
def test_boxes_are_as_large_as_they_are_whatever_was_asked_first(before):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", ASK, before],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert json.loads(done.stdout) == [pytest.approx(0.092, abs=1e-15)] * 2
