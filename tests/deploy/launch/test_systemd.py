"""The units, as systemd itself reads them, and the order in which it starts and stops a cell by them."""

import shutil
import sys
from pathlib import Path

import pytest
from ran import ran

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.services import RESOURCES, cell_services, console_service
from deltaq_deploy.launch.systemd import PYTHON, STOPS_WITHIN_S, TARGET, main, unit, units
from deltaq_protocol.errors import DeltaqError

FOLDER = Path(__file__).parents[3] / "deploy" / "systemd"
Unit = dict[str, list[str]]


def read(text: str) -> Unit:
    """Every setting of a unit, each with its values in order: a name may come more than once."""
    found: Unit = {}
    for line in text.splitlines():
        name, is_setting, value = line.partition("=")
        if is_setting and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


def words(settings: Unit, name: str) -> list[str]:
    return " ".join(settings.get(name, [])).split()


@pytest.fixture(scope="module")
def lab() -> dict[str, Unit]:
    return {name: read(text) for name, text in units().items()}


def test_the_committed_units_agree_with_the_table_of_services() -> None:
    committed = {file.name: file.read_text(encoding="utf-8") for file in FOLDER.iterdir()}
    assert committed == units(), "write them anew with `make docs`"


def test_there_is_a_unit_for_every_service_that_deltaq_up_starts(lab: dict[str, Unit]) -> None:
    cell = load_cell("lab")
    services = cell_services(cell, "lab")
    for service in (*services, console_service(cell, "lab", services)):
        settings = lab[f"deltaq-{service.name}.service"]
        assert words(settings, "ExecStart") == [str(PYTHON), *service.arguments]
        assert f"deltaq-{service.name}.service" in words(lab[TARGET], "Wants")
        for needed in service.needs:
            assert f"deltaq-{needed}.service" in words(settings, "After")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed here")
@pytest.mark.parametrize(
    "options", [[], ["--real"], ["--only", "robot-server,sim"], ["--only", "hli,console,metrics"]]
)
def test_systemd_finds_nothing_wrong_with_them(tmp_path: Path, options: list[str]) -> None:
    main(["lab", "--to", str(tmp_path), "--python", sys.executable, *options])
    files = [str(file) for file in tmp_path.iterdir()]
    done = ran(["systemd-analyze", "verify", "--man=no", *files], check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed here")
def test_systemd_rates_the_confinement_of_every_unit_as_ok() -> None:
    for file in FOLDER.glob("*.service"):
        command = ["systemd-analyze", "security", "--offline=yes", "--threshold=40", "--no-pager", str(file)]
        done = ran(command, check=False)
        assert done.returncode == 0, done.stdout


def test_robot_servers_are_stopped_last_and_nothing_is_killed_while_a_robot_brakes(
    lab: dict[str, Unit],
) -> None:
    # systemd stops in the reverse of the order in which it starts
    def is_stopped_before(first: str, then: str) -> bool:
        after = words(lab[first], "After")
        return then in after or any(is_stopped_before(one, then) for one in after if one in lab)

    for robot in ("fr", "gr"):
        for name in ("sim", "hli", f"emulator-{robot}", "metrics"):
            assert is_stopped_before(f"deltaq-{name}.service", f"deltaq-robot-server-{robot}.service")
    assert is_stopped_before("deltaq-hli.service", "deltaq-sim.service")
    longest_s = max(10 * load_cell("lab").gate.krc_timeout_s + 1, 5)
    for name, settings in lab.items():
        if name == TARGET:
            continue
        assert words(settings, "PartOf") == [TARGET]
        assert words(settings, "KillMode") == ["control-group"]
        assert words(settings, "TimeoutStopSec") == [str(STOPS_WITHIN_S)]
        assert longest_s < STOPS_WITHIN_S
        assert "Requires" not in settings, "a service that ends stops no other"
        assert words(settings, "RestartPreventExitStatus") == ["2"]


def test_limits_are_those_of_the_containers(lab: dict[str, Unit]) -> None:
    for service in cell_services(load_cell("lab"), "lab"):
        settings, resources = lab[f"deltaq-{service.name}.service"], RESOURCES[service.role]
        assert words(settings, "MemoryMax") == [f"{resources.memory_mb}M"]
        assert words(settings, "TasksMax") == [str(resources.tasks)]
        assert words(settings, "LimitRTPRIO") == [str(resources.real_time)]
        assert words(settings, "RestrictRealtime") == ["no"]
    assert all("LimitMEMLOCK" in settings for name, settings in lab.items() if name != TARGET)
    assert "LimitRTPRIO" not in lab["deltaq-console.service"]
    assert words(lab["deltaq-console.service"], "RestrictRealtime") == ["yes"]


def test_the_watchdog_covers_only_services_with_a_heartbeat(lab: dict[str, Unit]) -> None:
    watched = {name for name, settings in lab.items() if "WatchdogSec" in settings}
    robots = [
        f"deltaq-{kind}-{robot}.service" for kind in ("robot-server", "emulator") for robot in ("fr", "gr")
    ]
    assert watched == {"deltaq-hli.service", "deltaq-console.service", *robots}
    assert all(words(lab[name], "Type") == ["notify"] for name in watched)


def test_units_of_real_robots_start_no_emulator_and_no_emulated_console() -> None:
    found = units(real=True)
    assert not any("emulat" in text for text in found.values())
    assert "emulated" in units()["deltaq-console.service"]


def test_a_console_of_kinematic_robots_alone_does_not_call_them_real() -> None:
    cell = load_cell("dawm")
    console = console_service(cell, "dawm", cell_services(cell, "dawm"))
    assert "--emulated" in console.arguments


def test_one_machine_of_several_gets_its_own_services(tmp_path: Path) -> None:
    cell = tmp_path / "plant.yaml"
    at = "tls/192.168.7.1"
    places = f"sim: {at}:7450\nrobots: {{fr: {{server: {at}:7451}}, gr: {{server: {at}:7452}}}}"
    cell.write_text(f"extends: lab\n{places}\n", encoding="utf-8")
    found = units(str(cell), real=True, only=["hli", "console"])
    assert set(found) == {"deltaq-hli.service", "deltaq-console.service", TARGET}
    settings = read(found["deltaq-hli.service"])
    assert words(settings, "After") == ["network-online.target"]
    # over TLS the user names identities, in /etc/deltaq/deltaq.env
    assert not any("GUARDED_FOLDER" in value for value in settings["Environment"])
    with pytest.raises(DeltaqError, match="no service 'emulator-fr'"):
        units(str(cell), real=True, only=["emulator-fr"])


def test_own_units_are_overwritten_and_other_files_are_not(tmp_path: Path) -> None:
    (tmp_path / "deltaq-mine.service").write_text("[Unit]\n")
    main(["lab", "--to", str(tmp_path)])
    main(["lab", "--to", str(tmp_path), "--real"])
    names = {file.name for file in tmp_path.iterdir()}
    assert "deltaq-mine.service" in names
    assert not any("emulator" in name for name in names)


def test_a_unit_can_read_a_cell_in_a_home_folder() -> None:
    (sim,) = (service for service in cell_services(load_cell("lab"), "lab") if service.name == "sim")
    assert "ProtectHome=read-only" in unit(sim, "/home/desk/plant.yaml", PYTHON, [sim])
    assert "ProtectHome=yes" in unit(sim, "/etc/deltaq/plant.yaml", PYTHON, [sim])


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["nosuch", "--to", "units"], "nosuch: no cell of that name"),
        (["lab"], "--to"),
        (["lab", "--to", "/proc/units"], "/proc/units cannot be written"),
        (["lab", "--to", "units", "--only", "robot-server-xy"], "no service 'robot-server-xy'"),
    ],
)
def test_a_failed_write_is_reported_in_a_line(
    wrong: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(wrong)
    assert ended.value.code == 2
    assert told in capsys.readouterr().err
