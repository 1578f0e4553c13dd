"""The page beside a model's weights: what it was made from, how good it is, what it is for and where it ends."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pointnetkl.models.model import Model
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.workflow.study import StudySurvey

_TAKES = {
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


_CHOSEN = {
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


@dataclass(frozen=True)
class Origin:
    """What a model was made from."""

    surveys: Mapping[str, StudySurvey]
    submaps: Mapping[str, int]  # by survey, those validated on included
    label: monte_carlo.Settings
    registration: gicp.Settings


def text(name: str, kind: str, model: Model, voxel: float, origin: Origin, summary: Mapping[str, Any]) -> str:
    """Return the page, in Markdown; `summary` is the training's own, with its mean KL in nats."""
    units = "m²" if model.settings.dimensions == 2 else "m², m rad and rad²"
    return f"""# {name}

The covariance Q of a submap's registration by GICP, from its points alone: for the weight of a loop closure.
Trained by `dvc repro train@{name}`; this page is written with the weights.

| | |
|---|---|
| kind | `{kind}`, {_weights(model)} weights |
| in | a submap's points (n, 3), metres, z up, in any frame with these axes |
| out | Q ({model.settings.dimensions}, {model.settings.dimensions}), {units}, in the points' frame |
| use | `CovarianceEstimator.load("{name}.pt").predict(points)`, or `python -m pointnetkl predict` |
| ONNX in | {_TAKES[kind].format(voxel=voxel)} |
| ONNX out | `covariance` (clouds, {model.settings.dimensions}, {model.settings.dimensions}) |

## Trained on

{_surveys(origin)}

`reports/tables/table_1.md` says which surveys are simulated. {_labels(origin)}

## How good

{_measures(summary)}

Validation submaps are neighbours of training ones. What counts is unseen surveys: `reports/tables/kl.csv` and
`calibration.csv` have them, beside the other methods. {_CHOSEN[kind]}

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


def _surveys(origin: Origin) -> str:
    rows = [
        f"| {name} | `{line.raw}` | {origin.submaps[name]} | {line.submap_length_m:g} | {line.point_spacing_m:g}"
        f" | {line.label_runs} |"
        for name, line in origin.surveys.items()
    ]
    head = [
        "| survey | raw pings | submaps | their length, m | point spacing, m | runs a label |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join([*head, *rows])


def _labels(origin: Origin) -> str:
    label, registration = origin.label, origin.registration
    yaw = "" if registration.dof == "xy" else f", yaw from N(0, ({label.prior_yaw_sigma_rad:g} rad)²)"
    copy = "a copy of the submap" if label.copy == "same" else "one half of the submap's pings onto the other"
    return (
        f"A label is the mean square error of so many registrations of {copy}, from starts drawn from"
        f" N(0, {label.prior_variance_m2:g} m²) in x and y{yaw}, with noise of {label.noise_sigma_m:g} m on each"
        f" coordinate; matches within {registration.max_distance_m:g} m."
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


def _weights(model: Model) -> int:
    return sum(parameter.numel() for parameter in model.parameters())
