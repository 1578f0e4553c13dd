"""Train PointNetKL on the training surveys' labels; write the model, its losses and how good it is."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl import artifacts, command, dataset, model_file, network, settings, study, training
from pointnetkl.covariance import gaussian


def main(arguments: argparse.Namespace) -> None:
    """Train, and write everything."""
    chosen = settings.read(arguments.params, "train", training.Settings)
    kind = settings.read(arguments.params, "network", network.Settings)
    surveys = list(study.read(arguments.params).train)
    samples, voxel = dataset.read(arguments.training, surveys)
    sets = dataset.split(samples, chosen.validation_share, chosen.validation_blocks, chosen.seed)

    training.prepare(chosen.seed, chosen.threads)
    model = network.PointNetKL(kind)
    training.start_at_mean(model, sets[0], chosen.label_floor_m2)
    outcome = training.train(model, *sets, chosen)
    training.finish(model, sets[0], chosen)

    parameters = {"surveys": surveys, "train": settings.as_metadata(chosen)}
    artifacts.write_bytes(arguments.model, model_file.to_bytes(model, voxel, parameters))
    artifacts.write_bytes(arguments.onnx, model_file.to_onnx(model))
    artifacts.write_bytes(arguments.loss, outcome.history.to_csv(index=False, float_format="%.6g").encode())
    artifacts.write_json(arguments.summary, summary(model, sets, outcome, chosen.label_floor_m2))


def summary(
    model: network.PointNetKL, sets: tuple[dataset.Samples, dataset.Samples], outcome: training.Outcome, floor: float
) -> dict[str, Any]:
    """Return the final model's mean KL (nats) on whole clouds, with the floor and without, and the counts."""
    divergences: dict[str, dict[str, float]] = {"kl": {}, "kl_floor0": {}}
    for name, samples in zip(("training", "validation"), sets, strict=True):
        q = training.predict(model, samples)
        for key, added in (("kl", floor), ("kl_floor0", 0.0)):
            pair = gaussian.with_floor(samples.label, added), gaussian.with_floor(q, added)
            divergences[key][name] = float(f"{np.mean(gaussian.kl_divergence(*pair)):.4g}")
        print(f"{name}: {len(samples)} submaps, mean KL {divergences['kl'][name]} nats at floor {floor:g} m^2")
    submaps = {name: len(samples) for name, samples in zip(("training", "validation"), sets, strict=True)}
    return {**divergences, "submaps": submaps, "best_step": outcome.best_step, "steps": outcome.steps}


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("--training", type=Path, required=True, help="a folder for each training survey")
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--onnx", type=Path, required=True)
    parser.add_argument("--loss", type=Path, required=True)
    parser.add_argument("--summary", type=Path, required=True)
    command.run(main, parser)
