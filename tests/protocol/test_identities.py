"""Identities in their folders: what is no secret, another's, out of date or torn is refused with what to do."""

import os
import shutil
from datetime import timedelta

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from identities import make

from deltaq_protocol.certified import authority as authorities
from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.certified.names import IdentityError, IdentityKind, kind_of, name_of

DAY = timedelta(days=1)


@pytest.fixture
def folder(tmp_path):
    return make(tmp_path / "lab", people=("operator-desk", "controller-tower"))


def read(folder, after=timedelta(0)):
    return Identity.read(folder, now_utc() + after)


def test_an_identity_has_a_name_and_a_cell(folder):
    sim = read(folder / "sim")
    assert (sim.name, sim.kind, sim.cell) == ("sim", IdentityKind.SERVICE, "lab")
    assert read(folder / "operator-desk").kind is IdentityKind.OPERATOR
    assert read(folder / "controller-tower").kind is IdentityKind.CONTROLLER


def test_each_folder_is_complete_and_every_key_differs(folder):
    names = {
        "authority",
        "sim",
        "hli",
        "robot-server-fr",
        "robot-server-gr",
        "operator-desk",
        "controller-tower",
    }
    assert {path.name for path in folder.iterdir()} == names
    keys = {name: folder / name / "key.pem" for name in names}
    assert len({key.read_bytes() for key in keys.values()}) == len(names)
    assert {key.stat().st_mode & 0o777 for key in keys.values()} == {0o600}
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_key_readable_by_others_is_refused(folder, mode):
    (folder / "sim" / "key.pem").chmod(mode)
    with pytest.raises(IdentityError, match=f"has mode {mode:04o}.*chmod 600"):
        read(folder / "sim")


@pytest.mark.parametrize("name", ["certificate.pem", "authority.pem"])
def test_a_file_writable_by_others_is_refused(folder, name):
    (folder / "sim" / name).chmod(0o666)
    with pytest.raises(IdentityError, match=f"{name} has mode 0666, and other users may write it"):
        read(folder / "sim")


def test_files_of_another_user_are_refused(folder):
    try:
        for name, match in (("certificate.pem", "who would trust it"), ("key.pem", "belongs to user")):
            os.chown(folder / "sim" / name, os.geteuid() + 1, -1)
            with pytest.raises(IdentityError, match=match):
                read(folder / "sim")
    except PermissionError:
        pytest.skip("only root gives files away")


@pytest.mark.parametrize("name", ["key.pem", "certificate.pem", "authority.pem"])
@pytest.mark.parametrize(
    "content", [b"", b"secret", "\N{SNOWMAN}".encode(), b"-----BEGIN CERTIFICATE-----\n"]
)
def test_an_invalid_key_or_certificate_is_reported_and_never_shown(folder, name, content):
    (folder / "sim" / name).write_bytes(content)
    with pytest.raises(IdentityError, match=rf"{name} holds no .*`deltaq keys") as refused:
        read(folder / "sim")
    assert not content or content.decode() not in str(refused.value)


@pytest.mark.parametrize("name", ["key.pem", "certificate.pem", "authority.pem"])
def test_a_missing_file_is_named(folder, name):
    (folder / "sim" / name).unlink()
    with pytest.raises(IdentityError, match=name):
        read(folder / "sim")


@pytest.mark.parametrize(
    "key", [ec.generate_private_key(ec.SECP384R1()), ed25519.Ed25519PrivateKey.generate()]
)
def test_keys_of_other_kinds_are_refused(folder, key):
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "sim" / "key.pem").write_bytes(pem)
    with pytest.raises(IdentityError, match="not of the curve P-256"):
        read(folder / "sim")


def test_a_certificate_of_another_identity_is_refused(folder):
    shutil.copy(folder / "sim" / "certificate.pem", folder / "hli" / "certificate.pem")
    with pytest.raises(IdentityError, match="is not of the key"):
        read(folder / "hli")


def test_certificates_of_another_authority_are_refused(folder, tmp_path):
    other = make(tmp_path / "other")
    shutil.copy(other / "hli" / "authority.pem", folder / "hli" / "authority.pem")
    with pytest.raises(IdentityError, match="was not issued by the authority"):
        read(folder / "hli")


def test_an_identity_cannot_sign_certificates(folder):
    """A certificate that a service signs for itself names the right issuer, and is believed by nobody."""
    sim = read(folder / "sim")
    forged = authorities.Authority(sim.key, sim.authority)
    _, certificate = forged.issue("hli", now_utc())
    (folder / "hli" / "certificate.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    with pytest.raises(IdentityError, match="was not issued by the authority"):
        read(folder / "hli")
    shutil.copy(folder / "sim" / "certificate.pem", folder / "hli" / "authority.pem")
    with pytest.raises(IdentityError, match="is not the certificate of an authority"):
        read(folder / "hli")


# --- time ---------------------------------------------------------------------------------------------


def test_expiry_is_a_warning_thirty_days_before_and_an_error_afterwards(folder):
    sim = read(folder / "sim")
    end = sim.certificate.not_valid_after_utc
    assert sim.warning(end - 31 * DAY) is None
    assert "is valid for 29 more days, until" in (sim.warning(end - 29.5 * DAY) or "")
    assert "is valid for 0 more days" in (sim.warning(end - DAY / 2) or "")
    with pytest.raises(
        IdentityError,
        match=r"certificate\.pem was valid until .*`deltaq keys --cell CELL --output NEW_FOLDER`",
    ):
        Identity.read(folder / "sim", end + DAY)


def test_a_clock_far_behind_is_reported(folder):
    with pytest.raises(IdentityError, match=r"is valid from .*set the clock"):
        read(folder / "sim", -365 * DAY)
    assert read(folder / "sim", -DAY / 2).name == "sim", "clocks of machines differ"


def test_no_certificate_outlives_its_authority(tmp_path):
    folder = make(tmp_path / "lab", age=9.5 * 365 * DAY, lifetime=3650 * DAY)
    sim = read(folder / "sim")
    assert sim.certificate.not_valid_after_utc <= sim.authority.not_valid_after_utc


# --- making -------------------------------------------------------------------------------------------


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_adding_an_operator_overwrites_nothing(folder):
    before = contents(folder)
    make(folder, people=("operator-desk", "operator-night"))
    after = contents(folder)
    assert after | before == after
    assert {path.relative_to(folder).parts[0] for path in set(after) - set(before)} == {
        "operator-night",
        "authority",
    }
    assert read(folder / "operator-night").authority == read(folder / "sim").authority


def test_an_identity_is_added_with_an_authority_stored_elsewhere(folder, tmp_path):
    """The services' folders have gone to their machines, and the authority's to a drawer."""
    services = tmp_path / "machines"
    (folder).rename(services)
    drawer = tmp_path / "drawer"
    (services / "authority").rename(drawer)
    make(tmp_path / "new", people=("operator-night",), authority=drawer)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["operator-night"]
    night, sim = read(tmp_path / "new" / "operator-night"), read(services / "sim")
    assert night.authority == sim.authority


def test_a_later_robot_gets_an_identity_of_the_same_authority(tmp_path):
    folder = make(tmp_path / "lab", robots=("fr",), people=("operator-desk",))
    before = contents(folder)
    make(folder)
    assert contents(folder) | before == contents(folder)
    assert read(folder / "robot-server-gr").authority == read(folder / "sim").authority


def test_a_missing_authority_is_not_replaced_by_a_new_one(folder, tmp_path):
    (folder / "authority").rename(tmp_path / "drawer")
    before = contents(folder)
    with pytest.raises(IdentityError, match=r"has robot-server-fr, .*, and no authority; .*--authority"):
        make(folder, people=("operator-night",))
    assert contents(folder) == before
    with pytest.raises(IdentityError, match="cannot be read: No such file"):
        make(folder, people=("operator-night",), authority=tmp_path / "none")


def test_the_authority_of_another_cell_is_refused(folder):
    with pytest.raises(IdentityError, match="is the authority of cell lab, not of plant"):
        make(folder, cell="plant")


def test_an_existing_identity_is_not_replaced(folder, tmp_path):
    before = contents(folder)
    made = authorities.make_identities(
        "lab", tmp_path / "new", (), ("operator-desk",), now_utc(), folder / "authority"
    )
    assert (made.made, made.kept) == ((), ("operator-desk",))
    assert contents(folder) == before


def test_a_folder_of_another_user_is_not_used(folder):
    (folder / "operator-night").mkdir()
    (folder / "operator-night" / "mine.txt").write_text("mine", encoding="utf-8")
    before = contents(folder)
    with pytest.raises(IdentityError, match="operator-night exists already"):
        make(folder, people=("operator-night",))
    assert contents(folder) == before
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("name", ["", "..", "a/b", "-x", "a b", "ä", "x" * 60, "a\n", "*"])
def test_names_unfit_for_a_folder_are_refused(name):
    for kind in (IdentityKind.OPERATOR, IdentityKind.CONTROLLER):
        with pytest.raises(IdentityError, match=r"cannot be the name of an identity; 1 to \d+ letters"):
            name_of(kind, name)


@pytest.mark.parametrize("kind", IdentityKind)
def test_the_name_of_an_identity_gives_its_role(kind):
    assert kind_of(name_of(kind, "desk")) is kind
