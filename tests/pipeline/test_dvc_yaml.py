"""dvc.yaml says the truth: each stage names every module and parameter it uses, and reruns only what it must."""

import ast
import re
from pathlib import Path

import pytest
import yaml

from imports import LIBRARY, ROOT, closure

STAGES = {
    name: stage.get("do", stage) for name, stage in yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"].items()
}
MODELS = yaml.safe_load((ROOT / "params.yaml").read_text())["models"]  # `${item}` is each of them
SCRIPTS = {
    name: ROOT / script[0]
    for name, stage in STAGES.items()
    if (script := re.findall(r"pipeline/\w+\.py", str(stage["cmd"])))
}


def library(stage: str) -> list[Path]:
    """Return the deps of a stage that are folders or files of the library."""
    return [ROOT / dep for dep in STAGES[stage]["deps"] if LIBRARY in (ROOT / dep).parents]


def holds(path: Path, module: Path) -> bool:
    """Whether a module is a path, or stands in it or below it."""
    return path == module or path in module.parents


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_depends_on_its_script_and_on_every_module_that_it_imports(stage: str):
    assert str(SCRIPTS[stage].relative_to(ROOT)) in STAGES[stage]["deps"]
    missing = {
        str(module.relative_to(ROOT))
        for module in closure(SCRIPTS[stage])
        if not any(holds(path, module) for path in library(stage))
    }
    assert not missing, f"add these, or their folders, to the deps of {stage} in dvc.yaml: {sorted(missing)}"


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_depends_on_no_folder_or_module_of_which_it_uses_nothing(stage: str):
    used = closure(SCRIPTS[stage])
    unused = [str(path.relative_to(ROOT)) for path in library(stage) if not any(holds(path, module) for module in used)]
    assert not unused, f"take these from the deps of {stage} in dvc.yaml, it imports nothing of them: {unused}"


@pytest.mark.parametrize("stage", SCRIPTS)
def test_a_stage_lists_two_to_six_folders_of_the_library_and_none_twice(stage: str):
    listed = library(stage)
    most = 10 if stage == "correct" else 6  # it is a command too, from raw files to maps
    assert 2 <= len(listed) <= most, f"{stage} lists {len(listed)} paths of the library"
    assert all(path.is_dir() for path in listed), "list folders: a file that moves changes dvc.yaml"
    assert not [path for path in listed for other in listed if other in path.parents], "a folder holds another"


def test_every_script_but_that_of_the_authors_arrays_is_a_stage():
    scripts = {path.stem for path in (ROOT / "pipeline").glob("*.py")}
    assert scripts - {"authors"} == {path.stem for path in SCRIPTS.values()}


def test_dvc_s_files_stay_short_because_dvc_reads_and_writes_them_after_every_stage():
    assert len((ROOT / "dvc.yaml").read_text().splitlines()) < 520
    # a study of more surveys has as many lines a stage as the demo
    text = (ROOT / "dvc.lock").read_text()
    stages = yaml.load(text, Loader=yaml.CSafeLoader)["stages"]
    assert len(text.splitlines()) < 80 * len(stages)


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
        products = [out for name in reached for out in outs(name)]
        more = {name for name in STAGES if name not in reached and any(reads(name, out) for out in products)}
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
    assert rerun_by("models") == {"train", "predict", "calibrate", "close", "slam", "stress", "time", "report"}


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
        "close",
        "correct",
        "stress",
    }
    others = {
        name
        for name in STAGES
        if name not in per_survey and any(reads(name, out) for stage in per_survey for out in outs(stage))
    }
    assert others == {"report"}


def test_every_stage_says_what_it_does():
    assert all(stage.get("desc") for stage in STAGES.values())


def test_every_section_of_a_stage_that_draws_has_its_own_seed():
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    sections = {name: params[name] for name in STAGES if name not in ("simulate", "train")}
    assert {name for name, section in sections.items() if "seed" not in section} == {"correct", "ingest", "voxelise"}
    assert all("seed" in survey for survey in params["simulate"].values())
    assert all("seed" in model["train"] for model in params["models"].values())
    assert set(params["study"]["models"]) <= set(params["models"])


def test_the_demo_s_scale_is_what_stands_in_params_yaml():
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    for change in (ROOT / "scales/demo").read_text().replace("-S ", "").split():
        name, value = change.split("=")
        standing = params
        for key in name.split("."):
            standing = standing[key]
        assert standing == yaml.safe_load(value), name
