"""The built wheel: its version, its types, and what it does without this repository."""

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import pointnetkl

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from a copy of the sources, so that nothing is written beside them."""
    copy, out = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT / "src", copy / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", out, copy]
    subprocess.run(command, check=True, capture_output=True)
    return next(out.glob("*.whl"))


@pytest.mark.slow
def test_the_wheel_has_every_module_and_says_that_it_is_typed(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if name.startswith("pointnetkl/")}
    sources = {str(path.relative_to(ROOT / "src")) for path in (ROOT / "src/pointnetkl").rglob("*.py")}
    weights = {str(path.relative_to(ROOT / "src")) for path in (ROOT / "src/pointnetkl/weights").glob("*.pt")}
    pages = {str(path.relative_to(ROOT / "src")) for path in (ROOT / "src/pointnetkl").rglob("*.html")}
    assert packed == sources | weights | pages | {"pointnetkl/py.typed"}


@pytest.mark.slow
def test_the_wheel_can_be_imported_and_has_the_version_of_the_package(wheel: Path, tmp_path: Path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    program = "import pointnetkl, importlib.metadata as m; print(pointnetkl.__file__, m.version('pointnetkl'))"
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=tmp_path, env={}, check=True, capture_output=True, text=True)
    assert result.stdout.split() == [str(tmp_path / "pointnetkl/__init__.py"), pointnetkl.__version__]


def test_the_citation_names_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert str(citation["version"]) == pointnetkl.__version__


def test_the_newest_entry_of_the_changelog_is_this_version_and_every_entry_has_a_date():
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    entries = [re.fullmatch(r"(\d+\.\d+\.\d+) \((\d{4}-\d{2}-\d{2})\)", heading) for heading in headings]
    assert all(entries), f"write each heading as: 1.2.3 (2026-12-31); these are {headings}"
    versions = [tuple(map(int, entry[1].split("."))) for entry in entries if entry]
    assert versions == sorted(versions, reverse=True)
    assert ".".join(map(str, versions[0])) == pointnetkl.__version__


def test_the_workflow_runs_what_ci_runs_with_every_python_that_is_supported():
    job = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]["check"]
    assert job["steps"][-1]["run"] == ".ci/run"
    supported = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
    lowest, highest = (int(minor) for minor in re.fullmatch(r">=3\.(\d+),<3\.(\d+)", supported).groups())
    assert job["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in range(lowest, highest)]
