"""The surveys of the study, one line of params.yaml each: where their raw data are, and a few numbers."""

from dataclasses import dataclass, field
from pathlib import Path

from pointnetkl.workflow import parameters

MOST_RUNS = 1_000_000  # of a label: their errors are held at once
UNSTATED = "gyrocompass"  # how a survey drifts whose line does not say
_LEAST = ("pointnetkl", "network")  # the models that stages calibrate and report cannot do without


@dataclass(frozen=True)
class StudySurvey:
    """One survey's line in the parameter file.

    Raises:
        ValueError: a length or a count is not positive.
    """

    group: str  # train or test: the list that its line stands in; its products are in data/<group>/<survey>
    raw: str  # file or folder of raw pings
    truth: str  # its true trajectory; data/none where it is not known
    submap_length_m: float
    point_spacing_m: float
    label_runs: int  # registrations per Monte Carlo label
    navigation: str = UNSTATED  # how it drifts: a name of section `navigation`, or a preset of slam.closing.drift

    def __post_init__(self) -> None:
        """Refuse lengths and counts that no submap can be cut with."""
        parameters.require_positive(self, "submap_length_m", "point_spacing_m", "label_runs")
        if self.label_runs > MOST_RUNS:
            raise ValueError(f"label_runs is {self.label_runs}, must be at most {MOST_RUNS}")
        if self.submap_length_m < 2 * self.point_spacing_m:
            raise ValueError(
                f"submap_length_m is {self.submap_length_m:g}, must be at least twice point_spacing_m,"
                f" which is {self.point_spacing_m:g}"
            )


@dataclass(frozen=True)
class Study:
    """The training surveys, the test surveys, and all of them."""

    train: dict[str, StudySurvey]
    test: dict[str, StudySurvey]
    surveys: dict[str, StudySurvey]
    scale: str = "unnamed"  # name of the numbers in params.yaml, set by the files of scales/
    models: list[str] = field(default_factory=lambda: list(_LEAST))  # those of section `models` that are trained

    def __post_init__(self) -> None:
        """Refuse a study that tests on training data, or that lacks a model.

        Raises:
            ValueError: a survey, or its raw files, are in both groups, or its line names the other one; a model is
                missing or stands twice.
        """
        if not set(_LEAST) <= set(self.models) or len(set(self.models)) < len(self.models):
            raise ValueError(f"models is {self.models}, must name {' and '.join(_LEAST)}, and each model once")
        for group, lines in (("train", self.train), ("test", self.test)):
            if astray := [name for name, line in lines.items() if line.group != group]:
                line = lines[astray[0]]
                raise ValueError(
                    f"{group}.{astray[0]}.group is {line.group!r}, must be {group}, the list that it stands in"
                )
        if both := sorted(set(self.train) & set(self.test)):
            raise ValueError(f"test has {both[0]}, which train has too; name it in one of them")
        trained = {line.raw for line in self.train.values()}
        if both := sorted(name for name, line in self.test.items() if line.raw in trained):
            raise ValueError(f"test.{both[0]} has the raw files of a training survey; test on others")


def read(path: Path) -> Study:
    """Return the whole study of a parameter file.

    Raises:
        SettingsError: a line is wrong.
    """
    return parameters.read(path, "study", Study)


def training_surveys(path: Path) -> list[str]:
    """Return the names of the training surveys.

    Raises:
        SettingsError: there is none, or a line is wrong.
    """
    if not (names := list(read(path).train)):
        raise parameters.SettingsError(f"{path}: study.train names no survey; models and fits need one at least")
    return names


def survey(path: Path, name: str) -> StudySurvey:
    """Return one survey's line; other surveys' lines are not checked.

    Raises:
        SettingsError: there is no such survey, its line is wrong, or its group has no line of that name.
    """
    line = parameters.read(path, f"study.surveys.{name}", StudySurvey)
    if name not in parameters.read(path, f"study.{line.group}", dict):
        raise parameters.SettingsError(
            f"{path}: study.surveys.{name}.group is {line.group!r}, but study.{line.group} has no {name}; write the"
            " name of the list that the line stands in"
        )
    return line
