"""dvc.yaml says the truth: each stage names every module and parameter it uses, and reruns only what it must."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
STAGES = {
    name: stage.get("do", stage) for name, stage in yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"].items()
}
MODELS = yaml.safe_load((ROOT / "params.yaml").read_text())["models"]  # `${item}` is each of them
SCRIPTS = {name: ROOT / "pipeline" / f"{name}.py" for name in STAGES if name != "gather"}


def imported(file: Path) -> Iterator[Path]:
    """Yield the project's modules that a file imports, directly."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [node.module]
        else:
            continue
        for name in names:
            yield from module_files(name)


def module_files(name: str) -> Iterator[Path]:
    """Yield the files that importing a dotted name of this package runs, but for the package's own: it imports none."""
    parts = name.split(".")
    if parts[0] != "pointnetkl":
        return
    for depth in range(2, len(parts) + 1):
        path = SOURCE.joinpath(*parts[:depth])
        if path.with_suffix(".py").exists():
            yield path.with_suffix(".py")
        elif (path / "__init__.py").exists():
            yield path / "__init__.py"


def closure(script: Path) -> set[Path]:
    """Return every module of the project that running a script imports."""
    seen: set[Path] = set()
    waiting = [script]
    while waiting:
        for module in imported(waiting.pop()):
            if module not in seen:
                seen.add(module)
                waiting.append(module)
    return {module for module in seen if holds_code(module)}


def holds_code(module: Path) -> bool:
    """Whether a module is more than the docstring (and the version) that makes a folder a package."""
    return any(not isinstance(node, ast.Expr | ast.Assign) for node in ast.parse(module.read_text()).body)


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_depends_on_every_module_that_it_imports(stage: str):
    named = [ROOT / dep for dep in STAGES[stage]["deps"] if not dep.startswith(("data", "$"))]
    missing = {
        str(module.relative_to(ROOT))
        for module in closure(SCRIPTS[stage])
        if not any(module == name or name in module.parents for name in named)
    }
    assert not missing, f"add to the deps of {stage} in dvc.yaml: {sorted(missing)}"


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_depends_on_no_module_that_it_does_not_use(stage: str):
    used = closure(SCRIPTS[stage]) | {SCRIPTS[stage]}
    for dep in STAGES[stage]["deps"]:
        path = ROOT / dep
        if path.suffix == ".py":
            assert path in used, f"{dep} in the deps of {stage} is not imported there"
        elif path.is_dir() and SOURCE in path.parents:
            assert any(path in module.parents for module in used), dep


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_names_every_section_of_the_parameters_that_it_reads(stage: str):
    named = [param.split(".")[0] for param in STAGES[stage].get("params", [])]
    tree = ast.parse(SCRIPTS[stage].read_text())
    calls = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "parameters.read"
    ]
    for call in calls:
        section = ast.unparse(call.args[1]).lstrip("f").strip("'\"").split(".")[0]
        assert section in named, f"{stage} reads {section} but dvc.yaml does not name it in params"


def downstream(first: set[str]) -> set[str]:
    """Return the stages that run again when the given ones make something else."""
    reached = set(first)
    while True:
        made = [out for name in reached for out in outs(name)]
        more = {name for name in STAGES if name not in reached and any(reads(name, out) for out in made)}
        if not more:
            return reached
        reached |= more


def outs(stage: str) -> list[str]:
    """Return the paths that a stage makes."""
    return [
        path.replace("${item}", model)
        for kind in ("outs", "metrics", "plots")
        for out in STAGES[stage].get(kind, [])
        for path in ([out] if isinstance(out, str) else list(out))
        for model in MODELS
    ]


def reads(stage: str, out: str) -> bool:
    """Whether a stage depends on a path, or on a folder that holds it (`${item.raw}` is a raw survey)."""
    deps = [
        dep.replace("${item.raw}", "data/raw/${key}").replace("${item.truth}", "data/truth/${key}.parquet")
        for dep in STAGES[stage]["deps"]
    ]
    return any(out == dep or out.startswith(f"{dep}/") for dep in deps)


def rerun_by(section: str) -> set[str]:
    """Return the stages that run again when a section of the parameters changes."""
    return downstream({n for n, s in STAGES.items() if any(p.split(".")[0] == section for p in s.get("params", []))})


def test_changing_slam_reruns_slam_stress_and_report_only():
    assert rerun_by("slam") == {"slam", "stress", "report"}


def test_changing_a_model_neither_relabels_nor_reestimates():
    assert rerun_by("models") == {"train", "predict", "calibrate", "slam", "stress", "time", "report"}


def test_changing_label_does_not_rerun_simulate_to_voxelise():
    assert rerun_by("label").isdisjoint({"simulate", "ingest", "segment", "voxelise"})


def test_changing_the_report_reruns_the_report_only():
    assert rerun_by("report") == {"report"}


def test_a_new_test_survey_reaches_only_its_own_stages_and_the_report():
    per_survey = {
        "simulate",
        "ingest",
        "segment",
        "voxelise",
        "label",
        "vary",
        "estimate",
        "predict",
        "graph",
        "slam",
        "calibrate",
        "stress",
    }
    gathering = {
        name
        for name in STAGES
        if name not in per_survey | {"gather"} and any(reads(name, out) for stage in per_survey for out in outs(stage))
    }
    assert gathering == {"report"}


def test_every_stage_says_what_it_does():
    assert all(stage.get("desc") for stage in STAGES.values())


def test_every_section_of_a_stage_has_its_own_seed():
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    sections = {name: params[name] for name in STAGES if name not in ("simulate", "gather", "train")}
    assert all("seed" in section for section in sections.values())
    assert all("seed" in survey for survey in params["simulate"].values())
    assert all("seed" in model["train"] for model in params["models"].values())
    assert set(params["study"]["models"]) <= set(params["models"])


@pytest.mark.parametrize("scale", ["demo", "with_grid/demo"])
def test_the_demo_s_scale_is_what_stands_in_params_yaml(scale: str):
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    for change in (ROOT / "scales" / scale).read_text().replace("-S ", "").split():
        name, value = change.split("=")
        standing = params
        for key in name.split("."):
            standing = standing[key]
        assert standing == yaml.safe_load(value), name
