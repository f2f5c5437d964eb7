"""`deltaq keys`: what it makes, says and refuses, and `deltaq check` that tells of an identity's end."""

import json
from datetime import timedelta

import pytest
from commands import deltaq
from identities import make

from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.certified.names import IDENTITY

DAY = timedelta(days=1)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "identities"


def test_keys_makes_an_identity_for_each_service_and_person_and_names_the_place_of_the_authority(folder):
    done = deltaq(
        "keys", "--cell", "lab", "--output", str(folder), "--operator", "desk", "--controller", "camera"
    )
    assert (done.returncode, done.stderr) == (0, "")
    names = ["robot-server-fr", "robot-server-gr", "sim", "hli", "operator-desk", "controller-camera"]
    assert [line.partition(":")[0] for line in done.stdout.splitlines()[:6]] == [
        str(folder / n) for n in names
    ]
    assert "take the folder off this machine" in done.stdout
    for name in names:
        identity = Identity.read(folder / name, now_utc())
        assert (identity.name, identity.cell) == (name, "lab")


@pytest.mark.long
def test_keys_adds_missing_identities_and_lists_them_in_json(folder, tmp_path):
    for operator, made, kept in (("desk", 5, 0), ("tower", 1, 4), ("tower", 0, 5)):
        done = deltaq(
            "keys", "--cell", "lab", "--output", str(folder), "--operator", operator, "--days", "30", "--json"
        )
        told = json.loads(done.stdout)
        assert (len(told["made"]), len(told["kept"])) == (made, kept)
        assert told["authority_is_new"] == (operator == "desk")
    drawer = tmp_path / "drawer"
    (folder / "authority").rename(drawer)
    refused = deltaq("keys", "--cell", "lab", "--output", str(folder), "--operator", "night")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--authority" in refused.stderr
    done = deltaq(
        "keys", "--cell", "lab", "--output", str(folder), "--operator", "night", "--authority", str(drawer)
    )
    assert done.returncode == 0
    assert (folder / "operator-night" / "key.pem").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--cell", "nowhere"), "nowhere"),
        (("--operator", "../x"), "cannot be the name of an identity"),
        (("--output", "/proc/none"), "cannot be written"),
    ],
)
def test_wrong_options_give_one_line_and_make_no_files(folder, arguments, said):
    done = deltaq("keys", "--output", str(folder), *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not folder.exists()


@pytest.mark.long
def test_check_warns_before_a_certificate_expires_and_refuses_an_expired_one(folder, tmp_path, monkeypatch):
    make(folder)
    monkeypatch.setenv(IDENTITY, str(folder))
    assert deltaq("check", "--cell", "lab").stdout.startswith("lab: good")
    monkeypatch.setenv(IDENTITY, str(make(tmp_path / "old", age=715 * DAY) / "sim"))
    warned = deltaq("check", "--cell", "lab")
    assert warned.returncode == 0
    assert "warning: DELTAQ_IDENTITY: " in warned.stdout
    assert "is valid for 14 more days" in warned.stdout
    monkeypatch.setenv(IDENTITY, str(make(tmp_path / "over", age=731 * DAY)))
    refused = deltaq("check", "--cell", "lab", "--json")
    assert refused.returncode == 1
    told = json.loads(refused.stdout)
    assert len(told["problems"]) == 4
    assert "was valid until" in told["problems"][0]["message"]
