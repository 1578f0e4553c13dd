"""The catalogue of methods: every name in column `method` of a table, its family, and the stage that makes it.

A new method joins by a constant and a line in METHODS. Two kinds of names are made up as the pipeline runs: mc_<runs>,
one for each number in estimate.sampled_runs, and the models, whose names the user gives in section `models`.
"""

import re
from dataclasses import dataclass
from enum import StrEnum

MONTE_CARLO = "monte_carlo"  # the labels themselves: the gold standard
CONSTANT, NAIVE_GICP, NAIVE_MEANCOV = "constant", "naive_gicp", "naive_meancov"
HESSIAN, CENSI, UNSCENTED, MEAN_FIELD = "hessian", "censi", "unscented", "mean_field"
HESSIAN_CALIBRATED, CENSI_CALIBRATED = "hessian_calibrated", "censi_calibrated"
CONSTANT_TRAIN, STRUCTURE_TENSOR, CELLO = "constant_train", "structure_tensor", "cello"
NETWORK, POINTNETKL = "network", "pointnetkl"
UNSCALED, RANDOM_SPLIT = "pointnetkl_unscaled", "pointnetkl_random_split"
SPLIT, MEASURED_PAIR = "split", "measured_pair"  # by Monte Carlo: the label by copy split, and Q_ij of a loop closure
SPLIT_RECALIBRATED = "split_recalibrated"  # times one factor, which the other test surveys ask for
# Of one registration of a loop closure, from its own matches: a submap has as many as there are draws. The first three
# are of GICP's end, the last of MAP's, whose errors are others.
PAIR, MISFIT_REGION, DRPM, MAP = OF_REGISTRATIONS = ("pair", "misfit_region", "drpm", "map")
OVERLAP = "_overlap"  # after a method's name: the method, asked about the ground that a loop closure's submaps share

# What stands beside the methods in tables of SLAM, and no covariance made it.
TRUTH, GT, NAVIGATION, CORRUPTED = REFERENCES = ("truth", "gt", "navigation", "corrupted")


class Family(StrEnum):
    """A kind of methods, by the name that legends give it; their order is that of legends."""

    GOLD = "gold standard"
    RIVALS = "the paper's rivals"
    CLOSED_FORMS = "closed forms"
    SAMPLED = "sampled"
    LEARNED = "learned numbers"
    NETWORKS = "networks"
    OTHERS = "others"


class Stage(StrEnum):
    """A stage whose settings or products decide a method's answer; stage predict applies what fit has fitted."""

    LABEL = "label"
    ESTIMATE = "estimate"
    FIT = "fit"
    PREDICT = "predict"
    CALIBRATE = "calibrate"


@dataclass(frozen=True)
class Entry:
    """What the catalogue says of a method."""

    family: Family
    stage: Stage


METHODS = {
    MONTE_CARLO: Entry(Family.GOLD, Stage.LABEL),
    CONSTANT: Entry(Family.RIVALS, Stage.ESTIMATE),
    NAIVE_GICP: Entry(Family.RIVALS, Stage.ESTIMATE),
    NAIVE_MEANCOV: Entry(Family.RIVALS, Stage.ESTIMATE),
    HESSIAN: Entry(Family.CLOSED_FORMS, Stage.ESTIMATE),
    CENSI: Entry(Family.CLOSED_FORMS, Stage.ESTIMATE),
    UNSCENTED: Entry(Family.CLOSED_FORMS, Stage.ESTIMATE),
    MEAN_FIELD: Entry(Family.CLOSED_FORMS, Stage.ESTIMATE),
    CONSTANT_TRAIN: Entry(Family.LEARNED, Stage.FIT),
    HESSIAN_CALIBRATED: Entry(Family.CLOSED_FORMS, Stage.FIT),
    CENSI_CALIBRATED: Entry(Family.CLOSED_FORMS, Stage.FIT),
    STRUCTURE_TENSOR: Entry(Family.LEARNED, Stage.FIT),
    CELLO: Entry(Family.LEARNED, Stage.FIT),
    POINTNETKL: Entry(Family.NETWORKS, Stage.PREDICT),
    NETWORK: Entry(Family.NETWORKS, Stage.PREDICT),
    UNSCALED: Entry(Family.NETWORKS, Stage.PREDICT),
    RANDOM_SPLIT: Entry(Family.NETWORKS, Stage.PREDICT),
    SPLIT: Entry(Family.OTHERS, Stage.CALIBRATE),
    SPLIT_RECALIBRATED: Entry(Family.OTHERS, Stage.CALIBRATE),
    MEASURED_PAIR: Entry(Family.OTHERS, Stage.CALIBRATE),
    **dict.fromkeys(OF_REGISTRATIONS, Entry(Family.CLOSED_FORMS, Stage.CALIBRATE)),
}


def entry(method: str) -> Entry:
    """Return what the catalogue says of a method.

    A name that is in no list is a model's, because every other name in a table is either listed or made here.
    """
    if method in METHODS:
        return METHODS[method]
    if method.endswith(OVERLAP):
        return Entry(entry(method.removesuffix(OVERLAP)).family, Stage.CALIBRATE)
    if re.fullmatch(r"mc_\d+", method):
        return Entry(Family.SAMPLED, Stage.ESTIMATE)
    return Entry(Family.NETWORKS, Stage.PREDICT)


def family(name: str) -> Family:
    """Return the family of a method; a reference, which no covariance made, is among the others."""
    return Family.OTHERS if name in REFERENCES else entry(name).family


def sampled(runs: int) -> str:
    """Return the name of Monte Carlo with so many registrations."""
    return f"mc_{runs}"


def overlapping(method: str) -> str:
    """Return the name of a method that is asked about the common ground of a loop closure's submaps."""
    return f"{method}{OVERLAP}"
