"""Train one model on the training surveys' labels; write it, its card, its losses as it goes, and how good it is."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl import training
from pointnetkl.models import mean_field, mean_field_network, model_file, novelty
from pointnetkl.models.model import Model
from pointnetkl.models.samples import Samples
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting import model_card
from pointnetkl.training import checkpoint, dataset, device
from pointnetkl.workflow import artifacts, command, parameters, study

# Where KL is judged, as report.kl_floor_m2 has it: to read that here would train again whenever a report changes.
JUDGED_AT_M2 = 0.01


def main(arguments: argparse.Namespace) -> None:
    """Train, and write everything."""
    kind = parameters.read(arguments.params, f"models.{arguments.model}.kind", str)
    if kind not in model_file.KINDS:
        known = " or ".join(model_file.KINDS)
        place = f"{arguments.params}: models.{arguments.model}.kind"
        raise parameters.SettingsError(f"{place} is {kind!r}, must be {known}")
    chosen = parameters.read(arguments.params, f"models.{arguments.model}.train", training.Settings)
    form, make = model_file.kind(kind)
    network = parameters.read(arguments.params, f"models.{arguments.model}.network", form)
    studied = study.read(arguments.params)
    surveys = list(studied.train)
    samples, voxel = dataset.read(arguments.training, surveys)
    seen = dataset.described(arguments.training, samples, novelty.traits)
    network = dataclasses.replace(network, **found(arguments.params, form, samples))

    where = device.choose(chosen.device)
    device.prepare(chosen.seed, chosen.threads, where)
    model = make(network).to(where)
    if model.describe:
        samples = dataset.described(arguments.training, samples, model.describe)
    sets = dataset.split(samples, chosen.validation_share, chosen.validation_blocks, chosen.seed)
    model.start(sets[0])
    label = parameters.read(arguments.params, "label", monte_carlo.Settings)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    sections = {"train": chosen, "label": label, "registration": registration}
    metadata = {"surveys": surveys, **{name: parameters.as_metadata(each) for name, each in sections.items()}}
    decides = {**metadata, "kind": kind, "network": parameters.as_metadata(network), "device": where.type}
    kept = checkpoint.Checkpoint(arguments.checkpoints, checkpoint.name(decides, sets), arguments.every_s)
    outcome = training.train(model, *sets, chosen, kept, lambda history: write_losses(arguments.loss, history))
    training.finish(model, sets[0], chosen)

    parts = dataset.split(seen, chosen.validation_share, chosen.validation_blocks, chosen.seed)
    known = novelty.learn(parts[0].described, parts[0].survey)
    artifacts.write_bytes(arguments.weights, model_file.to_bytes(kind, model, voxel, metadata, known))
    score = {**summary(model, sets, outcome, JUDGED_AT_M2), "flagged": flagged(known, parts)}
    artifacts.write_json(arguments.summary, score)
    artifacts.write_bytes(arguments.onnx, model_file.to_onnx(model))
    counts = {name: int((samples.survey == name).sum()) for name in surveys}
    made_from = model_card.Origin(studied.train, counts, label, registration)
    card = model_card.text(arguments.model, kind, model, voxel, made_from, score)
    artifacts.write_bytes(arguments.card, card.encode())
    kept.discard()


def found(params: Path, form: type[Any], samples: Samples) -> dict[str, Any]:
    """Return the settings of a network that its labels decide: how many dimensions, and how they were made."""
    if form is not mean_field_network.Settings:
        return {"dimensions": samples.label.shape[-1]}
    label = parameters.read(params, "label", monte_carlo.Settings)
    registration = parameters.read(params, "registration", gicp.Settings)
    return {"dimensions": samples.label.shape[-1], "conditions": mean_field.conditions(label, registration)}


def write_losses(path: Path, history: pd.DataFrame) -> None:
    """Write the losses so far, whole or not at all: they may be looked at while training runs."""
    artifacts.write_bytes(path, history.to_csv(index=False, float_format="%.6g").encode())


def summary(model: Model, sets: tuple[Samples, Samples], outcome: training.Outcome, floor: float) -> dict[str, Any]:
    """Return the final model's mean KL (nats) on whole clouds, with the floor and without, and the counts."""
    divergences: dict[str, dict[str, float]] = {"kl": {}, "kl_floor0": {}}
    for name, samples in zip(("training", "validation"), sets, strict=True):
        q = training.predict(model, samples)
        for key, added in (("kl", floor), ("kl_floor0", 0.0)):
            pair = gaussian.with_floor(samples.label, added), gaussian.with_floor(q, added)
            divergences[key][name] = float(f"{np.mean(gaussian.kl_divergence(*pair)):.4g}")
        print(f"{name}: {len(samples)} submaps, mean KL {divergences['kl'][name]} nats at floor {floor:g} m^2")
    submaps = {name: len(samples) for name, samples in zip(("training", "validation"), sets, strict=True)}
    counts = {"submaps": submaps, "best_step": outcome.best_step, "steps": outcome.steps}
    return {**divergences, **counts, "floor_m2": floor}


def flagged(known: novelty.Known, parts: tuple[Samples, Samples]) -> dict[str, float]:
    """Return the share of submaps that the model's file says are unlike the training ones."""
    shares = [float(np.mean(known.distance(part.described) > known.limit)) for part in parts]
    return {name: float(f"{share:.4g}") for name, share in zip(("training", "validation"), shares, strict=True)}


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("model", help="its name in section models of the parameters")
    parser.add_argument("--training", type=Path, required=True, help="a folder for each training survey")
    parser.add_argument("--checkpoints", type=Path, required=True, help="folder from which a killed training goes on")
    parser.add_argument("--every-s", type=float, default=60.0, help="seconds between two checkpoints")
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--onnx", type=Path, required=True)
    parser.add_argument("--card", type=Path, required=True, help="a page about the model, Markdown")
    parser.add_argument("--loss", type=Path, required=True)
    parser.add_argument("--summary", type=Path, required=True)
    command.run(main, parser)
