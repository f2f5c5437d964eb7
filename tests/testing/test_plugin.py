"""The plug-in, as pytest runs it for somebody who tests a controller."""

import sys

import pytest
from ran import ran

# pytester forgets what a run imported, and C extensions cannot be imported twice
import deltaq_testing.strategies
import deltaq_testing.virtual  # noqa: F401

PLUGIN = ("-p", "deltaq_testing.plugin", "-p", "no:cacheprovider", "-p", "no:asyncio")

CONTROLLER = """
from deltaq_testing.schedule import fault

STEP = 0.004

def open_loop(state):
    return [STEP if state.cycle < 138 else 0.0, 0, 0, 0, 0, 0]
"""


@pytest.fixture
def run(pytester):
    def run(text, *options):
        pytester.makepyfile(CONTROLLER + text)
        return pytester.runpytest(*PLUGIN, *options)

    return run


@pytest.mark.long
def test_a_test_passes_if_the_goal_is_kept_and_otherwise_lists_the_faults(run):
    result = run(
        """
def test_good(virtual_cell):
    virtual_cell.drive(open_loop)
    virtual_cell.run(1.2)
    assert virtual_cell.kept_clear()
    assert virtual_cell.ended_at([x + y for x, y in zip(
        virtual_cell.model.robots["fr"].home, [70 * STEP, 0, 0, 0, 0, 0])], within=0.01)

def test_planted_bug(virtual_cell):
    virtual_cell.drive(open_loop)
    virtual_cell.suffer(fault("link_cut", at_s=0.2, for_s=0.1))
    virtual_cell.run(1.2)
    assert virtual_cell.ended_at([x + y for x, y in zip(
        virtual_cell.model.robots["fr"].home, [70 * STEP, 0, 0, 0, 0, 0])], within=0.01)
"""
    )
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "*where <no: a1 is 0.0* off; at most 0.01 were allowed> = ended_at*",
            "*faults in this run*",
            "cell lab, robot fr, seed 0, 1.200 s",
            "*0.204 s  controller-hli-cut begins: the wire controller-hli carries nothing",
            "*0.300 s  controller-hli-cut ends",
        ]
    )


@pytest.mark.long
def test_each_test_has_a_fresh_cell_chosen_by_its_marker(run):
    result = run(
        """
import pytest

@pytest.mark.parametrize("time", [1, 2])
@pytest.mark.deltaq(robot="gr", seed=7)
def test_fresh(virtual_cell, time):
    assert (virtual_cell.robot, virtual_cell.seed, virtual_cell.time_s) == ("gr", 7, 0)
    virtual_cell.drive(lambda state: [1e-4] * len(state.q))
    virtual_cell.run(0.1)

def test_unmarked(virtual_cell, new_virtual_cell):
    assert (virtual_cell.robot, virtual_cell.seed) == ("fr", 5)
    assert new_virtual_cell(seed=1).seed == 1
""",
        "--deltaq-seed=5",
    )
    result.assert_outcomes(passed=3)


@pytest.mark.parametrize(
    ("marker", "told"),
    [
        ("robot='r2'", "no cell could be made: no robot 'r2' in cell lab; it has fr, gr"),
        ("cell='nowhere'", "no cell could be made: *nowhere*"),
        ("cell='dawm'", "no cell could be made: robots.dawm.driver is 'kinematic'; faults are *"),
        ("colour='red'", "no cell could be made: *unexpected keyword argument 'colour'"),
        ("seed=-1", "no cell could be made: seed must be 0 or more, got -1"),
    ],
)
def test_an_unavailable_cell_is_an_error_of_one_line(run, marker, told):
    result = run(
        f"""
import pytest

@pytest.mark.deltaq({marker})
def test_nothing(virtual_cell):
    pass
"""
    )
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines([told])
    result.stdout.no_fnmatch_line("*Traceback*")
    result.stdout.no_fnmatch_line("*plugin.py:*")


@pytest.mark.nightly
def test_hypothesis_finds_the_shortest_schedule_that_fails(run):
    result = run(
        """
from hypothesis import HealthCheck, given, settings
from deltaq_testing.strategies import schedules

@settings(max_examples=20, deadline=None, derandomize=True, database=None)
@given(faults=schedules(within_s=0.24, longest_s=0.12, names=["krc_duplicating", "link_cut"]))
def test_goal(new_virtual_cell, faults):
    cell = new_virtual_cell()
    cell.drive(open_loop)
    cell.suffer(*faults)
    cell.run(0.3)
    assert cell.verdicts["admitted"] >= 20
"""
    )
    result.assert_outcomes(failed=1)
    # one fault, of the one kind that loses increments, and no more cycles than it takes to lose enough of them
    result.stdout.fnmatch_lines(['*faults=(fault("controller-hli-cut", at_s=0, for_s=0.036),),*'])


def test_the_plugin_imports_nothing_if_no_test_uses_a_cell():
    listed = "import sys, deltaq_testing.plugin; print([m for m in sys.modules if m.startswith('deltaq')])"
    told = ran([sys.executable, "-c", listed])
    assert told.stdout.strip() == "['deltaq_testing', 'deltaq_testing.plugin']"
