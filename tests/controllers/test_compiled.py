"""Machine code must say what the Python says, and be found again where it was left."""

import ast
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.errors import NumbaError
from ran import ran

from deltaq_cell.compiled import compiled, inlined, makes_no_array
from deltaq_cell.machine_code import folder_of, package_of

LAW = """
import numpy as np
from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.follower import CameraFollower

cell = CellModel.load("lab")
robot, leader = cell.robots["fr"], cell.robots["gr"]
random = np.random.default_rng(2)
follower = CameraFollower(robot, leader, 0.012)
for _ in range(6):
    q = random.uniform(robot.lower, robot.upper)
    near = robot.camera_pose(q)[:3, 3] + random.normal(scale=0.3, size=3)
    dq = follower.increment(q, 0.3 * random.choice([-1, 1], 6) * follower.limits.max_dq, near, leader.home, 1.0, 0.0)
    print(*(value.hex() for value in dq.tolist()))
"""


def run(program: str, **environment: str) -> str:
    return ran([sys.executable, "-c", program], env={**os.environ, **environment}).stdout


def increments(text: str) -> np.ndarray:
    return np.array([[float.fromhex(value) for value in line.split()] for line in text.splitlines()])


@pytest.mark.long
def test_the_machine_code_of_a_law_agrees_with_its_python() -> None:
    compiled, python = increments(run(LAW)), increments(run(LAW, NUMBA_DISABLE_JIT="1"))
    assert np.abs(compiled).max() > 1e-4
    np.testing.assert_allclose(compiled, python, rtol=1e-9, atol=1e-13)


ONE = "\n@compiled\ndef one() -> float: return 1.0\n"


def test_machine_code_is_cached_beside_its_source_by_a_hash_of_all_sources(tmp_path: Path) -> None:
    package, nowhere = tmp_path / "package", tmp_path / "cache"
    package.mkdir()
    (package / "law.py").write_text(ONE)
    first = folder_of(package, nowhere)
    assert Path(first).parent == package / "__pycache__"
    (package / "plain.py").write_text("unrelated = 1\n")
    assert folder_of(package, nowhere) == first
    (package / "called.py").write_text(ONE)
    assert folder_of(package, nowhere) != first
    assert not nowhere.exists()


def test_installed_machine_code_in_an_unwritable_folder_is_copied_to_the_user_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, cache = tmp_path / "package", tmp_path / "cache"
    package.mkdir()
    (package / "law.py").write_text(ONE)
    installed = Path(folder_of(package, cache))
    (installed / "law.nbi").write_text("machine code")
    # root may write to every folder
    monkeypatch.setattr(os, "access", lambda folder, _mode: package not in Path(folder).parents)
    kept = Path(folder_of(package, cache))
    assert kept == cache / "deltaq" / installed.name
    assert (kept / "law.nbi").read_text() == "machine code"


@pytest.mark.parametrize("decorator", ["compiled", "copied", "inlined", "makes_no_array"])
def test_every_function_that_may_be_part_of_another_is_part_of_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decorator: str
) -> None:
    package, kernel = tmp_path / "package", tmp_path / "kernel"
    monkeypatch.setattr("deltaq_cell.machine_code._HERE", kernel)
    for folder in (package, kernel):
        folder.mkdir()
        before = folder_of(package, tmp_path)
        (folder / "called.py").write_text(ONE.replace("compiled", decorator))
        assert folder_of(package, tmp_path) != before


def test_machine_code_is_cached_by_package_and_that_of_a_script_beside_the_decorator() -> None:
    assert package_of("deltaq_controllers.camera.law").name == "deltaq_controllers"
    assert package_of("deltaq_cell.kernel.look").name == "deltaq_cell"
    assert package_of("__main__").name == package_of("no_such_module").name == "deltaq_cell"


def test_an_inlined_function_that_makes_an_array_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # of machine code that was kept numba tells nothing
    monkeypatch.setattr("deltaq_cell.compiled._folder", lambda _module: "")

    def least(rows: np.ndarray) -> float:
        found = 0.0
        for row in rows:
            found = min(found, row[0])
        return found

    def zeros(count: int) -> float:
        return float(np.zeros(count)[0])

    rows = np.array([[1.0], [-2.0]])
    for decorate, counts in ((compiled, True), (makes_no_array, False)):
        function: Any = decorate(least)
        assert function(rows) == -2.0
        (machine_code,) = function.inspect_asm().values()
        assert ("NRT_decref" in machine_code) is counts
    assert compiled(zeros)(3) == 0.0
    with pytest.raises(NumbaError, match="array passed into the function"):
        makes_no_array(zeros)(3)


def test_an_inlined_function_makes_no_array_and_stays_python(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("deltaq_cell.compiled._folder", lambda _module: "")

    def left(a: float, b: float) -> float:
        return (a + b) - a

    def zeros(count: int) -> float:
        return float(np.zeros(count)[0])

    assert inlined(left) is left
    assert compiled(lambda a, b: left(a, b))(1e16, 1.0) == left(1e16, 1.0) == 0.0
    assert inlined(zeros)(3) == 0.0
    with pytest.raises(NumbaError, match="array passed into the function"):
        makes_no_array(lambda count: zeros(count))(3)


def test_without_a_writable_folder_no_machine_code_is_cached(tmp_path: Path) -> None:
    (tmp_path / "__pycache__").write_text("not a folder")
    (tmp_path / "cache").write_text("nor this")
    assert folder_of(tmp_path, tmp_path / "cache") == ""
    assert folder_of(tmp_path, Path()) == "", "of a user without a home"


CALL = """
from deltaq_cell.compiled import told_of_compiling
from moved.laws import law
with told_of_compiling(print):
    assert law.one() == 1.0
"""


@pytest.mark.nightly
def test_machine_code_stays_valid_if_its_package_is_moved(tmp_path: Path) -> None:
    laws = tmp_path / "here" / "moved" / "laws"
    laws.mkdir(parents=True)
    for folder in (laws.parent, laws):
        (folder / "__init__.py").touch()
    (laws / "law.py").write_text(f"from deltaq_cell.compiled import compiled\n{ONE}")

    def called_in(folder: Path) -> str:
        path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
        return run(CALL, PYTHONPATH=path)

    assert called_in(tmp_path / "here") == "one\n"
    (tmp_path / "here").rename(tmp_path / "there")
    assert called_in(tmp_path / "there") == ""
    (tmp_path / "there" / "moved" / "laws" / "law.py").write_text(
        f"from deltaq_cell.compiled import compiled\n{ONE.replace('1.0', '2.0 - 1.0')}"
    )
    assert called_in(tmp_path / "there") == "one\n"


# Compiled functions use no linear algebra of numba's: it needs scipy, which an installed deltaq does not have.


ROOT = Path(__file__).parents[2]
DECORATORS = {"compiled", "copied", "inlined", "makes_no_array"}
LINEAR_ALGEBRA = {"dot", "vdot", "linalg"}


def compiled_functions() -> Iterator[Any]:
    for folder in ("cell/deltaq_cell", "controllers/deltaq_controllers", "services/deltaq_services"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            source = file.read_text(encoding="utf-8")
            if not any(f"@{name}\n" in source for name in DECORATORS):
                continue  # to parse the whole tree takes seconds
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.FunctionDef) and any(
                    isinstance(one, ast.Name) and one.id in DECORATORS for one in node.decorator_list
                ):
                    yield pytest.param(node, id=f"{file.stem}.{node.name}")


def needs_scipy(function: ast.AST) -> list[int]:
    return [
        node.lineno
        for node in ast.walk(function)
        if (isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in LINEAR_ALGEBRA)
    ]


@pytest.mark.parametrize("function", list(compiled_functions()))
def test_a_compiled_function_uses_no_linear_algebra_of_numba(function: ast.FunctionDef) -> None:
    assert needs_scipy(function) == []
