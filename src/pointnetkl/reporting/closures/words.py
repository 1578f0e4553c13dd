"""The page's section on loop closures: does Q, made from one submap, describe their errors, and what follows?"""

from collections.abc import Mapping

from pointnetkl.registration.covariance import catalogue
from pointnetkl.registration.covariance.catalogue import MAP, MEASURED_PAIR, PAIR, SPLIT, TRUTH
from pointnetkl.reporting.closures.numbers import FIRM
from pointnetkl.reporting.page import Section
from pointnetkl.reporting.results import GOLD
from pointnetkl.reporting.text_table import Blocks, Numbers, cell

_GOAL = 0.95
_NAMES = {GOLD: "labels", SPLIT: "labels of copy split", MEASURED_PAIR: "Q_ij"}
# What the sentence on likelihoods compares: no oracle, and of the labels' estimates the two that a reader asks for
_LIKELIHOODS = (
    *(GOLD, catalogue.CONSTANT, catalogue.NETWORK, SPLIT, catalogue.SPLIT_RECALIBRATED),
    *(catalogue.MISFIT_REGION, catalogue.DRPM, PAIR, MAP),
)


def section(shown: Blocks, numbers: Numbers, copies: Mapping[str, str]) -> Section:
    """Return the section around the tables `calibration_lc`.

    `numbers` are the report's, and `copies` is the label.copy of each survey's labels.
    """
    calibrations, sizes = numbers["calibration_lc"], numbers["closures"]
    return Section(
        "Is the covariance right on real loop closures?",
        (
            "Q_i is made from submap S_i alone. The graph takes it as the covariance of registering S_i with the"
            " earlier submaps that the vehicle returns to: this is the paper's central assumption. Here Q_i is compared"
            " with the errors of those registrations, over all draws of the graph, against the truth (column against:"
            " gt where the truth is not known). nees and coverage_95 are as under Calibration. nees_median is the"
            " median of eᵀ Q⁻¹ e over that of a chi-squared variable, so that heavy tails do not move it: 1 is right.",
            "A loop closure has an error because its registration has one, and also because its map and its start come"
            " from GT, which has errors too. placed_* is of registrations from the same starts with every submap at its"
            " true pose (at GT's pose where the truth is not known), so that only the registration contributes."
            " given_m is the error of GT's pose of S_i as seen from its targets: over flat ground no registration"
            " corrects it, and no Q made from terrain can know it. heading_m is the error that GT's yaw alone causes"
            " over the lever to the common ground.",
            "A registration's error here is the mean of its edges' errors. The graph takes each edge by itself, and"
            " GT's errors of the single targets come on top of it, so every Q falls shorter there than here. Q is"
            " judged as it was made; stage slam adds slam.floor_m2 to it.",
            "split is a label by copy split: two halves of one pass, from alternate pings. split_recalibrated is split"
            " times one factor for all ground. No stage closes loops of training surveys to fit it on, so each test"
            " survey has the factor that is most likely on the other ones. measured_pair is Q_ij, from S_i and its"
            " actual targets at their true poses, without added noise, because two passes have their own. Q_ij is an"
            " oracle that has seen the truth, and its placed_* are circular: they are the same registrations from"
            " other starts, and most of these end at the same error. So Q_ij is little more than the square of that"
            " error: its size and direction mean something, its short axis nothing. ratio is sqrt(tr Q_ij / tr Q_i),"
            " and worst_ratio compares the standard deviations in the direction where Q_i falls shortest. Slopes of"
            " S_i that its targets do not have (outside) count in Q_i all the same. network_overlap is network asked"
            " about only those points of S_i that lie over its targets.",
            "pair, misfit_region, drpm and map are of single registrations, from their own matches, so they have"
            " placed_* alone. pair is Q of GICP's end with the start's true prior, map the same of an end that is"
            " searched along normals with that prior (docs/closures.md); map's errors are those of its own ends."
            " misfit_region is the practice of mbnavadjust: the region of offsets with under three times the least"
            " misfit. drpm propagates the noise of normals into the Hessian of point-to-plane (Hatleskog and Alexis"
            " 2024), and takes residuals for independent. placed_log_likelihood, of the errors under N(0, Q) in nats,"
            " decides between methods: a Q that is far too large covers everything. More is better, and 1 nat is a"
            " factor of 2.7 in the density at the truth. Its interval counts submaps, because registrations of one are"
            " alike.",
            *_likelihoods(calibrations, sizes),
            *_shares(sizes),
            *_causes(numbers["closures_by_hold"]),
            *_coverages(calibrations, sizes),
            *_advice(calibrations, sizes, copies),
            *_inflated(calibrations, sizes),
        ),
        shown["calibration_lc"],
        {
            "calibration_lc": "NEES (values beyond the axis at its border) and coverage of the 95 % ellipses on loop"
            " closures, beside held-out errors of the labels' own kind. Dotted: right.",
            "closure_ratios": "Q_ij against Q_i: a dot for each submap that closes a loop.",
            "closure_sigmas": "Errors against the size that Q predicts, in bins of equally many registrations.",
        },
        (
            "inflation is the factor on Q, and added_m2 the variance added to it, with which its 95 % ellipses hold"
            " 95 % of this survey's errors. coverage_95_inflated and coverage_95_added are this survey's coverage with"
            " what the other test surveys need: such a correction carries over only where they are near 0.95."
            " placed_inflation leaves GT's errors out. birge is Birge's ratio, the root of nees: a factor on sigmas,"
            " where inflation is one on variances and looks at the 95 % ellipse alone.",
            "Registrations of one submap in several draws, and of neighbours, share ground and map: they count as many"
            " but tell less. placed_* and Q_ij use the targets of the first draw that registers the submap.",
        ),
    )


def _likelihoods(calibrations: Numbers, sizes: Numbers) -> list[str]:
    """Return how likely the true errors of placed registrations are by method, and the two registrations' errors."""
    surveys = []
    for survey, methods in calibrations.items():
        known = [method for method in _LIKELIHOODS if _likelihood(methods.get(method, {})) is not None]
        if sizes[survey]["against"] == TRUTH and known:
            nats = ", ".join(f"{method} {cell(_likelihood(methods[method]), 3)}" for method in known)
            surveys.append(f"{survey}: {nats}{_medians(methods)}")
    if not surveys:
        return []
    return [f"Mean log likelihood of the true placed errors, nats a closure: {'; '.join(surveys)}."]


def _likelihood(calibration: Numbers) -> float | None:
    likelihood: float | None = calibration.get("placed_log_likelihood")
    return likelihood


def _medians(methods: Numbers) -> str:
    if PAIR not in methods or MAP not in methods:
        return ""
    gicp, map_ = (cell(methods[method]["placed_median_m"], 2) for method in (PAIR, MAP))
    return f" (median error {gicp} m by GICP, {map_} m by MAP)"


def _shares(sizes: Numbers) -> list[str]:
    shares = [
        f"{survey} {100 * (size['placed_error_m'] / size['error_m']) ** 2:.0f} %"
        f" ({cell(size['placed_error_m'], 2)} m of {cell(size['error_m'], 2)} m)"
        for survey, size in sizes.items()
        if size["error_m"] and size["placed_error_m"] and size["against"] == TRUTH
    ]
    if not shares:
        return []
    return [f"Share of the registrations in the loop closures' mean squared error: {', '.join(shares)}."]


def _causes(by_hold: Numbers) -> list[str]:
    """Return the errors and their causes where the ground holds best: there a label claims centimetres."""
    firm = {survey: classes[FIRM] for survey, classes in by_hold.items() if FIRM in classes}
    causes = [
        f"{survey} {cell(medians['error_m'], 2)} m, of the registration alone {cell(medians['placed_error_m'], 2)} m,"
        f" of GT's yaw alone {cell(medians['heading_m'], 2)} m"
        for survey, medians in firm.items()
        if medians["heading_m"] is not None
    ]
    return [f"Where Q_ij has a sigma below 0.1 m, the median error is: {'; '.join(causes)}."] if causes else []


def _coverages(calibrations: Numbers, sizes: Numbers) -> list[str]:
    surveys = []
    for survey, methods in calibrations.items():
        coverages = [
            f"{name} {_percent(methods[method]['coverage_95'])}"
            f"{_placed(methods[method]) if method != MEASURED_PAIR and sizes[survey]['against'] == TRUTH else ''}"
            for method, name in _NAMES.items()
            if method in methods
        ]
        surveys += [f"{survey}: {', '.join(coverages)}"] if methods else []
    if not surveys:
        return ["No survey here closes a loop."]
    return [f"Inside the ellipse that should hold 95 %: {'; '.join(surveys)}."]


def _placed(calibration: Numbers) -> str:
    return f" (placed {_percent(calibration['placed_coverage_95'])})"


def _advice(calibrations: Numbers, sizes: Numbers, copies: Mapping[str, str]) -> list[str]:
    """Return which copy's labels describe registration errors better, by the coverage of placed registrations.

    Where the truth is not known, the submaps were placed where GT has them. GT was made with the labels, so it cannot
    judge them.
    """
    misses = {}
    for survey, methods in calibrations.items():
        placed = [methods.get(method, {}).get("placed_coverage_95") for method in (GOLD, SPLIT)]
        if sizes[survey]["against"] == TRUTH and copies.get(survey) == "same" and None not in placed:
            misses[survey] = [abs(coverage - _GOAL) for coverage in placed]
    if not misses:
        return []
    better = [survey for survey, (gold, split) in misses.items() if split < gold]
    if len(better) == len(misses):
        advice = "on every survey here, those of copy split: take label.copy: split where Q goes into a graph"
    elif better:
        advice = f"on {', '.join(better)} those of copy split, elsewhere those of copy same: no default follows"
    else:
        advice = "on every survey here, those of copy same: the paper's labels stand"
    return [f"What follows: the labels that describe registration errors better are, {advice}."]


def _inflated(calibrations: Numbers, sizes: Numbers) -> list[str]:
    """Return what becomes of the labels' coverage with the factor that other surveys ask for."""
    changes = [
        f"{survey}, {_NAMES[method]}: {_percent(values['coverage_95'])} becomes"
        f" {_percent(values['coverage_95_inflated'])} (its own factor would be {cell(values['inflation'], 2)}"
        f"{_without_gt(values) if sizes[survey]['against'] == TRUTH else ''})"
        for survey, methods in calibrations.items()
        for method, values in methods.items()
        if method in (GOLD, SPLIT) and "coverage_95_inflated" in values
    ]
    if not changes:
        return []
    return [f"With Q times the factor that the other test surveys ask for: {'; '.join(changes)}."]


def _without_gt(calibration: Numbers) -> str:
    return f", {cell(calibration['placed_inflation'], 2)} without GT's errors"


def _percent(share: float | None) -> str:
    return cell(None) if share is None else f"{100 * share:.0f} %"
