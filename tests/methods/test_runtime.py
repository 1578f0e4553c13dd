"""Truths of the measurement of seconds per submap."""

import time

import numpy as np
import pytest

from pointnetkl.methods import runtime
from pointnetkl.registration.covariance.gaussian import CovarianceError

SUBMAPS = [runtime.submap(np.zeros((4, 3)), number) for number in range(3)]


class Fake:
    """A method whose first call takes long, as if it compiled, and the others 2 ms."""

    name = "fake"

    def __init__(self, q=None):
        self.calls = []
        self.q = np.eye(2) if q is None else q

    def covariance(self, submap):
        time.sleep(0.002 if self.calls else 0.3)
        self.calls.append(submap.number)
        return self.q


def test_the_warm_up_is_called_and_not_counted():
    fake = Fake()
    timing = runtime.measure(fake, SUBMAPS)
    assert fake.calls == [0, *9 * [0, 1, 2]]  # what takes milliseconds is measured nine times, in turns
    assert 0.002 <= timing.mean_s < 0.1
    assert timing.std_s < 0.1


def test_one_submap_has_no_spread():
    assert runtime.measure(Fake(), SUBMAPS[:1]).std_s == 0


def test_nothing_to_time_on_is_refused():
    with pytest.raises(runtime.RuntimeMeasurementError, match=r"time\.submaps"):
        runtime.measure(Fake(), [])


def test_the_time_of_a_wrong_answer_is_refused():
    with pytest.raises(CovarianceError, match="fake"):
        runtime.measure(Fake(np.zeros((2, 2))), SUBMAPS)


def test_the_machine_is_described():
    machine = runtime.machine()
    assert machine["cpu"]
    assert machine["cores"] >= 1
    assert machine["threads"] == 1
    assert machine["python"].startswith("3.")
