"""The order of test files, and how many processes the stages that they run may start."""

import os

import pytest

os.environ.setdefault("POINTNETKL_WORKERS", "1")  # tests of several workers ask for them; others would wait for starts

_LONG = ("test_pipeline.py", "test_pipeline_yaw.py", "test_label_stage.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take minutes, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: _LONG.index(item.path.name) if item.path.name in _LONG else len(_LONG))
