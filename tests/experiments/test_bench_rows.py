"""Rows of `deltaq bench`: what keeps a bound and what does not, and what they measure."""

import gzip
import itertools
from pathlib import Path

import msgpack
import pytest

from deltaq_experiments.bench.decisions import near_obstacles, stored
from deltaq_experiments.bench.rsi_reply import standing_telegrams
from deltaq_experiments.bench.table import BenchRow, BenchTable
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Outcome, Verdict
from deltaq_services.robot_server.rsi_driver import sensor_codec
from deltaq_services.sim.core import Sim
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from studies import cornered


@pytest.fixture(scope="module")
def lab() -> LoadedCell:
    return LoadedCell.load("lab")


@pytest.mark.parametrize(
    "bounds",
    [{"at_most": 1.9}, {"p99_at_most": 1.9}, {"p99_9_at_most": 1.9}, {"longest_at_most": 1.9}],
)
def test_each_bound_can_fail_alone(bounds: dict[str, float]) -> None:
    row = BenchRow.of("what", "reference", [2.0] * 10, [1.0] * 10, **bounds)
    assert row.kept is False
    assert not BenchTable(rows=(row,)).good
    [(ratio, bound)] = row.bounds.values()
    assert (ratio, bound) == (2.0, 1.9)


def test_a_row_without_a_bound_never_fails() -> None:
    row = BenchRow.of("what", "reference", [9.0], [1.0])
    assert row.kept is None
    assert BenchTable(rows=(row,)).good


def test_the_slowest_are_compared_with_the_slowest() -> None:
    row = BenchRow.of("what", "reference", [1.0] * 999 + [8.0], [1.0] * 999 + [2.0], longest_at_most=4.0)
    assert (row.median_ratio, row.longest_ratio, row.kept) == (1.0, 4.0, True)


@pytest.mark.parametrize(
    "content",
    [b"", b"no gzip", gzip.compress(b""), gzip.compress(msgpack.packb([1, 2])), gzip.compress(b"\xc1")],
    ids=[
        "empty",
        "no gzip",
        "nothing packed",
        "no pairs",
        "no msgpack",
    ],  # compressed, they hold the time of day
)
def test_a_damaged_set_of_situations_is_reported(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "cornered"
    file.write_bytes(content)
    with pytest.raises(DeltaqError, match="holds no situations"):
        stored(file)


def test_situations_of_another_version_are_reported(tmp_path: Path) -> None:
    file = tmp_path / "cornered"
    file.write_bytes(gzip.compress(msgpack.packb([(msgpack.packb({"epoch": 1}), b"\x80")])))
    with pytest.raises(InvalidMessageError):
        stored(file)


@pytest.mark.long
def test_each_stored_situation_is_one_decision_near_an_obstacle(lab: LoadedCell) -> None:
    situations = stored()
    assert len(situations) == len(cornered.SEEDS) * cornered.KEPT_OF_A_SEED
    sim = Sim(lab.model, epoch=0)
    for situation in situations:
        sim.restore(situation.memory)
        outputs = sim.take(situation.request)
        [verdict] = [output.message for output in outputs if isinstance(output.message, Verdict)]
        assert verdict.outcome is not Outcome.REFUSED, verdict
        assert verdict.robot == situation.request.robot


def test_situations_are_stored_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "cornered"
    cornered.store(stored(), file)
    assert file.read_bytes() == cornered.FILE.read_bytes()


@pytest.mark.long
def test_the_slowest_decisions_of_a_run_are_found_and_repeatable(lab: LoadedCell) -> None:
    found = cornered.find(seed=3, cycles=25, kept=3)
    assert len(found) == 3
    assert [took for took, _ in found] == sorted((took for took, _ in found), reverse=True)
    row = near_obstacles([situation for _, situation in found], passes=2)
    assert "3 stored situations" in row.what
    assert "1495 pairs" in row.reference
    assert row.longest_at_most == 2.0


def test_the_telegrams_of_a_krc_at_rest_are_read_by_its_robot_server() -> None:
    loaded = LoadedCell.load("lab-4ms")
    xml = loaded.ethernet_xml("gr")
    assert xml is not None
    codec = sensor_codec(loaded.model.description, "gr", xml)
    read = [codec.decode(telegram) for telegram in standing_telegrams(loaded, "gr", 3)]
    assert [after.ipoc - before.ipoc for before, after in itertools.pairwise(read)] == [4, 4]
    home = loaded.model.robots["gr"].home
    assert read[0].q == pytest.approx(home, abs=1e-5)
