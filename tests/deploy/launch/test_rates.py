import pytest

from deltaq_deploy.launch.rates import percentile, rate_of


def test_evenly_spaced_messages_have_one_period() -> None:
    rate = rate_of([0.0, 0.5, 1.0, 1.5])
    assert rate.count == 4
    assert (rate.rate_hz, rate.period_median_s, rate.period_p99_s, rate.period_max_s) == (2.0, 0.5, 0.5, 0.5)


def test_one_late_message_changes_only_the_longest_period() -> None:
    rate = rate_of([0.0, 1.0, 2.0, 5.0, 6.0])
    assert rate.period_median_s == 1.0
    assert rate.period_max_s == 3.0


@pytest.mark.parametrize("times_s", [[], [1.0]])
def test_fewer_than_two_messages_have_no_rate(times_s: list[float]) -> None:
    assert rate_of(times_s).rate_hz is None


def test_simultaneous_messages_have_no_rate() -> None:
    assert rate_of([1.0, 1.0]).rate_hz is None


def test_a_percentile_is_the_nearest_rank() -> None:
    assert percentile([1.0, 2.0, 3.0, 4.0], 0.5) == 2.0
    assert percentile([1.0, 2.0, 3.0, 4.0], 0.99) == 4.0
    assert percentile([1.0], 0.0) == 1.0
