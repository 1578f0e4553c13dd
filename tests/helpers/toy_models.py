"""Model files of every kind, whose models have learned nothing."""

import dataclasses
from pathlib import Path

import numpy as np
import torch

import terrains
from pointnetkl.models import mean_field_network, model_file, novelty
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.mean_field import Conditions
from pointnetkl.models.model import Model

KINDS = ("pointnetkl", "mean_field")
CONDITIONS = Conditions(20, 1e-3, 1e-3, 50, 3.0, 0.1, 0.03)
SETTINGS = {
    "pointnetkl": network.Settings(scale_input=True, hidden_layers=2, hidden_width=32, dropout=0.1),
    "mean_field": mean_field_network.Settings(2, 8, 1.5, 0.3, conditions=CONDITIONS),
}


def model(kind: str, dimensions: int = 2) -> Model:
    """Return a model in evaluation mode, with parameters a little off their initial values."""
    torch.manual_seed(0)
    untrained = model_file.kind(kind)[1](dataclasses.replace(SETTINGS[kind], dimensions=dimensions))
    with torch.no_grad():
        for parameter in untrained.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return untrained.eval()


def training_submaps() -> novelty.TraitDistribution:
    """Return what a model's file keeps of 40 training submaps, of mild terrain with heights scaled by 0.2 to 2."""
    clouds = [terrains.cloud("mild", 900, i) * [1, 1, 0.2 + 1.8 * (i % 20) / 19] for i in range(40)]
    return novelty.learn(np.stack([novelty.traits(points) for points in clouds]), np.repeat(["a", "b"], 20))


def write(folder: Path, kind: str, dimensions: int = 2) -> Path:
    """Write a model's file and return its path."""
    path = folder / f"{kind}.pt"
    path.write_bytes(model_file.to_bytes(kind, model(kind, dimensions), 0.01, {}, training_submaps()))
    return path
