"""The lines of data/grids/README.md make a survey over a real grid, where they are put as it says."""

import re
from pathlib import Path

import pytest

from pointnetkl import simulation
from pointnetkl.workflow import parameters, study

ROOT = Path(__file__).parents[2]


def blocks() -> list[str]:
    """Return the entry of section simulate and the line of study.test that the page has."""
    return re.findall(r"```yaml\n(.*?)```", (ROOT / "data/grids/README.md").read_text(), re.DOTALL)


@pytest.fixture
def params(tmp_path: Path) -> Path:
    """The project's parameters with the page's lines."""
    entry, line = blocks()
    text = (ROOT / "params.yaml").read_text()
    path = tmp_path / "params.yaml"
    path.write_text(
        text.replace("\nvehicles:", f"\n{entry}vehicles:").replace("  test: &test\n", f"  test: &test\n{line}")
    )
    return path


def test_the_survey_joins_the_test_surveys(params: Path):
    whole = study.read(params)
    assert list(whole.test) == ["scituate", "borno_8", "thwaites_11"]
    assert whole.surveys["scituate"] == whole.test["scituate"]


def test_it_is_simulated_over_the_grid(params: Path):
    settings = parameters.read(params, "simulate.scituate", simulation.Settings)
    assert settings.grid == "data/grids/scituate_5m.tif"
    assert f"`{Path(settings.grid).name}`" in (ROOT / "data/grids/README.md").read_text()


@pytest.mark.parametrize("scale", ["paper", "smoke"])
def test_its_scales_change_numbers_that_it_has(params: Path, scale: str):
    for change in (ROOT / "scales/with_grid" / scale).read_text().replace("-S ", "").split():
        section, key = change.split("=")[0].rsplit(".", 1)
        assert key in parameters.read(params, section, dict)
