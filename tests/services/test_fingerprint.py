"""The gate's fingerprint: which code it is of."""

from pathlib import Path

import deltaq_cell
import deltaq_protocol.brake
from deltaq_services.sim.fingerprint import code_files


def test_the_code_of_a_package_is_that_of_the_packages_in_it_too() -> None:
    root = Path(deltaq_cell.__file__)
    found = {file.relative_to(root.parent).as_posix() for file in code_files(root)}
    assert {"proximity.py", "kernel/look.py", "kernel/gap.py", "description/cell.py"} <= found


def test_the_code_of_a_module_is_its_file_alone() -> None:
    brake = Path(deltaq_protocol.brake.__file__)
    assert code_files(brake) == [brake]
