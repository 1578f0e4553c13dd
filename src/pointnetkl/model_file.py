"""A trained PointNetKL as a file: for this package (.pt), and for any program that runs ONNX."""

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from pointnetkl import network, settings
from pointnetkl.errors import PointNetKLError


class ModelFileError(PointNetKLError):
    """A model's file is missing, damaged or not one."""


@dataclass(frozen=True)
class Stored:
    """What a model's file holds."""

    model: network.PointNetKL  # in evaluation mode, on the CPU
    voxel: float  # edge of the voxels of the clouds it knows, as a share of the unit sphere's radius
    metadata: dict[str, Any]  # the parameters that made it


def to_bytes(model: network.PointNetKL, voxel: float, metadata: Mapping[str, Any]) -> bytes:
    """Return a file's content: weights, settings and the parameters that made them; plain values and tensors."""
    content = {
        "network": settings.as_metadata(model.settings),
        "voxel": voxel,
        "metadata": dict(metadata),
        "weights": {name: tensor.cpu() for name, tensor in model.state_dict().items()},
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
        content = torch.load(io.BytesIO(path.read_bytes()), map_location="cpu", weights_only=True)
        model = network.PointNetKL(network.Settings(**content["network"]))
        model.load_state_dict(content["weights"])
        return Stored(model.eval(), float(content["voxel"]), dict(content["metadata"]))
    except FileNotFoundError as error:
        raise ModelFileError(f"{path}: is missing; run dvc repro train") from error
    except Exception as error:  # zip, pickle and torch each fail in their own ways on damaged bytes
        reason = " ".join(str(error).split())[:120]
        raise ModelFileError(f"{path}: is damaged or no model of ours ({reason}); run dvc repro train") from error


def to_onnx(model: network.PointNetKL) -> bytes:
    """Return the model as ONNX: points (clouds, points, 3) and radius (clouds,) in, covariance (clouds, M, M) out."""
    wrapped = network.Covariance(model).eval()
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # the newer exporter needs another package, and for this network gives nothing more
        warnings.simplefilter("ignore")
        torch.onnx.export(
            wrapped,
            (torch.zeros(2, 8, 3), torch.ones(2)),
            buffer,  # type: ignore[arg-type]  # a buffer is taken where dynamo is false
            dynamo=False,
            input_names=["points", "radius"],
            output_names=["covariance"],
            dynamic_axes={
                "points": {0: "clouds", 1: "points"},
                "radius": {0: "clouds"},
                "covariance": {0: "clouds"},
            },
        )
    return buffer.getvalue()
