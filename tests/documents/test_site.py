"""The documentation as a site, as `make site` builds it: a dead link or a page that nothing leads to is an error."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from ran import ran

ROOT = Path(__file__).parents[2]
LOADED = re.compile(
    r'<(?:script|img|iframe)[^>]*\ssrc="([^"]*)"|<link[^>]*rel="(?:stylesheet|icon)"[^>]*\shref="([^"]*)"'
)

PAGES = {
    "index.md": "# Pages\n\n- **Tutorial**: [one](one.md)\n- **How to**: [gone](gone.md)\n",
    "one.md": "# One\n\n[two](two.md), [there](#there), [code](../src/gone.py)\n",
    "three.md": "# Three\n",
}
"""Wrong in every way."""


def build(config: Path, site: Path) -> subprocess.CompletedProcess[str]:
    return ran(
        [sys.executable, "-m", "mkdocs", "build", "-f", str(config), "-d", str(site)],
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        cwd=config.parent,
        check=False,
    )


@pytest.mark.long
def test_a_dead_link_or_an_unlinked_page_fails_the_build(tmp_path: Path) -> None:
    config = re.sub(
        r"  api:\n(    - .*\n)+", "  api: []\n", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    )
    (tmp_path / "mkdocs.yml").write_text(config, encoding="utf-8")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "site_hooks.py").symlink_to(ROOT / "docs" / "site_hooks.py")
    for name, text in PAGES.items():
        (tmp_path / "docs" / name).write_text(text, encoding="utf-8")
    done = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert done.returncode == 1
    for said in (
        "'two.md', but the target is not found",
        "'#there', but there is no such anchor",
        "'../src/gone.py', but the target is not found",
        'not included in the "nav" configuration:\n  - three.md',
        "'gone.md' is included in the 'nav' configuration, which is not found",
    ):
        assert said in done.stderr


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.nightly
def test_the_site_contains_the_python_api_and_finds_it_by_search(site: Path) -> None:
    found = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    texts = {entry["location"]: entry["text"] for entry in found}
    for module, name in [
        ("deltaq", "Robot.move_to"),
        ("deltaq_protocol.client", "connect"),
        ("deltaq_protocol.blocking", "connect"),
        ("deltaq_protocol.in_flight", "InFlight.ahead"),
        ("deltaq_protocol.messages", "Verdict"),
        ("deltaq_controllers.interface", "Controller.increment"),
        ("deltaq_experiments.training.environment", "CameraEnvironment.step"),
    ]:
        assert texts[f"api/{module}.html#{module}.{name}"]


@pytest.mark.nightly
def test_each_example_has_a_page_with_its_text(site: Path) -> None:
    assert 'href="tree/examples/with_asyncio.py.html"' in (site / "examples.html").read_text(encoding="utf-8")
    page = (site / "tree" / "examples" / "with_asyncio.py.html").read_text(encoding="utf-8")
    assert "import</span> <span" in page
    assert "asyncio" in page


@pytest.mark.nightly
def test_no_page_loads_files_from_other_hosts(site: Path) -> None:
    loaded = {
        "".join(match): page.name
        for page in site.rglob("*.html")
        for match in LOADED.findall(page.read_text(encoding="utf-8"))
    }
    assert loaded
    assert [address for address in loaded if address.startswith(("http:", "https:", "//"))] == []


def test_the_page_of_examples_names_every_example() -> None:
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    files = [
        *ROOT.glob("examples/**/*.py"),
        *ROOT.glob("examples/**/*.ipynb"),
        *ROOT.glob("clients/**/turn_a1.*"),
        *ROOT.glob("clients/*/examples/*"),
    ]
    assert len(files) > 8
    assert [file.name for file in files if f"(../{file.relative_to(ROOT)})" not in page] == []
