"""How models and fits learned the labels, as stages train and fit wrote it."""

from pathlib import Path

import pandas as pd

from pointnetkl.reporting.results import Folders, ResultsError
from pointnetkl.workflow import artifacts


def read_divergences(folders: Folders, floor_m2: float) -> dict[str, dict[str, float]]:
    """Read the mean KL divergence (nats) of models and fits in training and validation, by method, at this floor.

    A divergence at another floor cannot be compared, and is left out.

    Raises:
        ResultsError: a model's summary lacks its divergences or their floor.
    """
    divergences, floors = {}, {}
    for name in folders.study.models:
        path = folders.reports / f"train/{name}.json"
        content = artifacts.read_json(path)
        kl, floors[name] = content.get("kl"), content.get("floor_m2")
        if not isinstance(kl, dict) or not {"training", "validation"} <= set(kl) or floors[name] is None:
            raise ResultsError(f"{path}: must have kl.training, kl.validation and floor_m2; run dvc repro train@{name}")
        divergences[name] = {part: float(kl[part]) for part in ("training", "validation")}
    fits = artifacts.read_json(folders.models / "fits.json")
    for name, fit in fits.items():
        if isinstance(fit, dict) and "mean_kl" in fit:
            divergences[name], floors[name] = {"training": float(fit["mean_kl"])}, fits["params"]["fit"]["floor_m2"]
    return {name: kl for name, kl in divergences.items() if floors[name] == floor_m2}


def read_losses(folders: Folders) -> dict[str, pd.DataFrame]:
    """Read each model's KL divergence by training step.

    Raises:
        ResultsError: a column is missing.
    """
    return {name: _loss(folders.reports / f"train/{name}.csv") for name in folders.study.models}


def _loss(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)[["step", "training", "validation"]]
    except (KeyError, ValueError) as error:
        raise ResultsError(f"{path}: must have the columns step, training, validation; run dvc repro train") from error
