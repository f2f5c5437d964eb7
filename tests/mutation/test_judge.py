"""The judge of mutants, on the smallest module that it is given."""

import pytest
from judge_mutants import main


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_every_mutant_of_the_brake_is_killed_or_explained() -> None:
    assert main(1, ["deltaq_protocol.brake"]) == 0


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_an_unexplained_survivor_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("judge_mutants.explained", lambda: {})
    assert main(1, ["deltaq_protocol.brake"]) == 1
