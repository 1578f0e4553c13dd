"""A trained model predicts the Q that it learned, and no other under its name."""

import dataclasses
from pathlib import Path

import pytest

from pointnetkl.models import model_file, trained
from pointnetkl.models import pointnetkl as network
from pointnetkl.models.trained import TrainedError
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.workflow import parameters

LABEL = monte_carlo.Settings(seed=2, copy="same", prior_variance_m2=9.0, noise_sigma_m=0.2, held_out_runs=0)
REGISTRATION = gicp.Settings(
    neighbours=20, plane_epsilon=1e-3, max_distance_m=20.0, tolerance_m=1e-3, max_iterations=50
)
METADATA = {"label": parameters.as_metadata(LABEL), "registration": parameters.as_metadata(REGISTRATION)}


def write(folder: Path, metadata: dict[str, object]) -> Path:
    """Write an untrained model of x and y."""
    settings = network.Settings(scale_input=True, hidden_layers=1, hidden_width=8, dropout=0.0)
    model = network.PointNetKL(settings)
    (folder / "mine.pt").write_bytes(model_file.to_bytes("pointnetkl", model, 0.01, metadata))
    return folder / "mine.pt"


@pytest.mark.parametrize("metadata", [METADATA, {}])
def test_a_model_of_the_same_settings_is_read(tmp_path: Path, metadata: dict[str, object]):
    later = dataclasses.replace(LABEL, seed=3, held_out_runs=9)  # which change no Q
    loaded = trained.load_all([write(tmp_path, metadata)], later, REGISTRATION)
    assert [each.name for each in loaded] == ["mine"]


def test_a_missing_model_says_what_to_run(tmp_path: Path):
    with pytest.raises(
        model_file.ModelFileError,
        match=r"nope\.pt: is missing, .* which has network, pointnetkl; .* dvc repro",
    ):
        trained.load_all([tmp_path / "nope.pt"], LABEL, REGISTRATION)


@pytest.mark.parametrize(
    ("label", "registration", "said"),
    [
        ({}, {"dof": "xyyaw"}, "with registration.dof xy, and xyyaw is asked for"),
        ({"copy": "split"}, {}, "with label.copy same, and split is asked for"),
        ({"noise_sigma_m": 0.1}, {}, "with label.noise_sigma_m 0.2, and 0.1 is asked for"),
        ({"prior_variance_m2": 4.0}, {}, "with label.prior_variance_m2 9.0, and 4.0 is asked for"),
        ({}, {"max_distance_m": 10.0}, "with registration.max_distance_m 20.0, and 10.0 is asked for"),
    ],
)
def test_a_model_that_learned_another_q_is_refused(
    tmp_path: Path, label: dict[str, object], registration: dict[str, object], said: str
):
    path = write(tmp_path, METADATA)
    with pytest.raises(TrainedError) as error:
        trained.load_all([path], dataclasses.replace(LABEL, **label), dataclasses.replace(REGISTRATION, **registration))
    assert str(error.value).startswith(f"{path}: was trained ")
    assert str(error.value).endswith(f"{said}; run dvc repro train@mine")
