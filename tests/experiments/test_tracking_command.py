"""`deltaq experiment tracking`, `deltaq bench`: what a user gets from them."""

import json

import pytest
from commands import deltaq

from deltaq_testing.private_cell import write_private_cell


def run(*arguments):
    done = deltaq(*arguments)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.nightly
def test_the_paper_keeps_a_leader_of_15_cm_a_second_in_view_within_a_degree_and_two_centimetres():
    status, out, error = run(
        "experiment", "tracking", "--controller", "paper", "--leader-speed-m-s", "0.15", "--json"
    )  # fmt: skip
    assert status == 0, error
    report = json.loads(out)
    assert report["cycles"] == 3333
    assert report["angle_deg"]["max"] <= 1.0
    assert report["distance_m"]["max"] <= 0.021
    assert set(report["limits"].values()) == {0}
    assert report["clearance_m"]["min"] >= 0.05
    assert report["gate"]["refused"] == 0


@pytest.mark.nightly
@pytest.mark.live
def test_live_tracking_works_over_zenoh_and_udp(tmp_path):
    """Figures depend on the machine; what must hold on any is that both robots work and nothing is passed."""
    cell = write_private_cell(tmp_path)
    status, out, error = run(
        "experiment", "tracking", "--live", "--duration-s", "10", "--cell", str(cell), "--json"
    )
    assert status in (0, 1), error  # 1: a cycle that the machine lost shows as a jump in acceleration
    report = json.loads(out)
    assert report["limits"]["position_violations"] == 0
    assert report["limits"]["velocity_violations"] == 0
    assert report["clearance_m"]["min"] >= 0.05
    assert report["gate"]["admitted"] > 500
    assert report["angle_deg"]["rms"] < 5.0


@pytest.mark.live
@pytest.mark.nightly
@pytest.mark.parametrize("name", ["approach", "zoom", "collision"])
def test_every_experiment_runs_live_and_draws(name, tmp_path):
    """An approach goes to each of its starts first, a zoom turns the distance, a collision attacks."""
    cell, figure = write_private_cell(tmp_path), tmp_path / "figure.png"
    status, out, error = run(
        "experiment", name, "--live", "--controller", "qp", "--duration-s", "8", "--cell", str(cell), "--json",
        "--figure", str(figure),
    )  # fmt: skip
    assert status in (0, 1), error  # 1: a cycle that the machine lost shows as a jump in acceleration
    report = json.loads(out)
    assert report["live"]
    assert report["limits"]["position_violations"] == report["limits"]["velocity_violations"] == 0
    assert report["clearance_m"]["min"] >= 0.05
    assert figure.stat().st_size > 10_000
    if name == "approach":
        assert [start["start_deg"] for start in report["starts"]] == pytest.approx([83, 134, 145], abs=2.0)
    if name == "zoom":
        assert [plateau["desired_m"] for plateau in report["plateaus"]] == [1.25, 1.0, 1.5, 0.8, 2.6]
    if name == "collision":
        assert report["contacts"] == 0


@pytest.mark.live
@pytest.mark.nightly
def test_bench_reports_ratios_to_references_of_the_same_run():
    status, out, error = run("bench", "--cycles", "20", "--json")
    assert status in (0, 1), error
    table = json.loads(out)
    whats = [row["what"].split(",")[0] for row in table["rows"]]
    assert whats == [
        "an RSI reply",
        "an RSI telegram read and its reply written",
        "the 7 messages of a cycle packed and unpacked",
        "one gate decision",
        "one gate decision near obstacles",
    ]
    for row in table["rows"]:
        assert row["median_ratio"] == pytest.approx(row["median_us"] / row["reference_us"])
    assert "1495 pairs" in table["rows"][-1]["reference"]
    bounded = {row["what"].split(",")[0] for row in table["rows"] if row["kept"] is not None}
    assert bounded == {"one gate decision", "one gate decision near obstacles"}
    assert table["good"] == all(row["kept"] is not False for row in table["rows"]) == (status == 0)
