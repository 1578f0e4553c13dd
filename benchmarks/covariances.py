"""KL divergence and calibration of every method, without the SLAM that a report needs; and leave-one-class-out.

For runs too large to finish: it reads what label, train, estimate and predict have made below --data, --models and
--reports, of the test surveys that have labels and covariances. It writes below --out: covariances.json, kl.csv, Table
II (tables/table_2), every measure by terrain class and by the size of the label (tables/terrain, classes.csv), how each
model was trained (loss_<model>.csv, figures/training.png, models/<model>.md), the submaps that --drawn is worst and
best at (figures/), and leave_one_class_out.csv. Of surveys that stages calibrate and close have been through it writes
the errors of their loop closures (tables/calibration_lc) and Table V (tables/table_5) as well.
"""

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.models import model, model_file
from pointnetkl.models.model_file import Stored
from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.reporting import model_card, report, results, terrain, text_table
from pointnetkl.reporting.closing import numbers as closing_numbers
from pointnetkl.reporting.closing import tables as closing_tables
from pointnetkl.reporting.closures import numbers as closures
from pointnetkl.reporting.closures import tables as closure_tables
from pointnetkl.reporting.covariances import cases, ellipse_plots, tables
from pointnetkl.reporting.covariances import numbers as summary
from pointnetkl.reporting.covariances.numbers import Judged
from pointnetkl.reporting.drawing import plots
from pointnetkl.reporting.labels import figures as label_figures
from pointnetkl.reporting.labels import training
from pointnetkl.training import dataset, device, loop
from pointnetkl.workflow import artifacts, parameters
from pointnetkl.workflow import study as studies


def main(arguments: argparse.Namespace) -> None:
    """Judge every survey, then leave out one class after the other."""
    params = arguments.params
    folders = results.Folders(arguments.data, arguments.models, arguments.reports, studies.read(params))
    chosen = parameters.read(params, "report", results.Settings)
    study = folders.study
    judged = {name: read(folders, name) for name in study.test if complete(folders, name)}
    known = [name for name in study.train if (folders.data / "train" / name).is_dir()]
    slopes = {name: of_survey(folders, name) for name in [*known, *judged]}
    classes, trained = terrain.by_survey(slopes, known, chosen.terrain_classes)
    numbers = {
        "kl": {name: summary.divergences(name, of, chosen) for name, of in judged.items()},
        "calibration": {name: summary.calibrations(of) for name, of in judged.items()},
        "by_class": {name: summary.by_class(name, of, classes[name], trained, chosen) for name, of in judged.items()},
        "by_size": {name: summary.by_size(of, chosen) for name, of in judged.items()},
        "submaps": {name: len(classes[name]) for name in classes},
    }
    write_tables(arguments.out, numbers, training.read_divergences(folders, chosen.kl_floor_m2))
    write_trainings(arguments.out, folders)
    closing = [name for name in judged if folders.product(name, "closure_ends.parquet").exists()]
    if closing:
        write_closures(arguments.out, folders, {name: judged[name] for name in closing}, numbers)
    draw(arguments, folders, judged, chosen)
    write(arguments.out, "covariances.json", json.dumps(report.known_only(report.published(numbers)), indent=2) + "\n")
    write(arguments.out, "kl.csv", text_table.csv(pd.DataFrame(kl_rows(numbers))))
    write(arguments.out, "classes.csv", text_table.csv(pd.DataFrame(class_rows(numbers))))
    if arguments.network:
        rows = left_out(arguments, known, classes, judged, folders, chosen)
        write(arguments.out, "leave_one_class_out.csv", text_table.csv(pd.DataFrame(rows)))


def write_tables(out: Path, numbers: dict[str, Any], trained: dict[str, dict[str, float]]) -> None:
    """Write Table II, and the measures by terrain class and by the size of the label."""
    datasets = {name: {"simulated": True} for name in numbers["kl"]}
    table_2 = [*tables.table_2(numbers["kl"], datasets, trained), tables.divergences(numbers["kl"], datasets)]
    split = [*tables.by_class(numbers["by_class"], datasets)[1:], *tables.by_size(numbers["by_size"], datasets)[1:]]
    write(out, "tables/table_2.csv", text_table.csv(table_2[0].frame))
    for name, blocks in (("table_2", table_2), ("terrain", split)):
        write(out, f"tables/{name}.md", text_table.markdown(blocks))


def write_closures(out: Path, folders: results.Folders, judged: dict[str, Judged], numbers: dict[str, Any]) -> None:
    """Write what is known of the loop closures of these surveys, and Table V."""
    found = {name: closures.read(folders, name, results.read_labels(folders, name), of) for name, of in judged.items()}
    numbers |= {
        "calibration_lc": closures.calibrations(found),
        "closures": {name: closures.sizes(of) for name, of in found.items()},
        "closures_by_hold": {name: closures.by_hold(of) for name, of in found.items()},
        "closure_ratios": {name: closures.dependence(of) for name, of in found.items()},
        "closing": closing_numbers.summarise(closing_numbers.read(folders.reports, found).rows),
    }
    datasets = {name: {"simulated": True} for name in found}
    for name, blocks in {**closure_tables.every(numbers, datasets), **closing_tables.every(numbers, datasets)}.items():
        write(out, f"tables/{name}.csv", text_table.csv(blocks[0].frame))
        write(out, f"tables/{name}.md", text_table.markdown(blocks))


def write_trainings(out: Path, folders: results.Folders) -> None:
    """Write the losses of every model by step, their figure and the models' cards."""
    losses = training.read_losses(folders)
    for name in losses:
        write(out, f"loss_{name}.csv", (folders.reports / f"train/{name}.csv").read_text())
    artifacts.write_bytes(out / "figures/training.png", plots.png(label_figures.training(losses)))
    for path, content in model_card.files(folders).items():
        artifacts.write_bytes(out / path, content)


def draw(
    arguments: argparse.Namespace, folders: results.Folders, judged: dict[str, Judged], chosen: results.Settings
) -> None:
    """Draw the ten submaps that a method is worst at, and the ten that it is best at, of all test surveys."""
    surveys = [
        cases.Survey(
            *(name, results.read_points(folders, name)[0], results.read_labels(folders, name), of, chosen.kl_floor_m2)
        )
        for name, of in judged.items()
    ]
    for name, choose, kl in (("worst", cases.worst, "largest"), ("best", cases.best, "smallest")):
        for method in arguments.drawn:
            figure = ellipse_plots.worst(method, choose(surveys, method, 10), kl)
            artifacts.write_bytes(arguments.out / f"figures/{name}_{method}.png", plots.png(figure))


def complete(folders: results.Folders, name: str) -> bool:
    """Whether a survey has labels and both covariance tables."""
    return all(folders.product(name, f"{kind}.parquet").exists() for kind in ("estimated", "predicted"))


def read(folders: results.Folders, name: str) -> Judged:
    """Read a survey's labels, covariances and held-out errors."""
    labels = results.read_labels(folders, name)
    tables = [
        artifacts.read_table(folders.product(name, f"{kind}.parquet"), table.SCHEMA, also=table.YAW)
        for kind in ("estimated", "predicted")
    ]
    covariances = {
        str(method): table.to_matrices(rows.sort_values("submap"))
        for method, rows in pd.concat(tables).groupby("method", sort=False)
    }
    held_out = artifacts.read_arrays(folders.product(name, "errors.npz"))[0]["held_out"]
    return Judged(labels.q, covariances, held_out)


def of_survey(folders: results.Folders, name: str) -> pd.DataFrame:
    """Return the slopes of a survey's submaps, by which they are classed."""
    clouds, poses = results.read_points(folders, name)
    return terrain.slopes(clouds, poses, *results.read_frame(folders, name), results.read_simulation(folders, name))


def kl_rows(numbers: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row a survey and method."""
    for name, methods in numbers["kl"].items():
        for method, kl in methods.items():
            yield {"survey": name, "method": method, **kl, **numbers["calibration"][name].get(method, {})}
        yield {"survey": name, "method": results.GOLD, **numbers["calibration"][name].get(results.GOLD, {})}


def class_rows(numbers: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row a survey, class and method."""
    for name, classes in numbers["by_class"].items():
        for each, of in classes.items():
            for method, kl in of["kl"].items():
                which = {"survey": name, "terrain": each, "in_training": of["in_training"], "submaps": of["submaps"]}
                yield {**which, "method": method, "mean": kl["mean"], "median": kl["median"]}


def left_out(
    arguments: argparse.Namespace,
    known: list[str],
    classes: dict[str, np.ndarray],
    judged: dict[str, Judged],
    folders: results.Folders,
    chosen: results.Settings,
) -> list[dict[str, Any]]:
    """Return mean KL on each class of `network` that was trained without it, beside one trained with all."""
    stored = model_file.read(arguments.network)
    how = parameters.read(arguments.params, "models.network.train", loop.Settings)
    samples, _ = dataset.read(arguments.data / "train", known)
    describe = stored.model.describe
    if describe is None:
        raise SystemExit(f"{arguments.network}: holds a model of the kind {stored.kind}, must be mean_field")
    samples = dataset.with_descriptions(arguments.data / "train", samples, describe)
    of_sample = np.concatenate([classes[name] for name in known])
    seen = {name: np.stack([describe(points) for points in results.read_points(folders, name)[0]]) for name in judged}
    rows = []
    for each in sorted(set(of_sample)):
        models = {"all": samples, "without": samples.take(np.flatnonzero(of_sample != each))}
        answers = {key: fit(stored, part, how) for key, part in models.items()}
        for name, of in judged.items():
            if np.any(where := classes[name] == each):
                kl = {
                    key: gaussian.divergence(
                        of.labels[where], model.predict(found, (seen[name][where],)), chosen.kl_floor_m2
                    ).mean()
                    for key, found in answers.items()
                }
                left = {"terrain": each, "left_out": int(np.sum(of_sample == each))}
                rows.append({**left, "survey": name, "submaps": int(where.sum()), **kl})
                print(rows[-1])
    return rows


def fit(stored: Stored, samples: Samples, how: loop.Settings) -> model.Model:
    """Return a model like the stored one, trained on these samples."""
    device.prepare(how.seed, how.threads, device.choose("cpu"))
    made = model_file.kind(stored.kind)[1](dataclasses.replace(stored.model.settings))
    sets = dataset.split(samples, how.validation_share, how.validation_blocks, how.seed)
    made.start(sets[0])
    loop.train(made, *sets, how)
    return made.eval()


def write(folder: Path, name: str, text: str) -> None:
    """Write a file, whole or not at all."""
    artifacts.write_bytes(folder / name, text.encode())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--models", type=Path, default=Path("models"))
    parser.add_argument("--reports", type=Path, default=Path("reports"))
    parser.add_argument("--drawn", nargs="*", default=["pointnetkl"], metavar="METHOD")
    parser.add_argument("--network", type=Path, help="a trained model of the kind mean_field: leave out classes too")
    parser.add_argument("--out", type=Path, required=True)
    main(parser.parse_args())
