"""The cell of two sites: what the page prints is what the test runs, and both halves are what each site starts."""

import re
from pathlib import Path

import pytest
from installed import ROOT

from deltaq_cell.check import check_cell
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.services import cell_services, console_service, select
from deltaq_deploy.launch.systemd import units
from studies.two_sites.sites import write_cell

PAGE = ROOT / "docs" / "how-to" / "two-sites.md"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return write_cell(tmp_path)


def test_the_page_prints_the_cell_that_the_test_runs(cell: Path) -> None:
    (printed,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert printed == cell.read_text(encoding="utf-8")


def test_the_cell_passes_its_check(cell: Path) -> None:
    report = check_cell(cell)
    assert report.ok, report.errors


def test_the_sites_together_have_all_services_of_the_cell(cell: Path) -> None:
    description = load_cell(str(cell))
    services = cell_services(description, str(cell), real=True)
    services = (*services, console_service(description, str(cell), services))
    halves = re.findall(
        r"^deltaq up --cell two-sites.yaml (?:--real )?--only (\S+)", PAGE.read_text(), re.MULTILINE
    )
    chosen = [service for half in halves for service in select(services, half.split(","))]
    assert sorted(service.name for service in chosen) == sorted(service.name for service in services)
    for half in halves:
        assert units(str(cell), real=True, only=half.split(","))
