"""What more submaps and more steps are worth to a model: it is trained on random parts of the training submaps.

All parts are validated on the same submaps, and judged on the test surveys. The smaller parts are among the larger. A
batch has no more submaps than the part. With --slopes each point has those of its plane, through 20 neighbours,
besides. The last state of each training is kept in --out (some 140 MB): a second run with the same settings and data
goes on from there.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from pointnetkl.models import model_file
from pointnetkl.models.point_mlp import PointMLP
from pointnetkl.models.pointnetkl import PointNetKL, TransformNet
from pointnetkl.models.samples import Samples
from pointnetkl.registration import gicp
from pointnetkl.registration.covariance import gaussian
from pointnetkl.training import checkpoint, dataset, device, loop
from pointnetkl.workflow import artifacts, parameters
from pointnetkl.workflow import study as studies


def main(arguments: argparse.Namespace) -> None:
    """Train on each part, and write learning_curve.csv and a loss_<submaps>.csv for each."""
    study = studies.read(arguments.params)
    kind = parameters.read(arguments.params, f"models.{arguments.model}.kind", str)
    if kind != "pointnetkl":
        raise SystemExit(f"{arguments.params}: models.{arguments.model}.kind is {kind}, must be pointnetkl here")
    settings = parameters.read(arguments.params, f"models.{arguments.model}.train", loop.KINDS[kind])
    settings = dataclasses.replace(settings, **dict(map(setting, arguments.train)))
    samples, _ = dataset.read(arguments.data / "train", list(study.train))
    training, validation = dataset.split(samples, settings.validation_share, settings.validation_blocks, settings.seed)
    judged = {"validation": validation}
    judged |= {name: dataset.read(arguments.data / "test", [name])[0] for name in study.test}
    if arguments.slopes:
        registration = parameters.read(arguments.params, "registration", gicp.Settings)
        judged = {name: with_slopes(samples, registration) for name, samples in judged.items()}
    order = np.random.default_rng(arguments.seed).permutation(len(training))
    rows = []
    for submaps in arguments.submaps:
        part = training.take(np.sort(order[:submaps]))
        if arguments.slopes:
            part = with_slopes(part, registration)
        rows.append(judge(arguments, kind, settings, part, judged))
        artifacts.write_bytes(arguments.out / "learning_curve.csv", pd.DataFrame(rows).to_csv(index=False).encode())
    print(pd.DataFrame(rows).to_string(index=False))


def with_slopes(samples: Samples, registration: gicp.Settings) -> Samples:
    """Return clouds whose points (n, 6) have the slopes of their plane, and the square of the steepest, besides.

    They are 5 and 25 times as large as they are, to be of the order of the coordinates in the unit sphere.
    """
    clouds = []
    for points, radius in zip(samples.clouds, samples.radius.astype(np.float64), strict=True):
        cloud = gicp.prepare(points * radius, registration)
        slopes = -5.0 * cloud.normals[:, :2] / cloud.normals[:, 2:]
        columns = [cloud.points / radius, slopes, np.sum(slopes**2, axis=1)]
        clouds.append(np.column_stack(columns).astype(np.float32))
    return dataclasses.replace(samples, clouds=clouds)


def widened(model: PointNetKL) -> PointNetKL:
    """Return a model whose first layers take six numbers a point."""
    model.phi.input_transform, model.phi.local = TransformNet(6), PointMLP((6, 64, 64))
    return model


def setting(text: str) -> tuple[str, Any]:
    """Return the name and the value of a setting, of name=value."""
    name, _, value = text.partition("=")
    return name, yaml.safe_load(value)


def judge(
    arguments: argparse.Namespace, kind: str, settings: loop.Settings, part: Samples, judged: dict[str, Samples]
) -> dict[str, float]:
    """Train a model on a part, and return its mean KL (nats) there and on each set of submaps."""
    processor = device.choose(settings.device)
    device.prepare(settings.seed, settings.threads, processor)
    form, new = model_file.kind(kind)
    model = new(parameters.read(arguments.params, f"models.{arguments.model}.network", form))
    model = (widened(model) if arguments.slopes else model).to(processor)
    model.start(part)
    settings = dataclasses.replace(settings, batch=min(settings.batch, len(part)))
    decides = {"train": parameters.as_metadata(settings), "network": parameters.as_metadata(model.settings)}
    decides["slopes"] = arguments.slopes
    sets = part, judged["validation"]
    kept = checkpoint.Checkpoint(arguments.out / f"checkpoints_{len(part)}", checkpoint.name(decides, sets), 60.0)
    losses = arguments.out / f"loss_{len(part)}.csv"

    def watch(history: pd.DataFrame) -> None:
        artifacts.write_bytes(losses, history.to_csv(index=False, float_format="%.6g").encode())

    outcome = loop.train(model, *sets, settings, kept, watch)
    loop.finish(model, part, settings)
    kept.discard_others()
    kl = {name: mean_kl(loop.predict(model, s), s.label) for name, s in {"training": part, **judged}.items()}
    return {"submaps": len(part), "steps": outcome.steps, "best_step": outcome.best_step, **kl}


def mean_kl(q: np.ndarray, label: np.ndarray) -> float:
    """Return the mean KL(label || Q), nats, at the floor where methods are judged."""
    floor = gaussian.KL_FLOOR_M2
    pair = gaussian.with_floor(label, floor), gaussian.with_floor(q, floor)
    return float(f"{np.mean(gaussian.kl_divergence(*pair)):.4g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--model", default="pointnetkl", help="its name in section models of the parameters")
    parser.add_argument("--submaps", type=int, nargs="+", default=[100, 400, 1700])
    parser.add_argument(
        "--train", nargs="+", default=[], metavar="NAME=VALUE", help="other than in models.<model>.train"
    )
    parser.add_argument(
        "--slopes",
        action="store_true",
        help="give each point the slopes of its plane: do neighbours tell what is missing?",
    )
    parser.add_argument("--seed", type=int, default=0, help="of which submaps are in a part")
    parser.add_argument("--out", type=Path, required=True)
    main(parser.parse_args())
