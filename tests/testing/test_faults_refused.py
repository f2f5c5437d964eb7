"""Faults that cannot be had the way they were asked for: it is told, and no process is started."""

import pytest

from deltaq_cell.load import load_cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_testing.faults.catalogue import UnknownFaultError, fault_named
from deltaq_testing.faults.panel import inject
from deltaq_testing.faults.virtual import run_table
from deltaq_testing.private_cell import write_private_cell
from studies.live_faults.run import live_table


def test_a_fault_beyond_the_panel_is_refused_without_a_request():
    with pytest.raises(UnknownFaultError, match=r"sim-dead cannot be injected .* allowed are krc-cut, "):
        inject(fault_named("sim-dead"), load_cell("lab"), "fr", 0.0)


@pytest.mark.parametrize(
    ("name", "run", "way"),
    [
        ("sim-slow", live_table, "live"),
        ("hli-clock-back", live_table, "live"),
        ("hli-sim-broken", run_table, "virtual"),
        ("wall-clock-back", run_table, "virtual"),
        ("krc-server-cut", run_table, "virtual"),
    ],
)
def test_a_fault_that_cannot_be_injected_this_way_is_reported(name, run, way):
    with pytest.raises(UnknownFaultError, match=f"none of these faults .*{way}"):
        run("lab", "fr", faults=[fault_named(name)])


def test_a_cell_that_is_not_running_is_reported(tmp_path):
    description = load_cell(write_private_cell(tmp_path))
    with pytest.raises(ServiceUnreachableError):
        inject(fault_named("krc-hiccup"), description, "fr", 0.0)
