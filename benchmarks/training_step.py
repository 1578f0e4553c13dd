"""Seconds of one training step of PointNetKL on a CPU, against torch's own layers, one after the other.

Every engine takes the same steps on the same clouds, in turns: forward, backward and optimiser, as `training.loop` has
them. `torch_bfloat16` is torch's layers under torch.autocast.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from pointnetkl.models import point_mlp, pointnetkl
from pointnetkl.models.point_mlp import PointMLP, PooledMLP
from pointnetkl.training import device

_NETWORK = pointnetkl.Settings(scale_input=True, hidden_layers=4, hidden_width=1000, dropout=0.4)
ENGINES = ("torch", "torch_bfloat16", "ours", "ours_bfloat16")


def main(arguments: argparse.Namespace) -> None:
    """Time every engine and print the medians."""
    device.prepare(arguments.seed, arguments.threads, torch.device("cpu"))
    rng = np.random.default_rng(arguments.seed)
    points = rng.uniform(-0.6, 0.6, (arguments.batch, arguments.points, 3)).astype(np.float32) * [1, 1, 0.1]
    inputs = torch.tensor(points, dtype=torch.float32), torch.full((arguments.batch,), 150.0)
    steps = {name: step(name, inputs) for name in ENGINES}
    seconds: dict[str, list[float]] = {name: [] for name in ENGINES}
    for repetition in range(arguments.repetitions + 1):
        for name in np.roll(ENGINES, repetition):
            began = time.perf_counter()
            steps[name]()
            if repetition:  # the first compiles and allocates
                seconds[name].append(time.perf_counter() - began)
    medians = {name: statistics.median(times) for name, times in seconds.items()}
    numbers: dict[str, Any] = {f"{name}_s": round(median, 3) for name, median in medians.items()}
    numbers["ratio"] = round(medians["torch"] / medians["ours_bfloat16"], 2)
    numbers["ratio_like_for_like"] = round(medians["torch"] / medians["ours"], 2)
    numbers |= {name: getattr(arguments, name) for name in ("batch", "points", "threads", "repetitions")}
    if arguments.json:
        print(json.dumps(numbers))
    else:
        print("\n".join(f"{name}: {value}" for name, value in numbers.items()))


def step(name: str, inputs: tuple[Tensor, Tensor]) -> Callable[[], None]:
    """Return a function that takes one training step by an engine."""
    torch.manual_seed(0)
    model = pointnetkl.PointNetKL(_NETWORK).train()
    optimiser = torch.optim.Adam(model.parameters(), 1e-4, weight_decay=1e-4, amsgrad=True, fused=True)
    precision = "bfloat16" if name == "ours_bfloat16" else "float32"
    point_mlp.search_in(model, precision)
    low = torch.autocast("cpu", torch.bfloat16) if name == "torch_bfloat16" else nullcontext()
    layers = nullcontext if name.startswith("ours") else torch_layers

    def take() -> None:
        with layers(), low:
            loss = model(*inputs).square().mean()
        optimiser.zero_grad()
        with layers(), point_mlp.matrix_products(precision):
            loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), 10.0)
        optimiser.step()

    return take


@contextmanager
def torch_layers() -> Iterator[None]:
    """Run MLPs as torch does: a layer after the other, every output kept, and then the largest."""
    ours = PointMLP.forward, PooledMLP.forward

    def pooled(layers: PooledMLP, features: Tensor) -> Tensor:
        return point_mlp.to_rows(lambda rows: nn.Sequential.forward(layers, rows), features).amax(dim=1)

    PointMLP.forward, PooledMLP.forward = nn.Sequential.forward, pooled  # type: ignore[method-assign]
    try:
        yield
    finally:
        PointMLP.forward, PooledMLP.forward = ours  # type: ignore[method-assign]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=500, help="submaps a step")
    parser.add_argument("--points", type=int, default=256, help="points of each")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="end in one line of JSON")
    main(parser.parse_args())
