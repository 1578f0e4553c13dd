"""The machine that a program runs on, named the same in every place."""

from pointnetkl.methods import runtime
from pointnetkl.workflow import machine


def test_times_name_the_machine_that_a_page_names():
    assert runtime.machine().items() >= machine.describe().items()


def test_a_machine_is_said_in_words():
    assert machine.in_words({"cpu": "AMD EPYC", "cores": 2}) == "AMD EPYC, 2 cores"
    assert machine.in_words({"cpu": "old", "cores": 1, "threads": 1}) == "old, 1 core"
    assert machine.in_words({}) == "an unknown machine"
