"""The order of test files."""

import pytest

_LONG = ("test_pipeline.py", "test_pipeline_yaw.py", "test_label_stage.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take minutes, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: _LONG.index(item.path.name) if item.path.name in _LONG else len(_LONG))
