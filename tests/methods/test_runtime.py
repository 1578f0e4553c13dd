"""Truths of the measurement of seconds per submap."""

import numpy as np
import pytest

from pointnetkl.methods import runtime
from pointnetkl.registration.covariance.gaussian import CovarianceError

SUBMAPS = [runtime.submap(np.zeros((4, 3)), number) for number in range(3)]


class Fake:
    """A method whose first call takes 300 s, as if it compiled, and the others 2 ms, on a clock of its own."""

    name = "fake"

    def __init__(self, q=None):
        self.calls = []
        self.q = np.eye(2) if q is None else q
        self.now_s = 0.0

    def clock(self):
        return self.now_s

    def covariance(self, submap):
        self.now_s += 0.002 if self.calls else 300.0
        self.calls.append(submap.number)
        return self.q


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    method = Fake()
    monkeypatch.setattr(runtime.time, "perf_counter", method.clock)
    return method


def test_the_warm_up_is_called_and_not_counted(fake: Fake):
    timing = runtime.measure(fake, SUBMAPS)
    assert fake.calls == [0, *9 * [0, 1, 2]]  # what takes milliseconds is measured nine times, in turns
    assert timing.mean_s == pytest.approx(0.002)
    assert timing.std_s == pytest.approx(0, abs=1e-9)


def test_one_submap_has_no_spread(fake: Fake):
    assert runtime.measure(fake, SUBMAPS[:1]).std_s == 0


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
