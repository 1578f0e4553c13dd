"""The report: metrics.json, tables, figures and the page, as bytes by file name, from every stage's artifacts."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl import simulation
from pointnetkl.reporting import page, results, tables, terrain, text_table
from pointnetkl.reporting import words as story
from pointnetkl.reporting.closures import figures as calibration_plots
from pointnetkl.reporting.closures import numbers as closures
from pointnetkl.reporting.closures import tables as closure_tables
from pointnetkl.reporting.closures.numbers import Closures
from pointnetkl.reporting.covariances import cases, figures
from pointnetkl.reporting.covariances import numbers as summary
from pointnetkl.reporting.covariances import tables as class_tables
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.labels import numbers as label_study
from pointnetkl.reporting.labels import tables as label_tables
from pointnetkl.reporting.results import Folders, Labels, Settings, Test
from pointnetkl.reporting.robustness import figures as robustness_plots
from pointnetkl.reporting.robustness import numbers as robustness
from pointnetkl.reporting.robustness import tables as robustness_tables
from pointnetkl.reporting.slam import consistency
from pointnetkl.reporting.slam import figures as slam_figures
from pointnetkl.reporting.slam import numbers as slam_summary
from pointnetkl.reporting.slam import tables as slam_tables
from pointnetkl.reporting.surveys import tables as cleaning_tables
from pointnetkl.reporting.text_table import Block
from pointnetkl.surveys import voxel
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.study import Study

_IN_WORDS = (
    *("table_1", "table_2", "table_3", "table_4", "labels", "label_quality", "label_accuracy", "label_noise"),
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
class _Found:
    """What was read of all surveys."""

    labels: Mapping[str, Labels]
    canonical: Mapping[str, voxel.Clouds]
    tests: Mapping[str, Test]
    closures: Mapping[str, Closures]
    training: Mapping[str, Mapping[str, float]]  # by method that learns, its KL in training and validation, nats
    runtime: Mapping[str, Any]
    variations: pd.DataFrame  # schema results.VARIATIONS
    map_thinning: pd.DataFrame  # schema slam_tables.THINNING
    wrong: robustness.Found
    cleaned: Mapping[str, Mapping[str, Any]]  # cleaning_tables.read


def make(folders: Folders, study: Study, simulate: Mapping[str, simulation.Settings], settings: Settings) -> Report:
    """Return the whole report of a study.

    Raises:
        ResultsError, ArtifactError: an artifact is missing, damaged, or does not belong to the others.
    """
    folders.demand(study)
    found = _read(folders, study, settings)
    numbers = _numbers(folders, study, simulate, found, settings)
    shown = _tables(numbers, study, found)
    drawn = dict(_figures(folders, study, found, numbers, shown, settings))
    text = story.sections(shown, numbers, found.labels)
    lead = story.lead(study, numbers["datasets"], found.labels, found.tests)
    title = f"PointNetKL: covariances of GICP registration, scale {study.scale}"
    files = {
        "metrics.json": _json(known_only(published(numbers))),
        **{f"tables/{name}": content for name, content in _table_files(shown)},
        **{f"figures/{name}.png": image for name, image in drawn.items()},
        "index.html": page.render(title, lead, text, drawn).encode(),
    }
    return Report(files, story.comparison(numbers))


def _read(folders: Folders, study: Study, settings: Settings) -> _Found:
    labels = {name: results.read_labels(folders, name) for name in study.surveys}
    clouds = {name: folders.data / f"clouds/{name}.npz" for name in study.surveys}
    tests = {name: results.read_test(folders, name, labels[name]) for name in study.test}
    return _Found(
        labels=labels,
        canonical={
            n: voxel.Clouds.from_arrays(artifacts.read_arrays(path)[0], str(path)) for n, path in clouds.items()
        },
        tests=tests,
        closures={name: closures.read(folders, name, labels[name], test) for name, test in tests.items()},
        training=results.read_training(folders, study.models, settings.kl_floor_m2),
        runtime=artifacts.read_json(folders.reports / "runtime.json"),
        variations=results.read_variations(folders, study),
        map_thinning=slam_tables.read_thinning(folders.reports / "slam", study.test),
        wrong=robustness.read(folders, study.test),
        cleaned=cleaning_tables.read(folders.data, study.surveys),
    )


def _numbers(
    folders: Folders, study: Study, simulate: Mapping[str, simulation.Settings], found: _Found, settings: Settings
) -> dict[str, Any]:
    datasets, slopes = {}, {}
    for name, line in study.surveys.items():
        clouds, poses = results.read_points(folders, name)
        simulated = summary.simulated_from(line.raw, simulate)
        chosen = simulate[simulated] if simulated else None
        slopes[name] = terrain.slopes(clouds, poses, *results.read_frame(folders, name), chosen)
        datasets[name] = {
            "simulated": chosen is not None,
            "vehicle": chosen.vehicle if chosen else "unknown",
            **summary.dataset(
                clouds,
                poses,
                results.read_pings(folders, name),
                found.labels[name],
                found.canonical[name],
                settings.cell_factor * line.point_spacing_m,
            ),
        }
    classes, trained = terrain.of_surveys(slopes, study.train, settings.terrain_classes)
    judged = {name: summary.judged(found.labels[name], test) for name, test in found.tests.items()}
    kl = {name: summary.divergences(name, each, settings) for name, each in judged.items()}
    return {
        "datasets": datasets,
        "kl": {**found.training.get("pointnetkl", {}), **kl},
        "calibration": {name: summary.calibrations(each) for name, each in judged.items()},
        "calibration_lc": closures.calibrations(found.closures),
        "closures": {name: closures.sizes(of) for name, of in found.closures.items()},
        "closures_by_hold": {name: closures.by_hold(of) for name, of in found.closures.items()},
        "closure_ratios": {name: closures.dependence(of) for name, of in found.closures.items()},
        "terrain": {n: terrain.counts(classes[n], slopes[n], found.labels[n].q, trained) for n in study.surveys},
        "by_class": {n: summary.by_class(n, each, classes[n], trained, settings) for n, each in judged.items()},
        "by_size": {name: summary.by_size(each, settings) for name, each in judged.items()},
        "by_copy": {
            name: summary.by_copy(name, found.labels[name], test, found.variations, settings)
            for name, test in found.tests.items()
        },
        "slam": {name: slam_summary.summarise(name, test, settings) for name, test in found.tests.items()},
        "slam_authors": {name: slam_summary.authors(name, test, settings) for name, test in found.tests.items()},
        "slam_variants": {name: slam_summary.variants(test) for name, test in found.tests.items()},
        **robustness.numbers(found.wrong),
    }


def _tables(numbers: Mapping[str, Any], study: Study, found: _Found) -> dict[str, list[Block]]:
    """Return every table by the stem of its files; the first block is what the CSV file has."""
    datasets = {
        name: {
            **each,
            "label_runs": study.surveys[name].label_runs,
            "self_matching": float(np.mean(found.labels[name].self_matching)),
        }
        for name, each in numbers["datasets"].items()
    }
    eigenvalues = {name: np.linalg.eigvalsh(labels.q[:, :2, :2]) for name, labels in found.labels.items()}
    rows = {name: labels.rows for name, labels in found.labels.items()}
    kl, slam = tables.divergences(numbers["kl"], datasets), slam_tables.slam_errors(numbers["slam"], datasets)
    methods = dict.fromkeys(method for test in found.tests.values() for method in test.covariances)
    return {
        "table_1": tables.table_1(datasets),
        "cleaning": cleaning_tables.cleaning(found.cleaned, datasets),
        "table_2": [*tables.table_2(numbers["kl"], datasets, found.training), kl],
        "table_3": tables.table_3(found.runtime, methods),
        "table_4": [
            *slam_tables.table_4(numbers["slam"], datasets),
            slam,
            slam_tables.draws(numbers["slam"], datasets),
        ],
        "labels": [tables.label_quantiles(eigenvalues, datasets)],
        "label_quality": [label_tables.quality(rows, datasets)],
        "label_accuracy": [label_tables.accuracy(label_study.accuracy(found.variations), datasets)],
        "label_noise": [label_tables.noise(label_study.by_noise(found.variations), datasets)],
        "label_conditions": [label_tables.conditions(label_study.conditions(found.variations), datasets)],
        "kl": [kl],
        "calibration": [tables.calibrations(numbers["calibration"], datasets)],
        "slam": [slam],
        **slam_tables.every(numbers, datasets),
        "map_thinning": [slam_tables.thinning(found.map_thinning, datasets)],
        **robustness_tables.tables(found.wrong, datasets),
        **closure_tables.every(numbers, datasets),
        **class_tables.every(numbers, datasets),
    }


def _table_files(shown: Mapping[str, Sequence[Block]]) -> Iterator[tuple[str, bytes]]:
    for name, blocks in shown.items():
        frame = blocks[0].frame
        if "method" in frame and "survey" in frame:
            # DVC's plots have one name a bar
            frame = frame.assign(survey_method=frame["survey"] + " " + frame["method"])
        yield f"{name}.csv", text_table.csv(frame).encode()
        if name in _IN_WORDS:
            yield f"{name}.md", text_table.markdown(blocks).encode()


def _figures(
    folders: Folders,
    study: Study,
    found: _Found,
    numbers: Mapping[str, Any],
    shown: Mapping[str, Sequence[Block]],
    settings: Settings,
) -> Iterator[tuple[str, bytes]]:
    rng = np.random.default_rng(settings.seed)
    eigenvalues = {name: np.linalg.eigvalsh(labels.q[:, :2, :2]) for name, labels in found.labels.items()}
    spacing = {name: float(np.median(labels.spacing_m)) for name, labels in found.labels.items()}
    prior = float(next(iter(found.labels.values())).parameters["label"]["prior_variance_m2"])
    kl, calibration, slam = (shown[name][0].frame for name in ("kl", "calibration", "slam"))
    yield "swath", plots.png(figures.swath(folders, next(iter(study.train))))
    yield "canonical", plots.png(figures.canonical(found.canonical, rng))
    yield "training", plots.png(plots.training(results.read_losses(folders, study.models)))
    yield "labels", plots.png(plots.eigenvalues(eigenvalues, prior, settings.kl_floor_m2))
    for name, figure in figures.labels(found.variations, prior, found.runtime):
        yield name, plots.png(figure)
    surveys = [
        cases.Survey(name, results.read_points(folders, name)[0], found.labels[name], test, settings.kl_floor_m2)
        for name, test in found.tests.items()
    ]
    yield "submaps", plots.png(figures.submaps(surveys))
    for name, figure in figures.worst(surveys):
        yield f"worst/{name}", plots.png(figure)
    yield "reliability", plots.png(figures.reliability(surveys))
    for name, figure in calibration_plots.every(shown["calibration_lc"][0].frame, found.closures):
        yield name, plots.png(figure)
    for name, figure in robustness_plots.figures(found.wrong):
        yield name, plots.png(figure)
    yield (
        "consistency",
        plots.png(consistency.read_and_draw(folders, [n for n, test in found.tests.items() if test.track])),
    )
    for name, figure in slam_figures.figures(surveys, spacing, numbers):
        yield name, plots.png(figure)
    for name, figure in figures.charts(kl, calibration, slam, found.runtime):
        yield name, plots.png(figure)


def published(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers as metrics.json has them: of the terrain classes, only what decides between methods."""
    kept = {key: value for key, value in numbers.items() if key not in _TABLES_ONLY}
    for kind, wanted in (("kl", ("mean",)), ("calibration", ("nees", "coverage_95"))):
        kept[f"{kind}_by_class"] = {
            name: {each: _short(of[kind], wanted, of["submaps"]) for each, of in classes.items()}
            for name, classes in numbers["by_class"].items()
        }
    return kept


def known_only(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested numbers rounded to 4 digits, without those that are not known."""
    rounded = {key: text_table.rounded(value) for key, value in numbers.items()}
    kept = {key: known_only(value) if isinstance(value, dict) else value for key, value in rounded.items()}
    return {key: value for key, value in kept.items() if value is not None and value != {}}


def _short(methods: Mapping[str, Any], wanted: Sequence[str], submaps: int) -> dict[str, Any]:
    return {name: {**{key: of[key] for key in wanted}, "submaps": submaps} for name, of in methods.items()}


def _json(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
