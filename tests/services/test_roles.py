"""Who may do what, and where the tokens come from: the bad ones first."""

from pathlib import Path

import pytest
from small_cell import small_cell

from deltaq_protocol.given_token import GivenTokenError
from deltaq_protocol.topic import ClientRole
from deltaq_services.hli.client_roles import LEAST_CHARACTERS, ClientRoles, client_roles
from deltaq_services.hli.line_encryption import LineEncryptionError, line_encryption
from deltaq_services.rate_limit import MOST_TRIES_S, Tries

OPERATOR, CONTROLLER = "o" * LEAST_CHARACTERS, "c" * LEAST_CHARACTERS
OFF_LOOPBACK = [{"hli": "tcp/0.0.0.0:7447"}, {"tcp_address": "0.0.0.0"}, {"tcp_address": "robots.example"}]


def secret(folder: Path, text: str = OPERATOR, mode: int = 0o600) -> str:
    file = folder / "token"
    file.write_text(text)
    file.chmod(mode)
    return str(file)


@pytest.mark.parametrize("place", OFF_LOOPBACK)
def test_beyond_the_loopback_an_open_realm_needs_permission_of_the_cell(place: dict[str, str]) -> None:
    with pytest.raises(GivenTokenError, match=next(iter(place))):
        client_roles(small_cell(**place), {"DELTAQ_OPERATOR_TOKEN": OPERATOR})
    allowed = small_cell(**place, anyone_who_connects_may_move_the_robots=True)
    assert client_roles(allowed, {}).of(None) is ClientRole.OPERATOR


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({}, "neither DELTAQ_OPERATOR_TOKEN_FILE nor DELTAQ_OPERATOR_TOKEN is set"),
        ({"DELTAQ_OPERATOR_TOKEN": OPERATOR}, "neither DELTAQ_CONTROLLER_TOKEN_FILE nor"),
        ({"DELTAQ_CONTROLLER_TOKEN": CONTROLLER}, "then everybody is an operator"),
        ({"DELTAQ_OPERATOR_TOKEN": OPERATOR, "DELTAQ_CONTROLLER_TOKEN": OPERATOR}, "are the same"),
        (
            {"DELTAQ_OPERATOR_TOKEN": OPERATOR, "DELTAQ_CONTROLLER_TOKEN": "short"},
            "5 characters, at least 16",
        ),
        ({"DELTAQ_OPERATOR_TOKEN_FILE": "/nowhere"}, "/nowhere cannot be read"),
    ],
)
def test_a_cell_that_needs_tokens_names_the_missing_ones(environment: dict[str, str], said: str) -> None:
    with pytest.raises(GivenTokenError, match=said):
        client_roles(small_cell(tcp_address="0.0.0.0", clients_need_tokens=True), environment)


@pytest.mark.parametrize(("text", "mode"), [(OPERATOR, 0o644), ("", 0o600), (" \n", 0o600)])
def test_an_invalid_secret_file_is_refused_without_showing_it(tmp_path: Path, text: str, mode: int) -> None:
    with pytest.raises(GivenTokenError, match=r"token (has mode 0644|holds no text)") as refused:
        client_roles(small_cell(), {"DELTAQ_OPERATOR_TOKEN_FILE": secret(tmp_path, text, mode)})
    assert OPERATOR not in str(refused.value)


def test_tokens_come_from_a_file_or_from_the_environment(tmp_path: Path) -> None:
    environment = {
        "DELTAQ_OPERATOR_TOKEN_FILE": secret(tmp_path, OPERATOR + "\n"),
        "DELTAQ_CONTROLLER_TOKEN": CONTROLLER,
    }
    roles = client_roles(small_cell(hli="tcp/0.0.0.0:7447", clients_need_tokens=True), environment)
    assert [roles.of(token) for token in (OPERATOR, CONTROLLER, None, "", "guessed", "\ud800")] == [
        ClientRole.OPERATOR, ClientRole.CONTROLLER, *[ClientRole.OBSERVER] * 4,
    ]  # fmt: skip


def test_tokens_do_not_cross_a_network_in_the_clear() -> None:
    exposed = small_cell(tcp_address="0.0.0.0", clients_need_tokens=True)
    with pytest.raises(LineEncryptionError, match=r"tcp_address \(0\.0\.0\.0\) .* in the clear"):
        line_encryption(exposed, {})
    with pytest.raises(LineEncryptionError, match="go together"):
        line_encryption(exposed, {"DELTAQ_LINES_KEY_FILE": "key.pem"})
    both = {"DELTAQ_LINES_KEY_FILE": "/no/key.pem", "DELTAQ_LINES_CERTIFICATE_FILE": __file__}
    with pytest.raises(LineEncryptionError, match=r"/no/key\.pem cannot be used"):
        line_encryption(exposed, both)
    assert line_encryption(small_cell(clients_need_tokens=True), {}) is None


def test_with_an_operator_token_alone_others_are_controllers_and_without_one_operators() -> None:
    assert ClientRoles(OPERATOR).of(None) is ClientRole.CONTROLLER
    assert ClientRoles(OPERATOR).is_wrong("guessed")
    assert ClientRoles().of("anything") is ClientRole.OPERATOR
    assert not ClientRoles().is_wrong("anything")


def test_few_wrong_tokens_of_an_address_are_compared_without_delaying_other_addresses() -> None:
    tries, compared = Tries(), 0
    for k in range(10_000):
        if tries.may_try("192.0.2.1", k * 1e-3):
            compared += 1
            tries.failed("192.0.2.1", k * 1e-3)
    assert compared <= MOST_TRIES_S * 10 + MOST_TRIES_S
    assert tries.may_try("192.0.2.2", 10.0)
    assert tries.may_try("192.0.2.1", 11.0)


def test_a_flood_of_addresses_uses_bounded_memory() -> None:
    tries = Tries()
    for k in range(5000):
        tries.failed(f"192.0.2.{k}", 0.0)
    assert len(tries._rates) <= 256
