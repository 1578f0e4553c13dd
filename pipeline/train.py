"""Train one model on the training surveys' labels; write it, its losses as it goes, and how good it is."""

import os

os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")  # torch reads it once: large pages, a sixth less time a step

import pointnetkl.workflow.blas  # noqa: F401 - before NumPy is loaded

# isort: split
import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl.models import mean_field, model_file, novelty
from pointnetkl.models.mean_field_network import MeanFieldNetwork
from pointnetkl.models.model import Model
from pointnetkl.models.samples import Samples
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian
from pointnetkl.training import checkpoint, dataset, device, loop
from pointnetkl.workflow import artifacts, command, parameters, study

SETS = ("training", "validation")


def main(arguments: argparse.Namespace) -> None:
    """Train, and write everything."""
    kind, settings = read_kind(arguments.params, arguments.model)
    surveys = study.training_surveys(arguments.params)
    samples, voxel = dataset.read(arguments.training, surveys)
    label, registration = dataset.made_with(arguments.training, surveys)
    with_traits = dataset.with_descriptions(arguments.training, samples, novelty.traits)

    processor = device.choose(settings.device)
    device.prepare(settings.seed, settings.threads, processor)
    model = make(arguments.params, arguments.model, kind, label, registration).to(processor)
    if model.describe:
        samples = dataset.with_descriptions(arguments.training, samples, model.describe)
    sets = dataset.split(samples, settings.validation_share, settings.validation_blocks, settings.seed)
    model.start(sets[0])
    sections = {"train": settings, "label": label, "registration": registration}
    metadata = {"surveys": surveys, **{name: parameters.as_metadata(each) for name, each in sections.items()}}
    network = parameters.as_metadata(model.settings)
    decides = {**metadata, "kind": kind, "network": network, "device": processor.type}
    decides["train"] = {name: value for name, value in metadata["train"].items() if name != "steps"}  # may be raised
    kept = checkpoint.Checkpoint(arguments.checkpoints, checkpoint.name(decides, sets), arguments.every_s)
    outcome = loop.train(model, *sets, settings, kept, lambda history: write_losses(arguments.loss, history))
    loop.finish(model, sets[0], settings)

    trait_sets = dataset.split(with_traits, settings.validation_share, settings.validation_blocks, settings.seed)
    traits = novelty.learn(trait_sets[0].described, trait_sets[0].survey)
    artifacts.write_bytes(arguments.weights, model_file.to_bytes(kind, model, voxel, metadata, traits))
    summary = {
        **measure(model, sets, gaussian.KL_FLOOR_M2),
        **{"best_step": outcome.best_step, "steps": outcome.steps, "flagged": flagged(traits, trait_sets)},
        "model": describe(kind, model, voxel),
        "labels": {name: metadata[name] for name in ("label", "registration")} | {"submaps": count(samples)},
    }
    artifacts.write_json(arguments.summary, summary)
    artifacts.write_bytes(arguments.onnx, model_file.to_onnx(model))
    kept.discard_others()


def read_kind(params: Path, name: str) -> tuple[str, loop.Settings]:
    """Return the kind of the model of that name, and how it is trained.

    Raises:
        SettingsError: there is no such kind, or a setting is wrong.
    """
    kind = parameters.read(params, f"models.{name}.kind", str)
    if kind not in model_file.KINDS:
        kinds = " or ".join(model_file.KINDS)
        raise parameters.SettingsError(f"{params}: models.{name}.kind is {kind!r}, must be {kinds}")
    return kind, parameters.read(params, f"models.{name}.train", loop.KINDS[kind])


def make(params: Path, name: str, kind: str, label: monte_carlo.Settings, registration: gicp.Settings) -> Model:
    """Return the untrained model of that name, for labels that were made with these settings."""
    form, new = model_file.kind(kind)
    decided: dict[str, Any] = {"dimensions": registration.dimensions}
    if new is MeanFieldNetwork:
        decided["conditions"] = mean_field.conditions(label, registration)
    return new(dataclasses.replace(parameters.read(params, f"models.{name}.network", form), **decided))


def write_losses(path: Path, history: pd.DataFrame) -> None:
    """Write the losses so far, whole or not at all: they may be looked at while training runs."""
    artifacts.write_bytes(path, history.to_csv(index=False, float_format="%.6g").encode())


def measure(model: Model, sets: tuple[Samples, Samples], floor_m2: float) -> dict[str, Any]:
    """Return the trained model's mean KL (nats) on whole clouds, with the floor and without, and the counts."""
    divergences: dict[str, dict[str, float]] = {"kl": {}, "kl_floor0": {}}
    for name, samples in zip(SETS, sets, strict=True):
        q = loop.predict(model, samples)
        for key, added in (("kl", floor_m2), ("kl_floor0", 0.0)):
            pair = gaussian.with_floor(samples.label, added), gaussian.with_floor(q, added)
            divergences[key][name] = float(f"{np.mean(gaussian.kl_divergence(*pair)):.4g}")
        print(f"{name}: {len(samples)} submaps, mean KL {divergences['kl'][name]} nats at floor {floor_m2:g} m^2")
    submaps = {name: len(samples) for name, samples in zip(SETS, sets, strict=True)}
    return {**divergences, "submaps": submaps, "floor_m2": floor_m2}


def flagged(traits: novelty.TraitDistribution, sets: tuple[Samples, Samples]) -> dict[str, float]:
    """Return the share of submaps that the model's file says are unlike the training ones."""
    shares = [float(np.mean(traits.distance(samples.described) > traits.limit)) for samples in sets]
    return {name: float(f"{share:.4g}") for name, share in zip(SETS, shares, strict=True)}


def describe(kind: str, model: Model, voxel: float) -> dict[str, Any]:
    """Return what the model's card says of the model itself."""
    weights = sum(parameter.numel() for parameter in model.parameters())
    return {"kind": kind, "weights": weights, "dimensions": model.settings.dimensions, "voxel": voxel}


def count(samples: Samples) -> dict[str, int]:
    """Return how many submaps each survey has, those validated on included."""
    return {name: int((samples.survey == name).sum()) for name in dict.fromkeys(map(str, samples.survey))}


if __name__ == "__main__":
    parser = command.parser(__doc__)
    parser.add_argument("model", help="its name in section models of the parameters")
    parser.add_argument("--training", type=Path, required=True, help="a folder for each training survey")
    parser.add_argument("--checkpoints", type=Path, required=True, help="folder from which a killed training goes on")
    parser.add_argument("--every-s", type=float, default=60.0, help="seconds between two checkpoints")
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--onnx", type=Path, required=True)
    parser.add_argument("--loss", type=Path, required=True)
    parser.add_argument("--summary", type=Path, required=True)
    command.run(main, parser)
