"""Train and test PointNetKL on the paper's own data: Tables I and II from the arrays that its authors publish.

This script is not a stage of dvc.yaml, because not everyone has the arrays. Its parameters are in authors.yaml.
"""

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from pointnetkl.authors import consolidated
from pointnetkl.authors import tables as authors_tables
from pointnetkl.authors.consolidated import Consolidated
from pointnetkl.authors.tables import Predictions
from pointnetkl.models import model_file
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.samples import Samples
from pointnetkl.reporting import text_table
from pointnetkl.reporting.text_table import Block
from pointnetkl.training import checkpoint, dataset, device, loop
from pointnetkl.workflow import artifacts, command, parameters

_CHECKPOINT_S = 60.0


def main(arguments: argparse.Namespace) -> None:
    """Read all files, train, test, and write tables and model."""
    network_settings = parameters.read(arguments.params, "models.pointnetkl.network", network.Settings)
    training_settings = parameters.read(arguments.params, "models.pointnetkl.train", loop.CloudSettings)
    report_settings = {
        name: parameters.read(arguments.params, f"report.{name}", value_type)
        for name, value_type in (("kl_floor_m2", float), ("block_submaps", int), ("seed", int))
    }
    files = read([*arguments.train, *arguments.test])
    training_files, test_files = (
        {path.stem: files[path.stem] for path in paths} for paths in (arguments.train, arguments.test)
    )
    check_unseen(training_files, test_files)
    sets = dataset.split(
        consolidated.samples(training_files),
        training_settings.validation_share,
        training_settings.validation_blocks,
        training_settings.seed,
    )
    metadata = {
        "surveys": list(training_files),
        "tests": list(test_files),
        "sha256": {path.stem: digest(path) for path in (*arguments.train, *arguments.test)},
        "models": {
            "pointnetkl": {
                "network": parameters.as_metadata(network_settings),
                "train": parameters.as_metadata(training_settings),
            }
        },
        "report": report_settings,
    }

    progress = checkpoint.Checkpoint(arguments.out / "checkpoints", checkpoint.name(metadata, sets), _CHECKPOINT_S)
    model, outcome = train(network_settings, training_settings, sets, progress)
    table_2 = authors_tables.table_2(predict(model, sets, test_files), **report_settings)
    write_tables(arguments.out, {"table_1": authors_tables.table_1(files), "table_2": table_2})
    artifacts.write_bytes(arguments.out / "loss.csv", outcome.history.to_csv(index=False, float_format="%.6g").encode())
    provenance = {**metadata, "best_step": outcome.best_step, "steps": outcome.steps}
    content = model_file.to_bytes("pointnetkl", model, consolidated.VOXEL, provenance)
    artifacts.write_bytes(arguments.out / "pointnetkl.pt", content)
    artifacts.write_json(arguments.out / "parameters.json", provenance)
    progress.discard()
    print(text_table.markdown(table_2))


def read(paths: Sequence[Path]) -> dict[str, Consolidated]:
    """Return files by their stems; print the survey of each, and a warning where its prior differs from the paper's."""
    files: dict[str, Consolidated] = {}
    for path in paths:
        if path.stem in files:
            raise consolidated.ConsolidatedError(f"{path}: there is a {path.stem} before it; give each file once")
        files[path.stem] = consolidated.read(path)
        print(f"{path}: {len(files[path.stem])} submaps, {consolidated.SURVEYS.get(path.stem, 'not of the paper')}")
        if note := files[path.stem].prior_note():
            print(f"WARNING: {path}: {note}")
    return files


def check_unseen(training_files: Mapping[str, Consolidated], test_files: Mapping[str, Consolidated]) -> None:
    """Refuse a test submap that is also a training submap."""
    for test_name, test_file in test_files.items():
        for training_name, training_file in training_files.items():
            consolidated.check_unseen(test_file, training_file, (test_name, training_name))


def train(
    network_settings: network.Settings,
    training_settings: loop.CloudSettings,
    sets: tuple[Samples, Samples],
    progress: checkpoint.Checkpoint,
) -> tuple[network.PointNetKL, loop.Outcome]:
    """Train as stage `train` does; after an interruption, training continues from the last checkpoint."""
    torch_device = device.choose(training_settings.device)
    device.prepare(training_settings.seed, training_settings.threads, torch_device)
    model = network.PointNetKL(network_settings).to(torch_device)
    model.start(sets[0])
    outcome = loop.train(model, *sets, training_settings, progress)
    loop.finish(model, sets[0], training_settings)
    return model, outcome


def predict(
    model: network.PointNetKL, sets: Sequence[Samples], test_files: Mapping[str, Consolidated]
) -> dict[str, Predictions]:
    """Return labels and predictions for whole clouds: those of training, of validation, and of each test file."""
    samples_by_name = {"training": sets[0], "validation": sets[1]}
    samples_by_name |= {name: consolidated.samples({name: file}) for name, file in test_files.items()}
    constant = sets[0].label.mean(axis=0)
    return {
        name: Predictions(samples.label, loop.predict(model, samples), constant)
        for name, samples in samples_by_name.items()
    }


def write_tables(folder: Path, tables: Mapping[str, Sequence[Block]]) -> None:
    """Write each table's first block as CSV, and all of them as Markdown."""
    for name, blocks in tables.items():
        artifacts.write_bytes(folder / f"{name}.csv", text_table.csv(blocks[0].frame).encode())
        artifacts.write_bytes(folder / f"{name}.md", text_table.markdown(blocks).encode())


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--train", type=Path, nargs="+", required=True, help="arrays to train and validate on")
    parser.add_argument("--test", type=Path, nargs="+", required=True, help="arrays to test on")
    parser.add_argument("--out", type=Path, default=Path("reports/authors"), help="folder for tables and model")
    parser.set_defaults(params=Path("authors.yaml"))
    command.run(main, parser)
