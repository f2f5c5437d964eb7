"""The environments that documents and packaging are tested in, made once."""

from __future__ import annotations

import pytest
from installed import Installed, build_wheel, install


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def bare(wheel, tmp_path_factory: pytest.TempPathFactory) -> Installed:  # type: ignore[no-untyped-def]
    """What `pip install deltaq` gives."""
    return install(wheel, tmp_path_factory.mktemp("bare") / "venv")


@pytest.fixture(scope="session")
def complete(wheel, tmp_path_factory: pytest.TempPathFactory) -> Installed:  # type: ignore[no-untyped-def]
    """What `pip install 'deltaq[all]'` gives."""
    return install(wheel, tmp_path_factory.mktemp("all") / "venv", "all")
