"""The page's modules that need no browser, in node."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ran import ran

from deltaq_cell.cell_model import CellModel
from deltaq_services.console.scene import pad_document, scene_of

HERE = Path(__file__).parent
MODULES = HERE.parents[1] / "services" / "deltaq_services" / "console" / "page"
NODE = shutil.which("node")

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="the page's modules are tested in node, which is not here"),
    pytest.mark.long,
]


def node(*arguments, text=""):
    environment = {
        **os.environ,
        "DELTAQ_BROWSER_MODULES": MODULES.as_uri(),
        "DELTAQ_PAD": json.dumps(pad_document()),
    }
    return ran([NODE, "--no-warnings", *arguments], input=text, env=environment, check=False)


def test_the_page_modules_pass_their_own_tests():
    done = node("--test", str(HERE / "modules.test.mjs"))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", ["lab", "dawm"])
def test_the_browser_places_every_joint_and_hand_where_pinocchio_does(name):
    cell = CellModel.load(name)
    generator = np.random.default_rng(7)
    qs = [generator.uniform(robot.lower, robot.upper, (40, robot.n)) for robot in cell.robots.values()]
    document = scene_of(cell, emulated=True).document
    asked = json.dumps({"robots": document["robots"], "qs": [each.tolist() for each in qs]})
    done = node(str(HERE / "kinematics.mjs"), text=asked)
    assert done.returncode == 0, done.stderr

    for robot, configurations, placed in zip(cell.robots.values(), qs, json.loads(done.stdout), strict=True):
        data = robot.model.createData()
        for q, told in zip(configurations, placed, strict=True):
            pin.forwardKinematics(robot.model, data, q)
            joints = [data.oMi[index].homogeneous for index in range(1, robot.model.njoints)]
            hands = [robot.forward(q, hand) for hand in robot.hands]
            for expected, columns in zip([*joints, *hands], [*told["joints"], *told["tools"]], strict=True):
                np.testing.assert_allclose(np.reshape(columns, (4, 4)).T, expected, atol=1e-6)
