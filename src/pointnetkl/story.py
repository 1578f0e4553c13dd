"""The report's words: what each part of the page shows, how to read it, and what must be known to judge it."""

from collections.abc import Mapping, Sequence
from typing import Any

from pointnetkl import label_story
from pointnetkl.page import Section
from pointnetkl.results import Labels, Test
from pointnetkl.study import Study
from pointnetkl.text_table import Block, cell

Blocks = Mapping[str, Sequence[Block]]


def lead(
    study: Study, datasets: Mapping[str, Any], labels: Mapping[str, Labels], tests: Mapping[str, Test]
) -> list[str]:
    """Return the page's first paragraphs: what it is, of what size, and what in it is simulated."""
    points = [each["points_mean"] for each in datasets.values()]
    runs = [line.label_runs for line in study.surveys.values()]
    repetitions = max(int(test.slam["repetition"].max()) + 1 for test in tests.values())
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
    ]


def sections(shown: Blocks) -> list[Section]:
    """Return the page's sections around the tables, by the stems of their files."""
    return [
        _surveys(shown),
        _labels(shown),
        label_story.section(shown),
        _training(),
        _kl(shown),
        _calibration(shown),
        _time(shown),
        _slam(shown),
    ]


def comparison(numbers: Mapping[str, Any]) -> list[str]:
    """Return the lines that say how PointNetKL does against its rivals on each test survey."""
    lines = []
    for survey, slam in numbers["slam"].items():
        simulated = " (simulated)" if numbers["datasets"][survey]["simulated"] else ""
        kl = _each(numbers["kl"][survey], ("pointnetkl", "structure_tensor", "constant_train", "naive_gicp"), "mean")
        methods = ("corrupted", "monte_carlo", "pointnetkl", "constant", "naive_gicp")
        lines.append(f"{survey}{simulated}: mean KL, nats: {kl}")
        lines.append(f"{survey}{simulated}: SLAM error against GT, m: {_each(slam, methods, 'rmse_xyz_m')}")
        if slam["gt"]["truth_rmse_xyz_m"] is not None:
            truth = _each(slam, (*methods, "gt"), "truth_rmse_xyz_m")
            lines.append(f"{survey}{simulated}: SLAM error against truth, m: {truth}")
    return lines


def _surveys(shown: Blocks) -> Section:
    return Section(
        "Surveys",
        (
            "Area is the union of the submaps' footprints. sigma_z is the standard deviation of z over all"
            " points once each submap is moved to zero mean and scaled into the unit sphere: small for flat or"
            " wide ground. The ratio is ours over the paper's. spacing_m is the median distance of a point to"
            " its nearest.",
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
            " ground. The ring marks the weights that were kept. The network learns each label plus the floor"
            " (train.label_floor_m2), so its Q holds the floor wherever it is used, in SLAM too.",
        ),
        figures={"training": "KL divergence (nats) by optimiser step (the paper's Fig. 4)."},
    )


def _kl(shown: Blocks) -> Section:
    return Section(
        "Divergence from the labels",
        (
            "KL(label || Q), nats: 0 is the label itself. The floor of report.kl_floor_m2 is added to label and"
            " Q, or one wrong tiny label would decide the mean; mean_floor0 is without it. Intervals are a"
            " bootstrap over submaps. constant is the mean of the test survey's own labels (a posteriori, as in"
            " the paper); constant_train that of the training labels, which a vehicle could have.",
        ),
        shown["table_2"],
        {"kl": "Mean KL(label || Q) by method, with its 95 % interval. Left is better; log scale."},
        (
            "Neighbouring submaps overlap and share terrain: they are not independent, and the true intervals"
            " are wider.",
            "Where most labels are smaller than the floor (see Labels) the mean with the floor says little: there"
            " every small Q is as good as any other. Read mean_floor0 and the calibration too.",
        ),
    )


def _calibration(shown: Blocks) -> Section:
    return Section(
        "Calibration",
        (
            "Does Q describe errors that no label has seen? nees is the mean of eᵀ Q⁻¹ e / 2: 1 is right,"
            " above 1 is too sure of itself. coverage_95 is the share of errors inside the ellipse that should"
            " hold 95 %.",
        ),
        shown["calibration"],
        {"calibration": "Normalised NEES by method. On the dotted line Q is right on average."},
        (
            "Errors have heavy tails, so even exact second moments (monte_carlo) may cover less than they should."
            " These errors are of the labels' own kind of registration, submap against copy, not of loop closures.",
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
        {"accuracy_time": "Divergence against time. Nothing lies left of and below the dotted line."},
        (
            "The paper's machine is another one: compare ratios, not seconds. Divergence is judged on this"
            " scale's test submaps, time on submaps of the paper's size.",
        ),
    )


def _slam(shown: Blocks) -> Section:
    return Section(
        "SLAM",
        (
            "Yaw noise corrupts the dead reckoning of each survey's graph; the graph is optimised with each"
            " method's Q on its loop closures. RMSE_xyz is over submap positions, not aligned. Map-to-map is"
            " the distance between overlapping submaps (root mean square over cells of their worst pair); a"
            " perfect map is not at 0, because soundings are apart. N_DR and N_LC count edges of dead reckoning"
            " and loop closures.",
        ),
        shown["table_4"],
        {
            "slam": "Error by method. Bars are 95 % intervals of the mean over repetitions. Diamonds: the paper.",
            "bathymetry": "Depth of the test surveys, submaps at their GT poses (the paper's Fig. 5).",
            "trajectories": "Repetition 0: GT, corrupted, solved with the covariances named. One scale per survey.",
        },
        (
            "GT is navigation optimised with the Monte Carlo covariances, as in the paper: it favours monte_carlo."
            " Where the truth is known (simulated surveys), rest conclusions on truth_rmse_xyz_m; the row gt"
            " tells how far GT itself is from it.",
            "All repetitions corrupt one and the same graph, whose loop closures were registered once:"
            " intervals are over the yaw noise alone and say nothing of another draw of the loop closures.",
        ),
    )


def _simulated(simulated: Sequence[str], measured: Sequence[str]) -> str:
    if not simulated:
        return "Every survey here is measured, none simulated."
    others = f" Measured: {', '.join(measured)}." if measured else ""
    return (
        f"Simulated: {', '.join(simulated)}. Terrain, vehicle and sonar of these are models, stand-ins for"
        " surveys whose raw data are not public: they can show whether the method works, not confirm the"
        " paper's numbers. At demo scale each terrain's seed was chosen, by its slopes and not by any label or"
        f" result, so that a small survey holds flat and rugged ground alike.{others}"
    )


def _count(datasets: Mapping[str, Any], names: Mapping[str, Any]) -> int:
    return sum(datasets[name]["submaps"] for name in names)


def _span(values: Sequence[float]) -> str:
    low, high = (f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _each(numbers: Mapping[str, Any], names: Sequence[str], what: str) -> str:
    return ", ".join(f"{name} {cell(numbers[name].get(what))}" for name in names if name in numbers)
