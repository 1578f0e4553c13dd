"""A model's card: what it is for, its training data, its quality and its limits."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pointnetkl.reporting.results import Folders
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.study import StudySurvey

_INPUTS = {
    "pointnetkl": (
        "`points` (clouds, points, 3), float32: zero mean, scaled to a largest norm of 1, one mean point per voxel of"
        " {voxel:g}; `radius` (clouds,), float32: the largest norm before scaling, in metres"
        " (`pointnetkl.surveys.voxel.canonical` returns both)"
    ),
    "mean_field": (
        "`description` (clouds, numbers), float32: the result of `model.describe(points)` of this package's model; the"
        " physics are not in the ONNX file"
    ),
}
_CHOICE = {
    "pointnetkl": "This kind is the paper's.",
    "mean_field": (
        "`docs/network.md` says why it is of this kind,\n"
        "and which of its numbers were chosen while looking at those surveys."
    ),
}
_LIMITS = {
    "pointnetkl": "",
    "mean_field": (
        "- It describes registrations with a copy of the same points (`label.copy: same`). Against labels of `split`\n"
        "  it is too confident wherever only its own points hold a copy in place.\n"
    ),
}
_NEEDED = ("model", "labels", "kl", "kl_floor0", "submaps", "floor_m2", "flagged")  # of a summary


class ModelCardError(PointNetKLError):
    """A training's summary lacks a part of the card, or is of other surveys."""


def read(path: Path) -> dict[str, Any]:
    """Read the summary of a model's training.

    Raises:
        ModelCardError: the summary lacks a part.
        ArtifactError: the file is missing or damaged.
    """
    summary = artifacts.read_json(path)
    if missing := [key for key in _NEEDED if key not in summary]:
        raise ModelCardError(f"{path}: has no {missing[0]}; run dvc repro train@{path.stem}")
    return summary


def files(folders: Folders) -> dict[str, bytes]:
    """Return the card of each model of the study, by path below the folder of reports.

    Raises:
        ModelCardError: a summary lacks a part, or is of another training.
    """
    summaries = {name: read(folders.reports / f"train/{name}.json") for name in folders.study.models}
    return {
        f"models/{name}.md": text(name, summary, folders.study.train).encode() for name, summary in summaries.items()
    }


def text(name: str, summary: Mapping[str, Any], surveys: Mapping[str, StudySurvey]) -> str:
    """Return the card of a model, in Markdown, from its training's summary and the lines of its training surveys.

    Raises:
        ModelCardError: the model was trained on other surveys.
    """
    if set(surveys) != set(summary["labels"]["submaps"]):
        trained = ", ".join(summary["labels"]["submaps"])
        raise ModelCardError(f"{name}: was trained on {trained}, unlike study.train; run dvc repro train@{name}")
    model = summary["model"]
    kind, dimensions = model["kind"], model["dimensions"]
    units = "m²" if dimensions == 2 else "m², m rad and rad²"
    return f"""# {name}

Predicts the covariance Q of a submap's registration by GICP from its points alone, to weight a loop closure.
Trained by `dvc repro train@{name}`; stage `report` writes this page.

| | |
|---|---|
| kind | `{kind}`, {model["weights"]} weights |
| in | a submap's points (n, 3), metres, z up, in any frame with these axes |
| out | Q ({dimensions}, {dimensions}), {units}, in the points' frame |
| use | `CovarianceEstimator.load("models/{name}.pt").predict(points)`, or `python -m pointnetkl predict` |
| ONNX in | {_INPUTS[kind].format(voxel=model["voxel"])} |
| ONNX out | `covariance` (clouds, {dimensions}, {dimensions}) |

## Trained on

{_surveys(surveys, summary["labels"]["submaps"])}

`reports/tables/table_1.md` says which surveys are simulated. {_labels(summary["labels"])}

## How good

{_measures(summary)}

Validation submaps are neighbours of training submaps. What counts are surveys that the training has not seen:
`reports/tables/kl.csv` and `calibration.csv` have these, beside the other methods. {_CHOICE[kind]}

## Limits

- Q is of registrations with the labels' starts, noise and settings; another spread of starts, another sensor noise or
  other settings of the registration give another Q.
- It holds for submaps like those above in spacing, extent and relief. `judge(points)` returns how far a submap is
  from them. `is_novel` is set beyond the distance below which 99 % of the submaps of a left-out survey stay
  (the median over such surveys); here it is set for {_share(summary, "training")} of the training and
  {_share(summary, "validation")} of the validation submaps.
  Q may be wrong for a submap without this flag too, because the flag depends only on how its points look.
{_LIMITS[kind]}- Where registrations end in one of several basins, Q is their mean square error, and no single Gaussian
  fits them.
"""


def _surveys(surveys: Mapping[str, StudySurvey], submaps: Mapping[str, int]) -> str:
    rows = [
        f"| {name} | `{line.raw}` | {submaps[name]} | {line.submap_length_m:g} | {line.point_spacing_m:g}"
        f" | {line.label_runs} |"
        for name, line in surveys.items()
    ]
    head = [
        "| survey | raw pings | submaps | submap length, m | point spacing, m | runs per label |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *rows])


def _labels(labels: Mapping[str, Any]) -> str:
    label, registration = labels["label"], labels["registration"]
    yaw = "" if registration["dof"] == "xy" else f", yaw from N(0, ({label['prior_yaw_sigma_rad']:g} rad)²)"
    copy = "a copy of the submap" if label["copy"] == "same" else "one half of the submap's pings onto the other"
    return (
        f"A label is the mean square error of that many registrations of {copy}, from starts drawn from"
        f" N(0, {label['prior_variance_m2']:g} m²) in x and y{yaw}, with noise of {label['noise_sigma_m']:g} m on each"
        f" coordinate; matches within {registration['max_distance_m']:g} m."
    )


def _measures(summary: Mapping[str, Any]) -> str:
    rows = [
        f"| {part} | {summary['submaps'][part]} | {summary['kl'][part]:g} | {summary['kl_floor0'][part]:g} |"
        for part in ("training", "validation")
    ]
    head = [
        f"| mean KL(label \\|\\| Q), nats | submaps | {summary['floor_m2']:g} m² added to both | nothing added |",
        "|---|---|---|---|",
    ]
    return "\n".join([*head, *rows])


def _share(summary: Mapping[str, Any], part: str) -> str:
    return f"{100 * summary['flagged'][part]:.3g} %"
