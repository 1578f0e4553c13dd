"""The page's words: its first paragraphs, the order of its sections, and the lines that the stage prints."""

from collections.abc import Mapping, Sequence

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting.closing import words as closing
from pointnetkl.reporting.closures import words as closures
from pointnetkl.reporting.covariances import words as covariances
from pointnetkl.reporting.labels import words as labels
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import Labels, Test
from pointnetkl.reporting.robustness import words as robustness
from pointnetkl.reporting.slam import words as slam
from pointnetkl.reporting.surveys import words as surveys
from pointnetkl.reporting.text_table import Blocks, Numbers, cell
from pointnetkl.workflow.study import Study

# The methods of the lines that the stage prints
_RIVALS = (
    *(catalogue.NETWORK, catalogue.POINTNETKL, catalogue.STRUCTURE_TENSOR, catalogue.CELLO),
    *(catalogue.CONSTANT_TRAIN, catalogue.NAIVE_GICP),
)
_SOLUTIONS = ("corrupted", catalogue.MONTE_CARLO, catalogue.POINTNETKL, catalogue.CONSTANT, catalogue.NAIVE_GICP)


def lead(study: Study, datasets: Numbers, of_labels: Mapping[str, Labels], tests: Mapping[str, Test]) -> list[str]:
    """Return the page's first paragraphs: what it is, of what size, and what in it is simulated."""
    points = [dataset["points_mean"] for dataset in datasets.values()]
    runs = [line.label_runs for line in study.surveys.values()]
    repetitions = max(int(test.slam["repetition"].max()) + 1 if test.track else 0 for test in tests.values())
    simulated = [name for name, dataset in datasets.items() if dataset["simulated"]]
    copy, noise = (next(iter(of_labels.values())).parameters["label"][name] for name in ("copy", "noise_sigma_m"))
    return [
        "How uncertain is a registration of two pieces of seabed? Each table and figure compares methods that estimate"
        " it: Q, the covariance in x and y of a submap's registration by GICP. The paper's numbers (Torroba, Sprague,"
        " Bore and Folkesson, PointNetKL, RA-L 2020) stand beside ours. A dash means: not known, or not in the paper.",
        f"Scale {study.scale}: {_count(datasets, study.train)} training submaps, {_count(datasets, study.test)}"
        f" to test on; {_span(points)} points per cloud; {_span(runs)} registrations per label (label.copy"
        f" {copy}, noise {cell(noise)} m per coordinate); {repetitions} SLAM repetitions. The paper: 9080 and"
        " 619 submaps, 6553 points, 3000 registrations, 100 repetitions. Fewer submaps train a weaker network"
        " and widen every interval.",
        _simulated(simulated, [name for name in datasets if name not in simulated]),
        *_without_track([name for name, test in tests.items() if not test.track]),
    ]


def sections(shown: Blocks, numbers: Numbers, copies: Mapping[str, str], runtime: Numbers) -> list[Section]:
    """Return the page's sections around the tables; `copies` are the surveys' label.copy."""
    return [
        surveys.sizes(shown),
        surveys.cleaning(shown),
        labels.eigenvalues(shown),
        labels.dependence(shown),
        labels.training(),
        covariances.divergence(shown, copies),
        covariances.calibration(shown),
        closures.section(shown, numbers, copies),
        covariances.classes(shown),
        covariances.limits(copies, numbers["datasets"]),
        covariances.time(shown, runtime),
        closing.section(shown, numbers["closing"]),
        *slam.sections(shown, numbers["slam"]),
        robustness.section(shown),
    ]


def comparison(numbers: Numbers) -> list[str]:
    """Return the lines that say how PointNetKL does against its rivals on each test survey."""
    lines = []
    for survey, errors in numbers["slam"].items():
        simulated = " (simulated)" if numbers["datasets"][survey]["simulated"] else ""
        lines.append(f"{survey}{simulated}: mean KL, nats: {_list(numbers['kl'][survey], _RIVALS, 'mean')}")
        against_gt = _list(errors, _SOLUTIONS, "rmse_xyz_m")
        lines.append(f"{survey}{simulated}: SLAM error against GT, m: {against_gt or 'no track, no SLAM'}")
        if errors["gt"]["truth_rmse_xyz_m"] is not None:
            truth = _list(errors, (*_SOLUTIONS, "gt"), "truth_rmse_xyz_m")
            lines.append(f"{survey}{simulated}: SLAM error against truth, m: {truth}")
    return lines


def _simulated(simulated: Sequence[str], measured: Sequence[str]) -> str:
    if not simulated:
        return "Every survey here is measured, none simulated."
    others = f" Measured: {', '.join(measured)}." if measured else ""
    return (
        f"Simulated: {', '.join(simulated)}. Vehicle, sonar and terrain (but for real grids) are models. They stand in"
        " for surveys whose raw data are not public. They can show whether a method works, but cannot confirm the"
        " paper's numbers. At demo scale each terrain's seed, and each grid's place, was chosen by slopes and not by"
        f" any label or result, so that a small survey holds flat and rugged ground alike.{others}"
    )


def _without_track(names: Sequence[str]) -> list[str]:
    sentence = f"Points without pings are cut into tiles. They have no track, and so no SLAM: {', '.join(names)}."
    return [sentence] if names else []


def _count(datasets: Numbers, names: Numbers) -> int:
    return sum(datasets[name]["submaps"] for name in names)


def _span(values: Sequence[float]) -> str:
    low, high = (f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _list(numbers: Numbers, methods: Sequence[str], measure: str) -> str:
    return ", ".join(f"{method} {cell(numbers[method].get(measure))}" for method in methods if method in numbers)
