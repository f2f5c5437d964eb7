from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from deltaq_cell.load import load_cell
from deltaq_launch.compose import FILE, KEY_MAKER, compose_document, compose_text
from deltaq_launch.services import cell_services
from deltaq_services.guarded_key import KEY_FILE


@pytest.fixture(scope="module")
def containers() -> dict[str, Any]:
    return compose_document()["services"]


def test_the_committed_file_is_what_the_table_of_services_gives() -> None:
    assert FILE.read_text(encoding="utf-8") == compose_text(), "write it anew with `make docs`"


def validate(file: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", file]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_file_follows_the_compose_specification() -> None:
    checked = validate(str(FILE))
    assert checked.returncode == 0, checked.stdout


def test_the_specification_would_notice_a_field_that_compose_does_not_know(tmp_path: Any) -> None:
    wrong = tmp_path / "compose.yaml"
    wrong.write_text(compose_text().replace("restart:", "restrat:"), encoding="utf-8")
    checked = validate(str(wrong))
    assert checked.returncode == 1
    assert "restrat" in checked.stdout


def test_there_is_a_container_for_every_service_that_deltaq_up_starts(containers: dict[str, Any]) -> None:
    for service in cell_services(load_cell("lab"), "lab"):
        assert containers[service.name]["command"] == ["python", *service.arguments]


def test_what_a_container_waits_for_has_a_health_check_or_an_end(containers: dict[str, Any]) -> None:
    for container in containers.values():
        for name, awaited in container.get("depends_on", {}).items():
            ends = awaited["condition"] == "service_completed_successfully"
            assert "restart" not in containers[name] if ends else "healthcheck" in containers[name]


def test_the_hli_can_be_started_without_any_emulator(containers: dict[str, Any]) -> None:
    needed, seen = ["hli"], set()
    while needed:
        name = needed.pop()
        seen.add(name)
        needed += containers[name].get("depends_on", {})
    assert seen == {"hli", "sim", "robot-server-fr", "robot-server-gr", KEY_MAKER}


def test_controllers_start_on_demand_only(containers: dict[str, Any]) -> None:
    on_demand = {name for name, container in containers.items() if "profiles" in container}
    assert on_demand == {"leader", "follower", "metrics"}


def test_a_cell_off_the_loopback_gets_its_key_as_a_secret_of_those_who_need_it(tmp_path: Path) -> None:
    cell = tmp_path / "plant.yaml"
    cell.write_text("extends: lab\nsim: tcp/192.168.7.1:7450\n", encoding="utf-8")
    command = [sys.executable, "-m", "deltaq_launch.compose", str(cell)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    file = tmp_path / "compose.yaml"
    file.write_text(printed, encoding="utf-8")
    assert validate(str(file)).returncode == 0
    document = yaml.safe_load(printed)
    keyed = {name for name, container in document["services"].items() if "secrets" in container}
    assert keyed == {"hli", "sim", "robot-server-fr", "robot-server-gr"}
    sim = document["services"]["sim"]
    assert sim["environment"] == {KEY_FILE: "/run/secrets/deltaq-guarded-key"}
    assert sim["volumes"] == [f"{cell}:{cell}:ro"]
    assert document["secrets"]["deltaq-guarded-key"]["file"].startswith("${DELTAQ_GUARDED_KEY_FILE:?")
    assert KEY_MAKER not in document["services"]


def test_on_the_loopback_the_first_container_makes_the_key_for_those_who_need_it(
    containers: dict[str, Any], tmp_path: Path
) -> None:
    document = compose_document()
    assert "secrets" not in document
    keyed = {name for name, container in containers.items() if KEY_FILE in container.get("environment", {})}
    assert keyed == {"hli", "sim", "robot-server-fr", "robot-server-gr"}
    maker = containers[KEY_MAKER]
    (volume,) = maker["volumes"]
    assert volume.partition(":")[0] in document["volumes"]
    for name in keyed:
        assert f"{volume}:ro" in containers[name]["volumes"]
        assert containers[name]["depends_on"][KEY_MAKER] == {"condition": "service_completed_successfully"}
        assert Path(containers[name]["environment"][KEY_FILE]).parent == Path(volume.partition(":")[2])
    # the same command, beside this test's folder in the place of the volume
    file = tmp_path / "guarded.key"
    written = Path(containers["sim"]["environment"][KEY_FILE])
    command = [str(file) if word == str(written) else word for word in maker["command"]]
    said = [sys.executable, "-c", "import deltaq_command; deltaq_command.main()", *command[1:]]
    subprocess.run(said, check=True, capture_output=True)
    key = file.read_text()
    subprocess.run(said, check=True, capture_output=True)  # the cell is brought up again
    assert file.read_text() == key
