"""A cell's hash is of what its description means: of nothing else, and of all of that."""

from __future__ import annotations

from pathlib import Path

import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.find import find_cell
from deltaq_cell.identity import cell_identity, content_identity
from deltaq_cell.load import load_cell
from deltaq_protocol.identity import CellIdentity, mismatch

LAB = content_identity(load_cell("lab"))


def _changed(folder: Path, changes: str) -> CellIdentity:
    file = folder / "changed.yaml"
    file.write_text(f"extends: lab\n{changes}", encoding="utf-8")
    return content_identity(load_cell(file))


@pytest.mark.parametrize(
    "changes",
    [
        "cycle_s: 0.004",
        "gate: {stop_distance_m: 0.051}",
        "gate: {max_request_age_s: 0.1}",
        "robots: {fr: {joints: {a1: {upper_deg: 154.0}}}}",
        "robots: {fr: {base: {position_m: [0.0, 0.0, 0.001]}}}",
        "robots: {fr: {driver: {max_correction_deg: 5.0}}}",
        "structure: {post: {shape: {kind: sphere, radius_m: 0.1}, pose: {position_m: [9, 9, 9]}}}",
        "cell: lab-of-another-name",
    ],
)
def test_whatever_is_meant_otherwise_changes_the_hash(tmp_path: Path, changes: str) -> None:
    assert not LAB.is_same(_changed(tmp_path, changes))


@pytest.mark.parametrize(
    "changes",
    [
        "# a comment",
        "hli: tcp/127.0.0.1:9999\nsim: tcp/127.0.0.1:9998\ntcp_port: 9997",
        "robots: {fr: {server: tcp/127.0.0.1:9996, driver: {port: 9995, control_port: 9994}}}",
        f"cycle_s: {load_cell('lab').cycle_s!r}0",
    ],
)
def test_where_services_listen_and_how_it_is_written_change_nothing(tmp_path: Path, changes: str) -> None:
    assert LAB.is_same(_changed(tmp_path, changes))


def test_a_copy_of_the_file_is_the_same_cell(tmp_path: Path) -> None:
    copy = tmp_path / "copy.yaml"
    text = find_cell("lab").read_text(encoding="utf-8")
    copy.write_text("# written anew\n\n" + text, encoding="utf-8")
    assert LAB.is_same(content_identity(load_cell(copy)))


def test_bodies_are_hashed_as_they_are_and_not_by_the_name_of_their_file() -> None:
    cell = CellModel.load("lab")
    urdf = {name: robot.urdf for name, robot in cell.robots.items()}
    hulls = {name: robot.hulls for name, robot in cell.robots.items()}
    assert cell_identity(cell.description, urdf, hulls) == cell.identity
    assert not cell.identity.is_same(cell_identity(cell.description, urdf | {"fr": urdf["gr"]}, hulls))
    name = next(name for name in hulls if hulls[name])
    body, corners = next(iter(hulls[name].items()))
    dented = hulls | {name: {**hulls[name], body: corners[1:]}}
    assert not cell.identity.is_same(cell_identity(cell.description, urdf, dented))
    assert cell.identity.is_same(LAB), "who has read no bodies compares the rest"


def test_an_identity_survives_its_text_and_a_stranger_is_nobody() -> None:
    for identity in (LAB, CellModel.load("dawm").identity):
        assert CellIdentity.parse(str(identity)) == identity
    for text in ("", "lab", "lab ", " ", "-", "lab 0-1", "\0"):
        assert not LAB.is_same(CellIdentity.parse(text))


def test_a_mismatch_names_both_cells_and_both_hashes() -> None:
    other = content_identity(load_cell("lab-4ms"))
    assert mismatch("sim", other, LAB) == (
        f"sim has read cell lab-4ms {other.content}, and here it is lab {LAB.content}"
    )
    assert mismatch("sim", CellIdentity.parse(""), LAB).startswith(
        "sim has read cell one of a version that tells no hash"
    )
