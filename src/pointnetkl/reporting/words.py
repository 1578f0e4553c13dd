"""The report's words: what each part of the page shows, how to read it, and what must be known to judge it."""

from collections.abc import Mapping, Sequence
from typing import Any

from pointnetkl.reporting.closures import words as closure_story
from pointnetkl.reporting.covariances import words as terrain_story
from pointnetkl.reporting.labels import words as label_story
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import Labels, Test
from pointnetkl.reporting.robustness import words as robustness_story
from pointnetkl.reporting.slam import words as slam_story
from pointnetkl.reporting.surveys import words as cleaning_story
from pointnetkl.reporting.text_table import Block, cell
from pointnetkl.workflow.study import Study

_WORST_OF = ("network", "pointnetkl", "structure_tensor")  # whose worst submaps the page shows, as far as there
Blocks = Mapping[str, Sequence[Block]]


def lead(
    study: Study, datasets: Mapping[str, Any], labels: Mapping[str, Labels], tests: Mapping[str, Test]
) -> list[str]:
    """Return the page's first paragraphs: what it is, of what size, and what in it is simulated."""
    points = [each["points_mean"] for each in datasets.values()]
    runs = [line.label_runs for line in study.surveys.values()]
    repetitions = max(int(test.slam["repetition"].max()) + 1 if test.track else 0 for test in tests.values())
    simulated = [name for name, each in datasets.items() if each["simulated"]]
    copy, noise = (next(iter(labels.values())).parameters["label"][name] for name in ("copy", "noise_sigma_m"))
    return [
        "How uncertain is a registration of two pieces of seabed? Each table and figure compares ways to tell:"
        " Q, the covariance in x and y of registering a submap by GICP. The paper's numbers (Torroba, Sprague, Bore"
        " and Folkesson, PointNetKL, RA-L 2020) stand beside ours. A dash means: not known, or not in the paper.",
        f"Scale {study.scale}: {_count(datasets, study.train)} training submaps, {_count(datasets, study.test)}"
        f" to test on; {_span(points)} points per cloud; {_span(runs)} registrations per label (label.copy"
        f" {copy}, noise {cell(noise)} m per coordinate); {repetitions} SLAM repetitions. The paper: 9080 and"
        " 619 submaps, 6553 points, 3000 registrations, 100 repetitions. Fewer submaps train a weaker network"
        " and widen every interval.",
        _simulated(simulated, [name for name in datasets if name not in simulated]),
        *_without_track([name for name, test in tests.items() if not test.track]),
    ]


def sections(shown: Blocks, numbers: Mapping[str, Any], labels: Mapping[str, Labels]) -> list[Section]:
    """Return the page's sections around the tables, by the stems of their files, and the report's numbers."""
    copies = {name: str(of.parameters["label"]["copy"]) for name, of in labels.items()}
    return [
        _surveys(shown),
        cleaning_story.section(shown),
        _labels(shown),
        label_story.section(shown),
        _training(),
        _kl(shown, copies),
        _calibration(shown),
        closure_story.section(shown, numbers, copies),
        terrain_story.classes(shown),
        terrain_story.limits(copies, numbers["datasets"]),
        _time(shown),
        *slam_story.sections(shown, numbers["slam"]),
        robustness_story.section(shown),
    ]


def comparison(numbers: Mapping[str, Any]) -> list[str]:
    """Return the lines that say how PointNetKL does against its rivals on each test survey."""
    lines = []
    for survey, slam in numbers["slam"].items():
        simulated = " (simulated)" if numbers["datasets"][survey]["simulated"] else ""
        rivals = ("network", "pointnetkl", "structure_tensor", "cello", "constant_train", "naive_gicp")
        kl = _each(numbers["kl"][survey], rivals, "mean")
        methods = ("corrupted", "monte_carlo", "pointnetkl", "constant", "naive_gicp")
        lines.append(f"{survey}{simulated}: mean KL, nats: {kl}")
        against_gt = _each(slam, methods, "rmse_xyz_m")
        lines.append(f"{survey}{simulated}: SLAM error against GT, m: {against_gt or 'no track, no SLAM'}")
        if slam["gt"]["truth_rmse_xyz_m"] is not None:
            truth = _each(slam, (*methods, "gt"), "truth_rmse_xyz_m")
            lines.append(f"{survey}{simulated}: SLAM error against truth, m: {truth}")
    return lines


def _surveys(shown: Blocks) -> Section:
    return Section(
        "Surveys",
        (
            "Area is the union of the submaps' footprints. sigma_z is the standard deviation of z over all points once"
            " each submap is moved to zero mean and scaled into the unit sphere: small for flat or wide ground. The"
            " ratio is ours over the paper's. spacing_m is the median distance of a point to its nearest.",
        ),
        shown["table_1"],
        {
            "swath": "A piece of the first training survey's swath, good soundings only (the paper's Fig. 2).",
            "canonical": "Normalised and voxelised submaps, all in one sphere (the paper's Fig. 3); at most 25,000"
            " points are drawn. Points away from the disc mean relief.",
        },
        (
            "Areas and counts of submaps fall far below the paper's at every scale but the paper's own: a smaller"
            " scale has fewer and smaller submaps. sigma_z compares better, though smaller submaps change it too.",
        ),
    )


def _labels(shown: Blocks) -> Section:
    return Section(
        "Labels",
        (
            "A label is the second moment of the registration's errors from starts drawn about the truth (variance:"
            " the prior, 9 m² in the paper). Near the prior the seabed told nothing, near 0 the position. The"
            " smaller eigenvalue is of the direction that the terrain holds best. Whiskers of the figure span 5"
            " to 95 %, boxes the quartiles.",
            "relative_error is the largest standard error of the label's variance in any direction, as a share of it,"
            " from the errors' fourth moments: the median over submaps, and what 95 % of them stay below. bias is the"
            " mean error (m), part of the label, and bias_share its square's share of it. main_basin_share is the share"
            " of runs within three robust sigmas of the most common outcome: 0.99 where there is one basin.",
        ),
        [*shown["labels"], *shown["label_quality"]],
        {"labels": "Eigenvalues of the labels. Crosses: quantiles of what the authors' network predicts there."},
        (
            "label.copy same registers a submap to a noisy copy of its very points, as the paper does. That"
            " flatters: an independent pass over the same ground has other points. Where points lie farther"
            " apart than the starts spread (self_matching, a share of the survey's submaps), the copy finds"
            " itself.",
            "The authors' network's values are its predictions on its own surveys, not labels: a loose guide, no goal.",
        ),
    )


def _training() -> Section:
    return Section(
        "Training",
        (
            "KL divergence to the labels as the network learns. Validation submaps are blocks along the track:"
            " few of them have an overlapping neighbour that is trained on, though adjacent lines still share some"
            " ground. The ring marks the weights that were kept. The floor (floor_m2 of a model's train) is added to"
            " label and answer alike before they are compared, and is in neither when Q is used.",
        ),
        figures={"training": "KL divergence (nats) by optimiser step, a panel for each model (the paper's Fig. 4)."},
    )


def _kl(shown: Blocks, copies: Mapping[str, str]) -> Section:
    return Section(
        "Divergence from the labels",
        (
            "KL(label || Q), nats: 0 is the label itself. The floor report.kl_floor_m2 is added to label and Q, or one"
            " wrong tiny label would decide the mean; mean_floor0 is without it. constant is the mean of the test"
            " survey's own labels (a posteriori, as in the paper); constant_train that of the training labels, which a"
            f" vehicle could have. {terrain_story.copy_words(copies)}",
            "Table II is at that floor: what was fitted or trained at another (floor_m2) has a dash. Intervals are"
            " a bootstrap over submaps, in runs of report.block_submaps along the track, for neighbours overlap;"
            " network_better is the share of its draws in which network has the lower mean: 1 is sure, 0.5 a tie."
            " axis_error_deg is the mean angle between the major axes of label and Q, weighted by the anisotropy"
            " (a - b) / (a + b) of the label's eigenvalues, with the floor; 45 is a guess.",
        ),
        shown["table_2"],
        {
            "kl": "Mean KL(label || Q) by method, the best on top, with its 95 % interval. Left is better; log scale.",
            "submaps": "Submaps from the largest label to the smallest, seen from above with the track upward: seabed,"
            " and to scale the 95 % ellipses of the label and of what methods said, with their KL. beyond: too large"
            " for the frame. The ten submaps that each method is most wrong about: reports/figures/worst.",
            **{f"worst/{name}": f"The ten submaps that {name} is most wrong about." for name in _WORST_OF},
        },
        (
            "Adjacent lines share terrain too, and a survey is one draw of it: the true intervals are wider.",
            "Where most labels are below the floor, any small Q is as good: read mean_floor0 and the calibration too.",
        ),
    )


def _calibration(shown: Blocks) -> Section:
    return Section(
        "Calibration",
        (
            "Does Q describe errors that no label has seen? nees is the mean of eᵀ Q⁻¹ e / M, M its size: 1 is right,"
            " above 1 is too sure of itself. coverage_95 is the share of errors inside the ellipse that should hold"
            " 95 %, and mc_coverage_95 that inside monte_carlo's own, on the same errors.",
        ),
        shown["calibration"],
        {
            "calibration": "Normalised NEES (shaded: 0.85 to 1.15; a number: beyond the axis) and coverage of the 95 %"
            " ellipses. Dotted: 95 %. Dashed: monte_carlo's own, which errors with heavy tails allow.",
            "reliability": "Share of errors inside the ellipse that should hold so many. Under the diagonal Q is too"
            " sure of itself; as good as monte_carlo, the labels themselves, is as good as a Gaussian can be.",
        },
        (
            "Errors have heavy tails, so even exact second moments (monte_carlo) may cover less than they should."
            " These errors are of the labels' own kind of registration, submap against copy, not of loop closures.",
            "The calibrated closed forms have no floor of their own: on rugged ground their variance goes to zero,"
            " which NEES, and KL without a floor, show.",
        ),
    )


def _time(shown: Blocks) -> Section:
    return Section(
        "Run time",
        (
            "Seconds for the covariance of one submap of the paper's size, on one thread, every"
            " preprocessing step included; mean and standard deviation over submaps. times_faster is against"
            " our own Monte Carlo label, of as many registrations as the table's title says (the paper: 3000).",
        ),
        shown["table_3"],
        {
            "accuracy_time": "Divergence against time, log scales. Nothing lies left of and below the dashed line, the"
            " Pareto front. Bars: 95 % intervals."
        },
        (
            "The paper's machine is another one: compare ratios, not seconds. Divergence is judged on this"
            " scale's test submaps, time on submaps of the paper's size.",
        ),
    )


def _simulated(simulated: Sequence[str], measured: Sequence[str]) -> str:
    if not simulated:
        return "Every survey here is measured, none simulated."
    others = f" Measured: {', '.join(measured)}." if measured else ""
    return (
        f"Simulated: {', '.join(simulated)}. Vehicle, sonar and terrain (but for real grids) are models, stand-ins for"
        " surveys whose raw data are not public: they can show whether the method works, not confirm the paper's"
        " numbers. At demo scale each terrain's seed, and each grid's place, was chosen by slopes and not by any"
        f" label or result, so that a small survey holds flat and rugged ground alike.{others}"
    )


def _without_track(names: Sequence[str]) -> list[str]:
    return [f"No track, and so no SLAM, of points without pings (cut into tiles): {', '.join(names)}."] if names else []


def _count(datasets: Mapping[str, Any], names: Mapping[str, Any]) -> int:
    return sum(datasets[name]["submaps"] for name in names)


def _span(values: Sequence[float]) -> str:
    low, high = (f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _each(numbers: Mapping[str, Any], names: Sequence[str], what: str) -> str:
    return ", ".join(f"{name} {cell(numbers[name].get(what))}" for name in names if name in numbers)
