"""The answer does not depend on how many work on it."""

import time

import numpy as np
import pytest

from pointnetkl import compute
from pointnetkl.compute import ComputeError


def draw(number: int) -> float:
    time.sleep(0.002 * (number % 3))  # the later ones may be done first
    return float(np.random.default_rng([5, number]).standard_normal())


def test_the_answer_does_not_depend_on_the_number_of_workers(monkeypatch: pytest.MonkeyPatch):
    expected = [draw(number) for number in range(20)]
    for workers in ("1", "2", "7"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        assert compute.over(draw, range(20), "draw") == expected


def test_nothing_to_do_gives_nothing():
    assert compute.over(draw, [], "draw") == []


@pytest.mark.parametrize("wrong", ["", "0", "-1", "two", "1.5", "²"])
def test_a_number_of_workers_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, wrong: str):
    monkeypatch.setenv("POINTNETKL_WORKERS", wrong)
    with pytest.raises(ComputeError, match=r"POINTNETKL_WORKERS is .*, must be a whole number of at least 1"):
        compute.over(draw, range(3), "draw")


def test_without_a_wish_there_is_at_least_one_worker(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("POINTNETKL_WORKERS", raising=False)
    assert compute.workers() >= 1


def test_the_first_failure_ends_the_work(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POINTNETKL_WORKERS", "1")
    done = []

    def fail_at_once(number: int) -> None:
        done.append(number)
        time.sleep(0.01)
        raise ComputeError("no")

    with pytest.raises(ComputeError, match="no"):
        compute.over(fail_at_once, range(1000), "fail")
    assert len(done) < 100
