"""Where POSIX's modules are missing, as on Windows, a controller is written and tried: the client, and virtual time.

A process in which those modules cannot be imported stands for such a system. What the modules' absence does not show,
such as signals and sockets that are different there, no test shows.
"""

import sys

import pytest
from ran import ran
from served import Server

MODULES = ("fcntl", "grp", "pwd", "resource", "termios")

WITHOUT = f"""
import sys
for name in {MODULES}:
    assert name not in sys.modules, name
    sys.modules[name] = None
"""

CLIENT = """
from deltaq_protocol.blocking import connect
from deltaq_protocol.in_flight import InFlight
with connect(sys.argv[1], client="elsewhere") as cell, cell.lease("fr") as robot:
    print(robot.move([0.001] * 6).outcome)
"""

EVERY_PART_OF_THE_PROTOCOL = """
import importlib, pkgutil
import deltaq_protocol
names = [part.name for part in pkgutil.walk_packages(deltaq_protocol.__path__, "deltaq_protocol.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""

ENVIRONMENT = """
import numpy as np
from deltaq_experiments.training.environment import CameraEnvironment
env = CameraEnvironment(duration_s=0.05)
env.reset(seed=0)
print(env.step(np.zeros(6))[4]["verdict"]["outcome"])
"""

COMMAND = """
from deltaq_deploy.command import main
sys.argv[1:] = ["check", "--cell", "lab"]
main()
"""

EXPERIMENT = """
from deltaq_deploy.command import main
sys.argv[1:] = ["experiment", "tracking", "--duration-s", "1", "--settle-s", "0", "--json"]
main()
"""


def run_without(script: str, *words: str) -> str:
    """What a script prints in a process without the modules."""
    command = [sys.executable, "-c", WITHOUT + script, *words]
    done = ran(command)
    return done.stdout


@pytest.mark.long
def test_a_client_moves_a_robot() -> None:
    with Server() as server:
        assert run_without(CLIENT, server.description.hli) == "admitted\n"


@pytest.mark.long
def test_every_module_of_the_protocol_can_be_imported() -> None:
    assert int(run_without(EVERY_PART_OF_THE_PROTOCOL)) > 40


@pytest.mark.nightly
def test_a_policy_is_trained_in_virtual_time() -> None:
    assert run_without(ENVIRONMENT) == "admitted\n"


@pytest.mark.long
def test_the_command_checks_a_cell() -> None:
    assert run_without(COMMAND).startswith("lab: good\n")


@pytest.mark.nightly
def test_an_experiment_runs_in_virtual_time() -> None:
    assert '"experiment": "tracking"' in run_without(EXPERIMENT)
