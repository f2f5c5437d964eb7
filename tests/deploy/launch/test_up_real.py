"""`deltaq up --real` refuses addresses that cannot be meant, before it listens for any robot."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.load import load_cell
from deltaq_deploy.command.app import app
from deltaq_deploy.launch.prepare import refuse_unreal
from deltaq_protocol.errors import DeltaqError


def cell_file(folder: Path, driver: str, ip_number: str = "192.168.10.10", robot: str = "fr") -> Path:
    xml = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
    (folder / "mine_ethernet.xml").write_text(xml.replace("192.168.10.10", ip_number), encoding="utf-8")
    file = folder / "mine.yaml"
    file.write_text(
        f"extends: lab\nrobots:\n  {robot}: {{driver: {{ethernet_xml: mine_ethernet.xml, {driver}}}}}\n",
        encoding="utf-8",
    )
    return file


def reasons(file: Path) -> list[str]:
    with pytest.raises(DeltaqError) as refused:
        refuse_unreal(load_cell(file), file, ["fr"])
    headline, *lines = str(refused.value).splitlines()
    assert headline == "this cell is not ready for real robots:"
    return lines


def test_a_loopback_address_in_the_cell_with_another_in_the_krc_file_is_refused(tmp_path: Path) -> None:
    address, krc_address = reasons(cell_file(tmp_path, "port: 49152"))
    assert address.startswith("robots.fr.driver.address: 127.0.0.1 is this machine's own")
    assert "send to 192.168.10.10" in address
    assert krc_address.startswith("robots.fr.driver.krc_address: is missing")


@pytest.mark.parametrize(
    ("krc_address", "message"),
    [
        ("127.0.0.1", "krc_address: 127.0.0.1 is no address of a KRC"),
        ("0.0.0.0", "krc_address: 0.0.0.0 is no address of a KRC"),
        ("192.168.10.10", "krc_address: 192.168.10.10 is this machine's own"),
    ],
)
def test_an_address_impossible_for_a_krc_is_refused(tmp_path: Path, krc_address: str, message: str) -> None:
    file = cell_file(tmp_path, f"address: 192.168.10.10, krc_address: {krc_address}")
    assert any(message in line for line in reasons(file))


def test_unsafe_krc_files_are_refused_before_the_start(tmp_path: Path) -> None:
    file = cell_file(tmp_path, "address: 192.168.10.10, krc_address: 192.168.10.20, port: 49200")
    (line,) = reasons(file)
    assert line.startswith("robots.fr.driver.port: mine_ethernet.xml: CONFIG/PORT: is 49152")


def test_plausible_addresses_pass(tmp_path: Path) -> None:
    real = cell_file(tmp_path, "address: 192.168.10.10, krc_address: 192.168.10.20")
    refuse_unreal(load_cell(real), real, ["fr"])


def test_the_loopback_passes_for_a_separately_started_emulator(tmp_path: Path) -> None:
    file = cell_file(tmp_path, "port: 49152", ip_number="127.0.0.1")
    refuse_unreal(load_cell(file), file, ["fr"])


def test_the_shipped_cell_is_refused_with_status_2_and_starts_nothing() -> None:
    result = CliRunner().invoke(app, ["up", "--cell", "lab", "--real"])
    assert str(result.exception).startswith("this cell is not ready for real robots:")
    assert result.output == ""


def test_services_of_another_machine_are_not_checked() -> None:
    refuse_unreal(load_cell("lab"), find_cell("lab"), [])
