"""Train PointNetKL on the paper's own data and test it there: Tables I and II from the arrays that its authors publish.

It is no stage of dvc.yaml, because not everyone has the arrays; its parameters are in authors.yaml.
"""

import argparse
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from pointnetkl import training
from pointnetkl.authors import consolidated
from pointnetkl.authors import tables as consolidated_tables
from pointnetkl.authors.consolidated import Consolidated
from pointnetkl.authors.tables import Judged
from pointnetkl.models import model_file
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.samples import Samples
from pointnetkl.reporting import text_table
from pointnetkl.reporting.text_table import Block
from pointnetkl.training import checkpoint, dataset, device
from pointnetkl.workflow import artifacts, command, parameters

_CHECKPOINT_S = 60.0


def main(arguments: argparse.Namespace) -> None:
    """Read all files, train, test, write everything."""
    kind = parameters.read(arguments.params, "models.pointnetkl.network", network.Settings)
    chosen = parameters.read(arguments.params, "models.pointnetkl.train", training.CloudSettings)
    judging = {
        name: parameters.read(arguments.params, f"report.{name}", of)
        for name, of in (("kl_floor_m2", float), ("block_submaps", int), ("seed", int))
    }
    files = read([*arguments.train, *arguments.test])
    learned, tests = ({path.stem: files[path.stem] for path in paths} for paths in (arguments.train, arguments.test))
    check_apart(learned, tests)
    sets = dataset.split(consolidated.samples(learned), chosen.validation_share, chosen.validation_blocks, chosen.seed)
    metadata = {
        "surveys": list(learned),
        "tests": list(tests),
        "sha256": {path.stem: digest(path) for path in (*arguments.train, *arguments.test)},
        "models": {"pointnetkl": {"network": parameters.as_metadata(kind), "train": parameters.as_metadata(chosen)}},
        "report": judging,
    }

    kept = checkpoint.Checkpoint(arguments.out / "checkpoints", checkpoint.name(metadata, sets), _CHECKPOINT_S)
    model, outcome = train(kind, chosen, sets, kept)
    table_2 = consolidated_tables.table_2(judge(model, sets, tests), **judging)
    write_tables(arguments.out, {"table_1": consolidated_tables.table_1(files), "table_2": table_2})
    artifacts.write_bytes(arguments.out / "loss.csv", outcome.history.to_csv(index=False, float_format="%.6g").encode())
    made_by = {**metadata, "best_step": outcome.best_step, "steps": outcome.steps}
    stored = model_file.to_bytes("pointnetkl", model, consolidated.VOXEL, made_by)
    artifacts.write_bytes(arguments.out / "pointnetkl.pt", stored)
    artifacts.write_json(arguments.out / "parameters.json", made_by)
    kept.discard()
    print(text_table.markdown(table_2))


def read(paths: Sequence[Path]) -> dict[str, Consolidated]:
    """Return files by their stems, and say of each what it is and where it differs from the paper."""
    files: dict[str, Consolidated] = {}
    for path in paths:
        if path.stem in files:
            raise consolidated.ConsolidatedError(f"{path}: there is a {path.stem} before it; give each file once")
        files[path.stem] = consolidated.read(path)
        print(f"{path}: {len(files[path.stem])} submaps, {consolidated.SURVEYS.get(path.stem, 'not of the paper')}")
        if note := files[path.stem].prior_note():
            print(f"WARNING: {path}: {note}")
    return files


def check_apart(learned: Mapping[str, Consolidated], tests: Mapping[str, Consolidated]) -> None:
    """Refuse a test submap that is trained on."""
    for test, file in tests.items():
        for name, trained in learned.items():
            consolidated.check_unseen(file, trained, (test, name))


def train(
    kind: network.Settings,
    chosen: training.CloudSettings,
    sets: tuple[Samples, Samples],
    kept: checkpoint.Checkpoint,
) -> tuple[network.PointNetKL, training.Outcome]:
    """Train as stage train does; killed and started again it goes on from the last checkpoint."""
    where = device.choose(chosen.device)
    device.prepare(chosen.seed, chosen.threads, where)
    model = network.PointNetKL(kind).to(where)
    model.start(sets[0])
    outcome = training.train(model, *sets, chosen, kept)
    training.finish(model, sets[0], chosen)
    return model, outcome


def judge(model: network.PointNetKL, sets: Sequence[Samples], tests: Mapping[str, Consolidated]) -> dict[str, Judged]:
    """Return labels and predictions of whole clouds: training, validation, then each test file."""
    every = {"training": sets[0], "validation": sets[1]}
    every |= {name: consolidated.samples({name: file}) for name, file in tests.items()}
    constant = sets[0].label.mean(axis=0)
    return {name: Judged(each.label, training.predict(model, each), constant) for name, each in every.items()}


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
