"""The report: headline.json, metrics.json, tables, figures and the page, as bytes by file name, from all artifacts."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import headline, page, results, terrain, text_table, words
from pointnetkl.reporting.closing import figures as closing_figures
from pointnetkl.reporting.closing import numbers as closing
from pointnetkl.reporting.closing import tables as closing_tables
from pointnetkl.reporting.closing.numbers import Closings
from pointnetkl.reporting.closures import figures as closure_figures
from pointnetkl.reporting.closures import numbers as closures
from pointnetkl.reporting.closures import tables as closure_tables
from pointnetkl.reporting.closures.numbers import Closures
from pointnetkl.reporting.covariances import cases, method_plots
from pointnetkl.reporting.covariances import figures as covariance_figures
from pointnetkl.reporting.covariances import numbers as covariances
from pointnetkl.reporting.covariances import tables as covariance_tables
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.labels import figures as label_figures
from pointnetkl.reporting.labels import tables as label_tables
from pointnetkl.reporting.labels import training
from pointnetkl.reporting.results import Folders, Labels, Settings, Test
from pointnetkl.reporting.robustness import figures as robustness_figures
from pointnetkl.reporting.robustness import numbers as robustness
from pointnetkl.reporting.robustness import tables as robustness_tables
from pointnetkl.reporting.robustness.numbers import StressTest
from pointnetkl.reporting.slam import consistency
from pointnetkl.reporting.slam import figures as slam_figures
from pointnetkl.reporting.slam import numbers as slam
from pointnetkl.reporting.slam import tables as slam_tables
from pointnetkl.reporting.surveys import figures as survey_figures
from pointnetkl.reporting.surveys import numbers as surveys
from pointnetkl.reporting.surveys import tables as survey_tables
from pointnetkl.reporting.text_table import Block, Blocks, Numbers
from pointnetkl.surveys import voxel
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.study import Study

_IN_MARKDOWN = (  # tables for people; the others are for programs, and CSV alone
    *(
        "table_1",
        "table_2",
        "table_3",
        "table_4",
        "table_5",
        "labels",
        "label_quality",
        "label_accuracy",
        "label_noise",
    ),
    *("cleaning", "table_4_authors", "slam_variants"),
    *("terrain", "map_thinning", "calibration_lc", "robustness", "loop_gate"),
)
_TABLES_ONLY = ("by_class", "by_size", "by_copy", "slam_authors", "slam_variants")


@dataclass(frozen=True)
class Report:
    """What the stage writes, by path below its folder, and what it prints."""

    files: Mapping[str, bytes]
    lines: Sequence[str]


@dataclass(frozen=True)
class _Artifacts:
    """What was read of all surveys, by their names."""

    labels: Mapping[str, Labels]
    canonical: Mapping[str, voxel.Clouds]
    tests: Mapping[str, Test]
    closures: Mapping[str, Closures]
    training: Mapping[str, Mapping[str, float]]  # by method that learns, its KL in training and validation, nats
    losses: Mapping[str, pd.DataFrame]  # by model
    runtime: Mapping[str, Any]
    variations: pd.DataFrame  # schema label_table.VARIATIONS
    map_thinning: pd.DataFrame  # schema slam_tables.THINNING
    closings: Closings
    robustness: StressTest
    cleaned: Mapping[str, Mapping[str, Any]]  # survey_tables.read


def make(folders: Folders, settings: Settings) -> Report:
    """Return the whole report of the folders' study.

    Raises:
        ResultsError, ArtifactError: an artifact is missing, damaged, or does not belong to the others.
    """
    folders.demand()
    study, read = folders.study, _read(folders, settings)
    numbers = _numbers(folders, read, settings)
    tables = _tables(numbers, study, read)
    drawn = dict(_figures(folders, read, numbers, tables, settings))
    copies = {name: str(each.parameters["label"]["copy"]) for name, each in read.labels.items()}
    sections = words.sections(tables, numbers, copies, read.runtime)
    lead = words.lead(study, numbers["datasets"], read.labels, read.tests)
    title = f"PointNetKL: covariances of GICP registration, scale {study.scale}"
    metrics = known_only(published(numbers))
    larger_m2 = {name: read.labels[name].eigenvalues[:, 1] for name in study.test}
    files = {
        "headline.json": _json(headline.select(metrics, larger_m2)),
        "metrics.json": _json(metrics, sort_keys=True),
        **{f"tables/{name}": content for name, content in _table_files(tables)},
        **{f"figures/{name}.png": image for name, image in drawn.items()},
        "index.html": page.render(title, lead, sections, drawn).encode(),
    }
    return Report(files, words.comparison(numbers))


def published(numbers: Numbers) -> dict[str, Any]:
    """Return the numbers as metrics.json has them: of the terrain classes, only what decides between methods."""
    kept = {key: value for key, value in numbers.items() if key not in _TABLES_ONLY}
    for kind, wanted in (("kl", ("mean",)), ("calibration", ("nees", "coverage_95"))):
        kept[f"{kind}_by_class"] = {
            name: {terrain: _short(part[kind], wanted, part["submaps"]) for terrain, part in classes.items()}
            for name, classes in numbers["by_class"].items()
        }
    return kept


def known_only(numbers: Numbers) -> dict[str, Any]:
    """Return nested numbers rounded to 4 digits, without those that are not known."""
    rounded = {key: text_table.rounded(value) for key, value in numbers.items()}
    kept = {key: known_only(value) if isinstance(value, dict) else value for key, value in rounded.items()}
    return {key: value for key, value in kept.items() if value is not None and value != {}}


def _read(folders: Folders, settings: Settings) -> _Artifacts:
    study = folders.study
    labels = {name: results.read_labels(folders, name) for name in study.surveys}
    tests = {name: results.read_test(folders, name, labels[name]) for name in study.test}
    return _Artifacts(
        labels=labels,
        canonical={name: results.read_canonical(folders, name) for name in study.surveys},
        tests=tests,
        closures={name: closures.read(folders, name, labels[name], test) for name, test in tests.items()},
        training=training.read_divergences(folders, settings.kl_floor_m2),
        losses=training.read_losses(folders),
        runtime=artifacts.read_json(folders.reports / "runtime.json"),
        variations=results.read_variations(folders),
        map_thinning=slam_tables.read_thinning(folders.reports / "slam", study.test),
        closings=closing.read(folders.reports, study.test),
        robustness=robustness.read(folders.reports, study.test),
        cleaned=survey_tables.read(folders),
    )


def _numbers(folders: Folders, read: _Artifacts, settings: Settings) -> dict[str, Any]:
    study, datasets, slopes = folders.study, {}, {}
    for name, line in study.surveys.items():
        clouds, poses = results.read_points(folders, name)
        model = results.read_simulation(folders, name)
        slopes[name] = terrain.slopes(clouds, poses, *results.read_frame(folders, name), model)
        cell_m, pings = settings.cell_factor * line.point_spacing_m, results.read_pings(folders, name)
        datasets[name] = {
            "simulated": model is not None,
            "vehicle": model.vehicle if model else "unknown",
            **surveys.dataset(clouds, poses, pings, read.labels[name], read.canonical[name], cell_m),
        }
    classes, trained = terrain.by_survey(slopes, study.train, settings.terrain_classes)
    judged = {name: covariances.judged(read.labels[name], test) for name, test in read.tests.items()}
    kl = {name: covariances.divergences(name, each, settings) for name, each in judged.items()}
    return {
        "datasets": datasets,
        "kl": {**read.training.get(catalogue.POINTNETKL, {}), **kl},
        "calibration": {name: covariances.calibrations(each) for name, each in judged.items()},
        "calibration_lc": closures.calibrations(read.closures),
        "closures": {name: closures.sizes(each) for name, each in read.closures.items()},
        "closures_by_hold": {name: closures.by_hold(each) for name, each in read.closures.items()},
        "closure_ratios": {name: closures.dependence(each) for name, each in read.closures.items()},
        "terrain": {n: terrain.counts(classes[n], slopes[n], read.labels[n].q, trained) for n in study.surveys},
        "by_class": {n: covariances.by_class(n, each, classes[n], trained, settings) for n, each in judged.items()},
        "by_size": {name: covariances.by_size(each, settings) for name, each in judged.items()},
        "by_copy": {
            name: covariances.by_copy(name, read.labels[name], test, read.variations, settings)
            for name, test in read.tests.items()
        },
        "slam": {name: slam.summarise(name, test, settings) for name, test in read.tests.items()},
        "slam_authors": {name: slam.authors(name, test, settings) for name, test in read.tests.items()},
        "slam_variants": {name: slam.variants(test) for name, test in read.tests.items()},
        "closing": closing.summarise(read.closings.rows),
        **robustness.numbers(read.robustness),
    }


def _tables(numbers: Numbers, study: Study, read: _Artifacts) -> dict[str, list[Block]]:
    """Return every table by the stem of its files; the first block is what the CSV file has."""
    datasets = {
        name: {
            **each,
            "label_runs": study.surveys[name].label_runs,
            "self_matching": float(np.mean(read.labels[name].self_matching)),
        }
        for name, each in numbers["datasets"].items()
    }
    methods = list(dict.fromkeys(method for test in read.tests.values() for method in test.covariances))
    return {
        **survey_tables.every(read.cleaned, datasets),
        **label_tables.every(read.labels, read.variations, datasets),
        **covariance_tables.every(numbers, datasets, read.training, read.runtime, methods),
        **closure_tables.every(numbers, datasets),
        **slam_tables.every(numbers, read.map_thinning, datasets),
        **closing_tables.every(numbers, datasets),
        **robustness_tables.every(read.robustness, datasets),
    }


def _table_files(tables: Blocks) -> Iterator[tuple[str, bytes]]:
    for name, blocks in tables.items():
        frame = blocks[0].frame
        if "method" in frame and "survey" in frame:
            # DVC's plots have one name a bar
            frame = frame.assign(survey_method=frame["survey"] + " " + frame["method"])
        yield f"{name}.csv", text_table.csv(frame).encode()
        if name in _IN_MARKDOWN:
            yield f"{name}.md", text_table.markdown(blocks).encode()


def _figures(
    folders: Folders, read: _Artifacts, numbers: Numbers, tables: Blocks, settings: Settings
) -> Iterator[tuple[str, bytes]]:
    rng = np.random.default_rng(settings.seed)
    floor_m2 = settings.kl_floor_m2
    spacing = {name: float(np.median(labels.spacing_m)) for name, labels in read.labels.items()}
    frames = {name: blocks[0].frame for name, blocks in tables.items()}
    judged = [
        cases.Survey(name, results.read_points(folders, name)[0], read.labels[name], test, floor_m2)
        for name, test in read.tests.items()
    ]
    with_track = [name for name, test in read.tests.items() if test.track]
    sections = (
        survey_figures.every(folders, next(iter(folders.study.train)), read.canonical, rng),
        label_figures.every(read.labels, read.variations, read.losses, read.runtime, floor_m2),
        covariance_figures.every(judged, frames["kl"], frames["calibration"], read.runtime),
        closure_figures.every(frames["calibration_lc"], read.closures),
        slam_figures.every(judged, spacing, numbers),
        [("slam", method_plots.slam_error(frames["slam"]))],
        [("consistency", consistency.read_and_draw(folders, with_track))],
        closing_figures.every(read.closings, read.tests),
        robustness_figures.every(read.robustness),
    )
    for figures in sections:
        for name, figure in figures:
            yield name, plots.png(figure)


def _json(content: Numbers, sort_keys: bool = False) -> bytes:
    return (json.dumps(content, indent=2, sort_keys=sort_keys, allow_nan=False) + "\n").encode()


def _short(methods: Numbers, wanted: Sequence[str], submaps: int) -> dict[str, Any]:
    return {name: {**{key: each[key] for key in wanted}, "submaps": submaps} for name, each in methods.items()}
