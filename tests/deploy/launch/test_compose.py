import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from ran import ran

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.compose import (
    ADDRESS,
    USER,
    compose_document,
    compose_text,
    main,
    real_time_document,
    real_time_text,
)
from deltaq_deploy.launch.services import RESOURCES, cell_services
from deltaq_protocol.certified.names import IDENTITY
from deltaq_services.guarded_realm import GUARDED_FOLDER

DEPLOY = Path(__file__).parents[3] / "deploy"
FILE, REAL_TIME_FILE = DEPLOY / "compose.yaml", DEPLOY / "realtime.yaml"
TOKENS_FILE = DEPLOY / "compose.tokens.yaml"


@pytest.fixture(scope="module")
def containers() -> dict[str, Any]:
    return compose_document()["services"]


def test_the_committed_file_agrees_with_the_table_of_services() -> None:
    assert FILE.read_text(encoding="utf-8") == compose_text(), "write it anew with `make docs`"
    assert REAL_TIME_FILE.read_text(encoding="utf-8") == real_time_text(), "write it anew with `make docs`"


def validate(file: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", file]
    return ran(command, check=False)


@pytest.mark.long
def test_the_file_follows_the_compose_specification() -> None:
    for file in (FILE, TOKENS_FILE, REAL_TIME_FILE):
        checked = validate(str(file))
        assert checked.returncode == 0, checked.stdout


def test_there_is_a_container_for_every_service_that_deltaq_up_starts(containers: dict[str, Any]) -> None:
    for service in cell_services(load_cell("lab"), "lab"):
        command = containers[service.name]["command"]
        assert command[-len(service.arguments) - 1 :] == ["python", *service.arguments]


def test_every_dependency_of_a_container_has_a_health_check_or_an_end(containers: dict[str, Any]) -> None:
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
    assert seen == {"hli", "sim", "robot-server-fr", "robot-server-gr"}


def test_controllers_start_on_demand_only(containers: dict[str, Any]) -> None:
    on_demand = {name for name, container in containers.items() if "profiles" in container}
    assert on_demand == {"leader", "follower", ADDRESS, "metrics"}


@pytest.mark.long
def test_services_of_a_cell_on_several_machines_get_their_identities(tmp_path: Path) -> None:
    cell = tmp_path / "plant.yaml"
    at = "tls/192.168.7.1"
    places = f"sim: {at}:7450\nrobots: {{fr: {{server: {at}:7451}}, gr: {{server: {at}:7452}}}}"
    cell.write_text(f"extends: lab\n{places}\n", encoding="utf-8")
    command = [sys.executable, "-m", "deltaq_deploy.launch.compose", str(cell)]
    printed = ran(command).stdout
    file = tmp_path / "compose.yaml"
    file.write_text(printed, encoding="utf-8")
    assert validate(str(file)).returncode == 0
    document = yaml.safe_load(printed)
    given = {name for name, one in document["services"].items() if IDENTITY in one.get("environment", {})}
    assert given == {"hli", "sim", "robot-server-fr", "robot-server-gr"}
    for name in given:
        one = document["services"][name]
        (mounted,) = (volume for volume in one["volumes"] if volume.startswith(f"${{{IDENTITY}:?"))
        assert mounted.endswith(f"/{name}:{one['environment'][IDENTITY]}:ro")
        assert GUARDED_FOLDER not in one["environment"]
    assert "guarded" not in document["volumes"]
    assert [name for name, one in document["services"].items() if "build" in one] == ["robot-server-fr"]


def test_on_one_machine_the_services_share_a_volume_that_no_other_container_mounts(
    containers: dict[str, Any],
) -> None:
    document = compose_document()
    assert "secrets" not in document
    given = {name for name, one in containers.items() if GUARDED_FOLDER in one.get("environment", {})}
    assert given == {"hli", "sim", "robot-server-fr", "robot-server-gr"}
    for name, one in containers.items():
        mounted = [volume for volume in one.get("volumes", []) if volume.startswith("guarded:")]
        folder = one.get("environment", {}).get(GUARDED_FOLDER)
        assert mounted == ([f"guarded:{folder}"] if name in given else [])
    assert "guarded" in document["volumes"]


def test_no_container_runs_as_root_writes_to_its_image_or_gains_privileges(
    containers: dict[str, Any],
) -> None:
    for container in containers.values():
        assert container["user"] == f"{USER}:{USER}"
        assert container["read_only"] is True
        assert (container["cap_drop"], container.get("cap_add")) == (["ALL"], None)
        assert container["security_opt"] == ["no-new-privileges:true"]


def test_every_container_has_limits_and_no_swap(containers: dict[str, Any]) -> None:
    for name, container in containers.items():
        assert {"mem_limit", "pids_limit"} <= set(container)
        if name != ADDRESS:
            assert container["memswap_limit"] == container["mem_limit"]
            assert container["cpus"] > 0


def test_old_and_rootless_engines_accept_every_setting(containers: dict[str, Any]) -> None:
    for container in containers.values():
        assert "ulimits" not in container
        assert "start_interval" not in container.get("healthcheck", {})


def test_services_on_the_motion_path_may_request_real_time_priority() -> None:
    limits = {name: one["ulimits"]["rtprio"] for name, one in real_time_document()["services"].items()}
    assert limits == {
        "robot-server-fr": 20,
        "emulator-fr": 5,
        "robot-server-gr": 20,
        "emulator-gr": 5,
        "sim": 10,
        "hli": 9,
        "leader": 4,
        "follower": 4,
    }
    for service in cell_services(load_cell("lab"), "lab"):
        assert limits[service.name] == RESOURCES[service.role].real_time


def test_a_health_check_does_not_start_python(containers: dict[str, Any]) -> None:
    checked = [container for container in containers.values() if "healthcheck" in container]
    assert len(checked) == 7
    for container in checked:
        kind, command, file = container["healthcheck"]["test"]
        assert (kind, command, file) == ("CMD", "healthy", container["environment"]["DELTAQ_HEALTH_FILE"])
        assert any(file.startswith(mount.partition(":")[0]) for mount in container["tmpfs"])


def test_tokens_are_secrets_and_not_environment_variables(containers: dict[str, Any], tmp_path: Path) -> None:
    def tokens_of(document: dict[str, Any]) -> dict[str, dict[str, str]]:
        return {
            name: {variable: file for variable, file in one["environment"].items() if "TOKEN" in variable}
            for name, one in document["services"].items()
            if any("TOKEN" in variable for variable in one.get("environment", {}))
        }

    assert tokens_of({"services": containers}) == {}
    expected = {
        "hli": {
            "DELTAQ_OPERATOR_TOKEN_FILE": "/run/secrets/deltaq-operator-token",
            "DELTAQ_CONTROLLER_TOKEN_FILE": "/run/secrets/deltaq-controller-token",
        },
        "console": {
            "DELTAQ_CONSOLE_TOKEN_FILE": "/run/secrets/deltaq-console-token",
            "DELTAQ_OPERATOR_TOKEN_FILE": "/run/secrets/deltaq-operator-token",
        },
        "leader": {"DELTAQ_CLIENT_TOKEN_FILE": "/run/secrets/deltaq-controller-token"},
        "follower": {"DELTAQ_CLIENT_TOKEN_FILE": "/run/secrets/deltaq-controller-token"},
    }
    added = yaml.safe_load(TOKENS_FILE.read_text(encoding="utf-8"))
    assert tokens_of(added) == expected
    for one in added["services"].values():
        given = {file.rpartition("/")[2] for file in one.get("environment", {}).values()}
        assert given <= set(one["secrets"]) <= set(added["secrets"])
    told = added["services"][ADDRESS]
    assert told["command"][-1].endswith("/?token='$$(cat /run/secrets/deltaq-console-token)")
    assert told["secrets"] == ["deltaq-console-token"]
    cell = tmp_path / "plant.yaml"
    cell.write_text(
        "extends: lab\nhli: tcp/192.168.7.1:7447\ntcp_address: 192.168.7.1\nclients_need_tokens: true\n",
        encoding="utf-8",
    )
    document = compose_document(str(cell))
    assert tokens_of(document) == expected
    assert added["secrets"].items() <= document["secrets"].items()
    lines = {"deltaq-lines-certificate", "deltaq-lines-key"}
    assert lines <= set(document["services"]["hli"]["secrets"])
    assert lines <= set(document["secrets"])
    assert all(
        secret["file"].startswith("${DELTAQ_") and ":?" in secret["file"]
        for secret in document["secrets"].values()
    )


def test_a_console_open_to_other_machines_gets_its_token_as_a_secret(tmp_path: Path) -> None:
    cell = tmp_path / "seen.yaml"
    cell.write_text("extends: lab\nconsole_address: 0.0.0.0\n", encoding="utf-8")
    assert compose_document(str(cell))["services"]["console"]["secrets"] == ["deltaq-console-token"]


def test_the_demonstration_prints_the_address_of_the_ready_console(containers: dict[str, Any]) -> None:
    address = containers[ADDRESS]
    assert address["command"] == ["echo", "the console is at http://127.0.0.1:7480"]
    assert address["depends_on"] == {"console": {"condition": "service_healthy"}}
    for controller in ("leader", "follower"):
        ended = containers[controller]["depends_on"][ADDRESS]
        assert ended == {"condition": "service_completed_successfully"}


DOCKERFILE = FILE.with_name("Dockerfile")


def test_the_build_context_contains_every_file_that_the_image_copies() -> None:
    (build,) = [one["build"] for one in compose_document()["services"].values() if "build" in one]
    root = (FILE.parent / build["context"]).resolve()
    assert root / build["dockerfile"] == DOCKERFILE
    let_through = {
        line[1:]
        for line in (FILE.parent / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
        if line.startswith("!")
    }
    with (root / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    packages = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    needed = {package.partition("/")[0] for package in packages}
    needed |= {"pyproject.toml", "constraints.txt", project["project"]["readme"]}
    needed |= {*project["project"]["license-files"], "build/wheels"}
    assert let_through == needed
    copied = re.findall(r"^COPY \S+ (\S+)", DOCKERFILE.read_text(encoding="utf-8"), re.MULTILINE)
    assert copied == ["deploy/healthy.sh", "deploy/until-all-ended.sh"]
    assert all((root / name).exists() for name in copied)


def test_the_image_has_the_user_that_the_containers_run_as() -> None:
    text = DOCKERFILE.read_text(encoding="utf-8")
    assert f"useradd --uid {USER} " in text
    assert text.index("useradd") < text.index(f"\nUSER {USER}:{USER}\n") < text.index("\nCMD")
    folders = {
        volume.split(":")[1]
        for one in compose_document()["services"].values()
        for volume in one.get("volumes", [])
    }
    (made,) = re.findall(
        r"install -d -o deltaq -g deltaq -m 0700 (.*) &&|install -d -o deltaq -g deltaq -m 0700 (.*)", text
    )
    assert set("".join(made).split()) == folders


def test_the_page_prints_the_present_limits() -> None:
    page = (FILE.parents[1] / "docs" / "how-to" / "containers.md").read_text(encoding="utf-8")
    printed = re.findall(r"^\| ([a-z-]+) \| (\d+) \| (\d+) \| ([\d.]+) \|", page, re.MULTILINE)
    limits = [
        (str(role), f"{of.memory_mb}", f"{of.tasks}", f"{of.cores:g}") for role, of in RESOURCES.items()
    ]
    assert sorted(printed) == sorted(limits)


def test_a_cell_is_printed_and_a_missing_one_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    main(["lab"])
    assert "robot-server-fr:" in capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        main(["nosuch"])
    assert ended.value.code == 2
    assert "nosuch: no cell of that name" in capsys.readouterr().err
