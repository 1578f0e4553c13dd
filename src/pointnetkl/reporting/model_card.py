"""A model's card: what the model was made from, how good it is, what it is for and where it ends."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pointnetkl.reporting.results import Folders
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.study import StudySurvey

_INPUTS = {
    "pointnetkl": (
        "`points` (clouds, points, 3), float32: zero mean, scaled to a largest norm of 1, one mean point a voxel of"
        " {voxel:g}; `radius` (clouds,), float32: the largest norm before, in metres"
        " (`pointnetkl.surveys.voxel.canonical` gives both)"
    ),
    "mean_field": (
        "`description` (clouds, numbers), float32: what `model.describe(points)` of this package's model gives; the"
        " physics are not in the ONNX file"
    ),
}
_CHOICE = {
    "pointnetkl": "It is the paper's.",
    "mean_field": "Why this kind, and which of its numbers were chosen with those surveys in sight: `docs/network.md`.",
}
_LIMITS = {
    "pointnetkl": "",
    "mean_field": (
        "- What it knows of registration is of copies of the very points (`label.copy: same`). Against labels of\n"
        "  `split` it is too confident wherever points alone hold a copy.\n"
    ),
}
_NEEDED = ("model", "labels", "kl", "kl_floor0", "submaps", "floor_m2", "flagged")  # of a summary


class ModelCardError(PointNetKLError):
    """A training's summary does not say what the card tells."""


def read(path: Path) -> dict[str, Any]:
    """Read what stage train says of a model in its summary.

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
    return {f"models/{name}.md": text(name, each, folders.study.train).encode() for name, each in summaries.items()}


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

The covariance Q of a submap's registration by GICP, from its points alone: for the weight of a loop closure.
Trained by `dvc repro train@{name}`; stage `report` writes this page.

| | |
|---|---|
| kind | `{kind}`, {model["weights"]} weights |
| in | a submap's points (n, 3), metres, z up, in any frame with these axes |
| out | Q ({dimensions}, {dimensions}), {units}, in the points' frame |
| use | `CovarianceEstimator.load("{name}.pt").predict(points)`, or `python -m pointnetkl predict` |
| ONNX in | {_INPUTS[kind].format(voxel=model["voxel"])} |
| ONNX out | `covariance` (clouds, {dimensions}, {dimensions}) |

## Trained on

{_surveys(surveys, summary["labels"]["submaps"])}

`reports/tables/table_1.md` says which surveys are simulated. {_labels(summary["labels"])}

## How good

{_measures(summary)}

Validation submaps are neighbours of training ones. What counts is unseen surveys: `reports/tables/kl.csv` and
`calibration.csv` have them, beside the other methods. {_CHOICE[kind]}

## Limits

- Q is of registrations that start and go as the labels' did; another spread of starts, another sensor noise or another
  registration has another Q.
- It holds for submaps like those above in spacing, extent and relief. `judge(points)` tells how far a submap is
  from them; `is_novel` is set beyond the distance that 99 % of a survey stay below which had no part in the measure
  (the median of such surveys), here for {_share(summary, "training")} of the training and
  {_share(summary, "validation")} of the validation submaps.
  A submap that is not flagged may still be wrong: points that look usual are all that it sees.
{_LIMITS[kind]}- Where registrations end in one of several places, Q is their mean square and no single Gaussian
  fits them.
"""


def _surveys(surveys: Mapping[str, StudySurvey], submaps: Mapping[str, int]) -> str:
    rows = [
        f"| {name} | `{line.raw}` | {submaps[name]} | {line.submap_length_m:g} | {line.point_spacing_m:g}"
        f" | {line.label_runs} |"
        for name, line in surveys.items()
    ]
    head = [
        "| survey | raw pings | submaps | their length, m | point spacing, m | runs a label |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *rows])


def _labels(labels: Mapping[str, Any]) -> str:
    label, registration = labels["label"], labels["registration"]
    yaw = "" if registration["dof"] == "xy" else f", yaw from N(0, ({label['prior_yaw_sigma_rad']:g} rad)²)"
    copy = "a copy of the submap" if label["copy"] == "same" else "one half of the submap's pings onto the other"
    return (
        f"A label is the mean square error of so many registrations of {copy}, from starts drawn from"
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
