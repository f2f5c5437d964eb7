"""Faults that cannot be had the way they were asked for: it is told, and no process is started."""

import pytest

from deltaq_cell.load import load_cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_testing.faults.catalogue import UnknownFaultError, fault_named
from deltaq_testing.faults.clocks import NoCompilerError
from deltaq_testing.faults.panel import inject
from deltaq_testing.faults.table import run_table
from deltaq_testing.private_cell import write_private_cell


def test_clocks_cannot_be_set_without_a_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NoCompilerError, match="leave out the faults of clocks"):
        run_table(write_private_cell(tmp_path), "fr", faults=[fault_named("wall-clock-drift")], live=True)


def test_a_fault_that_no_panel_can_inject_is_refused_before_anything_is_asked():
    with pytest.raises(UnknownFaultError, match=r"sim-dead cannot be injected .* allowed are krc-cut, "):
        inject(fault_named("sim-dead"), load_cell("lab"), "fr", 0.0)


@pytest.mark.parametrize(
    ("name", "live", "way"),
    [
        ("sim-slow", True, "live"),
        ("hli-clock-back", True, "live"),
        ("hli-sim-broken", False, "virtual"),
        ("wall-clock-back", False, "virtual"),
        ("krc-server-cut", False, "virtual"),
    ],
)
def test_a_fault_that_cannot_be_had_this_way_is_told(name, live, way):
    with pytest.raises(UnknownFaultError, match=f"can be had .*{way}"):
        run_table("lab", "fr", faults=[fault_named(name)], live=live)


def test_a_cell_that_is_not_up_is_told(tmp_path):
    description = load_cell(write_private_cell(tmp_path))
    with pytest.raises(ServiceUnreachableError):
        inject(fault_named("krc-hiccup"), description, "fr", 0.0)
