"""Files of a trained model: one for this package (.pt), one for any program that runs ONNX."""

import io
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pointnetkl.models import mean_field_network
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.model import Covariance, Model
from pointnetkl.models.novelty import TraitDistribution
from pointnetkl.workflow import parameters
from pointnetkl.workflow.errors import PointNetKLError

# The settings and the class of each kind of model, by the name that stands in section `models` of the parameters.
KINDS: dict[str, tuple[type[Any], Callable[[Any], Model]]] = {
    "pointnetkl": (network.Settings, network.PointNetKL),
    "mean_field": (mean_field_network.Settings, mean_field_network.MeanFieldNetwork),
}


class ModelFileError(PointNetKLError):
    """A model's file is missing, damaged or not one."""


@dataclass(frozen=True)
class Stored:
    """What a model's file holds."""

    kind: str  # of KINDS
    model: Model  # in evaluation mode, on the CPU
    voxel: float  # edge of the voxels of the clouds it knows, as a share of the unit sphere's radius
    metadata: dict[str, Any]  # the parameters that made it
    traits: TraitDistribution | None = None  # of the training submaps, where the file has them


def kind(name: str) -> tuple[type[Any], Callable[[Any], Model]]:
    """Return the settings and the class of a kind of model.

    Raises:
        ModelFileError: there is no such kind.
    """
    if name not in KINDS:
        raise ModelFileError(f"{name}: is no kind of model; the kinds are {', '.join(KINDS)}")
    return KINDS[name]


def shipped() -> dict[str, Path]:
    """Return the files of the models that come with this package, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parents[1] / "weights").glob("*.pt"))}


def halved(stored: Stored) -> bytes:
    """Return a file's content with the matrices in half precision, for a model that comes with this package.

    Raises:
        ModelFileError: a weight is too large for half precision.
    """
    weights = {key: tensor.half() if tensor.ndim > 1 else tensor for key, tensor in stored.model.state_dict().items()}
    if beyond := [key for key, tensor in weights.items() if not torch.isfinite(tensor).all()]:
        raise ModelFileError(f"{beyond[0]}: has a weight beyond 65504, the largest in half precision")
    return _to_bytes(stored.kind, stored.model, weights, stored.voxel, stored.metadata, stored.traits)


def to_bytes(
    name: str, model: Model, voxel: float, metadata: Mapping[str, Any], traits: TraitDistribution | None = None
) -> bytes:
    """Return a file's content, of a model of the kind `name`: weights, settings, the parameters that made them.

    They are plain values and tensors: reading them executes nothing.
    """
    weights = {key: tensor.cpu() for key, tensor in model.state_dict().items()}
    return _to_bytes(name, model, weights, voxel, metadata, traits)


def _to_bytes(
    name: str,
    model: Model,
    weights: Mapping[str, torch.Tensor],
    voxel: float,
    metadata: Mapping[str, Any],
    traits: TraitDistribution | None,
) -> bytes:
    content = {
        "kind": name,
        "network": parameters.as_metadata(model.settings),
        "voxel": voxel,
        "metadata": dict(metadata),
        "weights": dict(weights),
        "known": None if traits is None else _plain(traits),
    }
    buffer = io.BytesIO()  # a file's name would get into its bytes
    torch.save(content, buffer)
    return buffer.getvalue()


def read(path: Path) -> Stored:
    """Read a model; nothing in the file is executed.

    Raises:
        ModelFileError: the file is missing, damaged or holds something else.
    """
    try:
        stored = path.read_bytes()
        if bad := zipfile.ZipFile(io.BytesIO(stored)).testzip():  # torch does not ask for the checksums it wrote
            raise ValueError(f"{bad} has a wrong checksum")
        content = torch.load(io.BytesIO(stored), map_location="cpu", weights_only=True)
        settings_class, make = kind(content["kind"])
        model = make(settings_class(**content["network"]))
        model.load_state_dict(content["weights"])
        traits = _traits(content.get("known"))
        return Stored(content["kind"], model.eval(), float(content["voxel"]), dict(content["metadata"]), traits)
    except FileNotFoundError as error:
        raise ModelFileError(
            f"{path}: is missing, and no model of that name comes with the package, which has {', '.join(shipped())};"
            " those of your own study are made by dvc repro"
        ) from error
    except Exception as error:  # zip, pickle and torch each fail in their own ways on damaged bytes
        reason = " ".join(str(error).split())[:120]
        raise ModelFileError(
            f"{path}: is damaged or no model of ours ({reason}); run dvc repro train@{path.stem}"
        ) from error


def to_onnx(model: Model) -> bytes:
    """Return the model as ONNX: its inputs, by their names, to covariance (clouds, M, M).

    For a PointNetKL those are points (clouds, points, 3) and radius (clouds,).
    """
    wrapped = Covariance(model.cpu()).eval()
    example = model.example()
    buffer = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # the newer exporter needs another package, and for these networks gives nothing more
        warnings.simplefilter("ignore")
        torch.onnx.export(
            wrapped,
            tuple(part.value for part in example.values()),
            buffer,  # type: ignore[arg-type]  # a buffer is taken where dynamo is false
            dynamo=False,
            input_names=list(example),
            output_names=["covariance"],
            dynamic_axes={name: part.free for name, part in example.items()} | {"covariance": {0: "clouds"}},
        )
    return buffer.getvalue()


def _plain(traits: TraitDistribution) -> dict[str, Any]:
    arrays = {name: torch.from_numpy(getattr(traits, name)) for name in ("centre", "whitening")}
    return {**arrays, "limit": traits.limit}


def _traits(stored: dict[str, Any] | None) -> TraitDistribution | None:
    if stored is None:
        return None
    return TraitDistribution(np.asarray(stored["centre"]), np.asarray(stored["whitening"]), float(stored["limit"]))
