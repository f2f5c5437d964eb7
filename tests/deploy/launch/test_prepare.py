"""Controllers are compiled before anything runs, once, and wherever there is room for it."""

import os
import signal
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from ran import ran

from deltaq_cell import machine_code
from deltaq_cell.load import load_cell
from deltaq_cell.machine_code import TELLS_EACH, compiling_shown
from deltaq_controllers.modes import __main__ as modes_compiler
from deltaq_deploy.launch import prepare
from deltaq_deploy.launch.prepare import Needed, needed_by
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.services import Service, cell_services, console_service, demo_controllers, select

ONE_LAW = """
import sys
from deltaq_cell.compiled import compiled, told_of_compiling

@compiled
def one(x: float) -> float:
    return x + 1.0

with told_of_compiling(lambda name: print("told", name)):
    one(1.0)
    one(2.0)
"""


HERE = Path(__file__).parent


def compiler(monkeypatch: pytest.MonkeyPatch, code: str, gate: str = "", modes: str = "") -> None:
    monkeypatch.setattr(prepare, "GATE_COMPILER", ("-c", gate))
    monkeypatch.setattr(prepare, "MODES_COMPILER", ("-c", modes))
    monkeypatch.setattr(prepare, "CAMERA_COMPILER", ("-c", code))


def printed(code: str, *arguments: str) -> str:
    """What a program of its own prints."""
    command = [sys.executable, "-c", code, *arguments]
    return ran(command).stdout


def ahead(told: list[str], functions: list[str], names: tuple[str, ...] = ("paper",)):  # type: ignore[no-untyped-def]
    return prepare.compiled_ahead(Needed(names), told.append, functions.append)


def test_each_compiled_function_is_reported_before_the_block_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiler(monkeypatch, "import sys; print('compiling near'); print('compiling', *sys.argv[1:])")
    told: list[str] = []
    functions: list[str] = []
    with ahead(told, functions, ("paper", "qp")):
        assert functions == ["near", "paper qp"]
    assert told == []


def test_a_failing_compiler_ends_the_start_with_its_last_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler(monkeypatch, "print('compiling near'); print('no space left'); raise SystemExit(1)")
    with pytest.raises(LaunchError, match=r"could not be compiled:\n  no space left$"), ahead([], []):
        pytest.fail("the block was entered")


def test_without_a_writable_folder_a_temporary_one_is_used_and_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(machine_code, "folder", lambda _: "")
    monkeypatch.setenv("XDG_CACHE_HOME", "/nowhere")
    compiler(monkeypatch, "import os; print('compiling', os.environ['XDG_CACHE_HOME'])")
    told: list[str] = []
    functions: list[str] = []
    with ahead(told, functions):
        kept = Path(os.environ["XDG_CACHE_HOME"])
        assert kept.is_dir()
        assert functions == [str(kept)]
    assert told == [prepare.NOWHERE]
    assert os.environ["XDG_CACHE_HOME"] == "/nowhere"
    assert not kept.exists()


def test_a_run_continues_without_any_writable_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(machine_code, "folder", lambda _: "")
    monkeypatch.setattr(prepare.tempfile, "tempdir", str(tmp_path / "missing"))
    told: list[str] = []
    entered = False
    with ahead(told, []):
        entered = True
    assert entered
    assert told == [prepare.NOWHERE]


def test_completely_compiled_code_is_not_checked_again(tmp_path: Path) -> None:
    code = (
        "import sys; from deltaq_controllers.camera import __main__ as camera;"
        "where = sys.argv[1]; camera.folder = lambda _: where; camera.mark_complete(where, 'paper', camera._PACKAGE);"
        "sys.argv = ['camera', 'paper']; status = camera.main();"
        "print(status, sorted({'numba', 'pinocchio', 'numpy'} & set(sys.modules)))"
    )
    assert printed(code, str(tmp_path)) == "0 []\n"


def test_compiled_code_is_complete_per_controller_and_folder(tmp_path: Path) -> None:
    machine_code.mark_complete(str(tmp_path), "paper", HERE)
    assert machine_code.is_complete(str(tmp_path), "paper", HERE)
    assert not machine_code.is_complete(str(tmp_path), "paper", HERE.parent / "cell"), "of another package"
    assert not machine_code.is_complete(str(tmp_path), "qp", HERE)
    assert not machine_code.is_complete(str(tmp_path / "other"), "paper", HERE)
    machine_code.mark_complete("", "paper", HERE)
    assert not machine_code.is_complete("", "paper", HERE)


@pytest.mark.parametrize(("asked", "lines"), [(False, 3), (True, 30)])
def test_the_compiler_prints_few_lines_of_progress_by_default(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], asked: bool, lines: int
) -> None:
    @contextmanager
    def compiles_thirty(tell: Callable[[str], None]) -> Iterator[None]:
        for number in range(30):
            tell(f"function_{number}")
        yield

    monkeypatch.setattr("deltaq_cell.compiled.told_of_compiling", compiles_thirty)
    monkeypatch.delenv(TELLS_EACH, raising=False)
    if asked:
        monkeypatch.setenv(TELLS_EACH, "1")
    with compiling_shown("the kernel", 40):
        pass
    told = capsys.readouterr().out.splitlines()
    assert len(told) == lines
    assert asked or told[-1] == "compiled the kernel: 30 functions"
    assert told[0] == ("compiling function_0" if asked else "compiling the kernel: 0 of about 40 functions")


def test_cells_of_the_same_arms_need_the_same_machine_code_of_their_modes(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text("extends: lab\ntcp_port: 5999\n")
    code = (
        "import sys; from deltaq_controllers.modes import __main__ as modes\n"
        "where, *cells = sys.argv[1:]; modes.folder = lambda _: where; modes.compile_ahead = print\n"
        "for cell in cells: sys.argv[1:] = [cell]; modes.main()"
    )
    assert printed(code, str(tmp_path), "lab", str(other), "dawm") == "lab\ndawm\n"


PRINTS_ITS_WORDS = "import sys; print('compiling {}', *sys.argv[1:])"


@pytest.mark.parametrize(
    ("needed", "expected"),
    [
        (Needed(), {"look"}),
        (Needed(["paper", "qp"]), {"look", "near paper qp"}),
        (Needed(by_hand="dawm"), {"look", "drive dawm"}),
        (Needed(["paper"], "dawm", gate=False), {"near paper", "drive dawm"}),
        (Needed(gate=False), set()),
    ],
)
def test_only_needed_functions_are_compiled(
    monkeypatch: pytest.MonkeyPatch, needed: Needed, expected: set[str]
) -> None:
    near, look, drive = map(PRINTS_ITS_WORDS.format, ("near", "look", "drive"))
    compiler(monkeypatch, near, look, drive)
    functions: list[str] = []
    with prepare.compiled_ahead(needed, pytest.fail, functions.append):
        assert set(functions) == expected
        assert len(functions) == len(expected)


def test_needed_functions_are_compiled_in_parallel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each compiler waits until the two others have begun."""
    meets = (
        f"import os, sys; here = {str(tmp_path)!r}; open(os.path.join(here, '{{}}'), 'w').close()\n"
        "while len(os.listdir(here)) < 3: pass"
    )
    compiler(monkeypatch, *map(meets.format, ("near", "look", "drive")))
    with prepare.compiled_ahead(Needed(["paper"], "lab"), pytest.fail, pytest.fail):
        pass


def test_a_failing_compiler_ends_the_parallel_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler(monkeypatch, "print('no space left'); raise SystemExit(1)", gate="import signal; signal.pause()")
    said = r"the camera's controllers could not be compiled:\n  no space left$"
    with pytest.raises(LaunchError, match=said), ahead([], []):
        pytest.fail("the block was entered")


@pytest.mark.parametrize(
    ("only", "controllers", "by_hand", "gate"),
    [
        ("hli,sim,robot-server", (), None, True),
        ("hli,robot-server", (), None, False),
        ("hli,sim,console", ("qp",), "lab", True),
        ("console", ("qp",), "lab", False),
        ("sim,follower", ("qp",), None, True),
    ],
)
def test_services_need_what_they_run_and_what_a_console_starts(
    only: str, controllers: tuple[str, ...], by_hand: str | None, gate: bool
) -> None:
    cell = load_cell("lab")
    services: tuple[Service, ...] = (*cell_services(cell, "lab"), *demo_controllers(cell))
    services = select((*services, console_service(cell, "lab", services)), only.split(","))
    assert needed_by(services, cell, "lab") == Needed(controllers, by_hand, gate)


def test_drivers_of_a_cell_without_cameras_follow_no_robot() -> None:
    cell = load_cell("dawm")
    services = cell_services(cell, "dawm")
    assert needed_by((*services, console_service(cell, "dawm", services)), cell, "dawm") == Needed((), "dawm")


def test_modes_that_were_compiled_completely_are_not_loaded_again(tmp_path: Path) -> None:
    code = (
        "import sys; from deltaq_controllers.modes import __main__ as modes;"
        "where = sys.argv[1]; modes.folder = lambda _: where; modes.compile_ahead = print; sys.argv[1:] = ['lab'];"
        "print(modes.main(), modes.main(), sorted({'numba', 'pinocchio'} & set(sys.modules)))"
    )
    assert printed(code, str(tmp_path)) == "lab\n0 0 []\n"


def test_a_cell_that_does_not_exist_has_no_modes_to_compile(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["modes", "nowhere.yaml"])
    with pytest.raises(SystemExit) as ended:
        modes_compiler.main()
    assert ended.value.code == 2
    assert "nowhere.yaml" in capsys.readouterr().err


def test_a_gate_that_cannot_be_compiled_ends_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler(monkeypatch, "", gate="print('no space left'); raise SystemExit(1)")
    said = r"the gate's kernel could not be compiled:\n  no space left$"
    with pytest.raises(LaunchError, match=said), ahead([], []):
        pytest.fail("the block was entered")


def test_a_compiled_gate_is_neither_loaded_nor_checked_again(tmp_path: Path) -> None:
    code = (
        "import sys; from deltaq_cell import __main__ as gate;"
        "where = sys.argv[1]; gate.folder = lambda _: where; gate.mark_complete(where, 'gate', gate._PACKAGE);"
        "print(gate.main(), sorted({'numba', 'pinocchio', 'numpy'} & set(sys.modules)))"
    )
    assert printed(code, str(tmp_path)) == "0 []\n"


@pytest.mark.long
def test_only_a_newly_compiled_function_is_reported(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(f"# {uuid.uuid4()}: machine code is found by the text of its file\n{ONE_LAW}")
    runs = [ran([sys.executable, str(law)]).stdout for _ in range(2)]
    assert runs == ["told one\n", ""]


@pytest.mark.long
def test_an_interrupt_ends_the_compiler_too() -> None:
    code = (
        "import os, signal; from deltaq_deploy.launch import prepare\n"
        "prepare.GATE_COMPILER = ('-c', 'import os, signal; print(\"compiling\", os.getpid()); signal.pause()')\n"
        "def begun(pid):\n"
        "    print(pid, flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "with prepare.compiled_ahead(prepare.Needed(['paper']), print, begun): pass\n"
    )
    done = ran([sys.executable, "-c", code], check=False)
    assert done.returncode == -signal.SIGINT
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)
