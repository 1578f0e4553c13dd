"""Training: it learns, it repeats to the bit, and its files survive a journey."""

import dataclasses
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
import yaml

from pointnetkl import dataset, model_file, network, training, voxel
from pointnetkl.covariance import gaussian, pointnetkl
from pointnetkl.submap import Submap
from test_dataset import write

ROOT = Path(__file__).parents[1]
SMALL = network.Settings(scale_input=True, hidden_layers=2, hidden_width=64, dropout=0.1)
QUICK = training.Settings(
    seed=3,
    threads=1,
    steps=6,
    batch=4,
    points=16,
    learning_rate=1e-3,
    weight_decay=1e-4,
    label_floor_m2=0.01,
    validation_share=0.2,
    validation_blocks=2,
    validate_every=2,
    patience=20,
    early_stopping="whole",
    statistics_batches=2,
    statistics_batch=8,
)


def samples(count: int, seed: int = 0) -> dataset.Samples:
    """Return clouds whose roughness decides their label: flat ones slide, rough ones do not."""
    rng = np.random.default_rng(seed)
    rough = np.linspace(0, 1, count)
    flat = rng.uniform(-0.6, 0.6, (count, 64, 3)).astype(np.float32)
    clouds = [c * [1, 1, r] for c, r in zip(flat, rough, strict=True)]
    label = np.exp(1.5 - 4 * rough)[:, None, None] * np.eye(2)
    return dataset.Samples(
        np.full(count, "made"), np.arange(count, dtype=np.int32), [c.astype(np.float32) for c in clouds],
        np.full(count, 100.0), label,
    )  # fmt: skip


def trained(chosen: training.Settings, kind: network.Settings = SMALL) -> tuple[network.PointNetKL, training.Outcome]:
    training.prepare(chosen.seed, chosen.threads)
    model = network.PointNetKL(kind)
    training.start_at_mean(model, samples(8), chosen.label_floor_m2)
    outcome = training.train(model, samples(8), samples(5, seed=1), chosen)
    training.finish(model, samples(8), chosen)
    return model, outcome


@pytest.fixture(scope="module")
def model() -> network.PointNetKL:
    return trained(QUICK)[0]


def test_a_few_submaps_are_learned_by_heart():
    chosen = dataclasses.replace(QUICK, steps=40, batch=8, points=48, validate_every=10)
    learned = samples(8)
    training.prepare(1, 1)
    model = network.PointNetKL(SMALL)
    training.start_at_mean(model, learned, chosen.label_floor_m2)
    outcome = training.train(model, learned, learned, chosen)
    training.finish(model, learned, chosen)
    constant = np.broadcast_to(learned.label.mean(axis=0), learned.label.shape)
    best_constant = gaussian.kl_divergence(learned.label, constant).mean()
    assert gaussian.kl_divergence(learned.label, training.predict(model, learned)).mean() < best_constant / 3
    assert outcome.history["training"].iloc[-1] < outcome.history["training"].iloc[0] / 2


def test_a_model_starts_as_the_best_constant_which_is_the_mean_label():
    model = network.PointNetKL(SMALL).eval()
    training.start_at_mean(model, samples(8), 0.01)
    expected = gaussian.with_floor(samples(8).label, 0.01).mean(axis=0)
    for q in training.predict(model, samples(3)):
        np.testing.assert_allclose(q, expected, atol=1e-6)


def test_two_trainings_give_the_same_bytes():
    first, second = (model_file.to_bytes(trained(QUICK)[0], 0.01, {"train": {}}) for _ in range(2))
    assert first == second


def test_another_seed_gives_another_model(model: network.PointNetKL):
    other = trained(dataclasses.replace(QUICK, seed=4))[0]
    assert model_file.to_bytes(other, 0.01, {}) != model_file.to_bytes(model, 0.01, {})


def test_the_best_weights_are_kept_and_not_the_last():
    chosen = dataclasses.replace(QUICK, steps=12, learning_rate=0.01, validate_every=1)
    training.prepare(chosen.seed, 1)
    model = network.PointNetKL(SMALL)
    outcome = training.train(model, samples(8), samples(5, seed=1), chosen)
    scores = outcome.history["validation"].to_numpy()
    assert outcome.best_step == outcome.history["step"][scores.argmin()]
    assert scores[-1] > scores.min()
    again = training._validate(model, samples(8), samples(5, seed=1), chosen, 0)
    assert again == pytest.approx(scores.min(), rel=1e-5)


def test_training_stops_when_validation_no_longer_improves():
    chosen = dataclasses.replace(QUICK, steps=60, learning_rate=0.05, validate_every=2, patience=3)
    outcome = trained(chosen)[1]
    assert outcome.steps == outcome.best_step + 6 < 60
    assert outcome.history["step"].tolist() == list(range(2, outcome.steps + 1, 2))


def test_the_paper_s_stopping_looks_at_another_batch_after_every_step():
    outcome = trained(dataclasses.replace(QUICK, early_stopping="paper", steps=5))[1]
    assert outcome.history["step"].tolist() == [1, 2, 3, 4, 5]


def test_validating_more_often_does_not_change_what_is_trained_on():
    kind = dataclasses.replace(SMALL, dropout=0.0)
    often, seldom = (trained(dataclasses.replace(QUICK, validate_every=n), kind)[1] for n in (1, 6))
    assert often.history["training"].mean() == pytest.approx(seldom.history["training"].iloc[0], rel=1e-6)


def test_batch_norm_statistics_make_evaluation_agree_with_training():
    every, kind = samples(8), dataclasses.replace(SMALL, dropout=0.0)
    model, _ = trained(dataclasses.replace(QUICK, steps=20), kind)
    model.train()
    with torch.no_grad():
        points, radius = (torch.from_numpy(a) for a in dataset.draw(every, np.arange(8), 64, np.random.default_rng(0)))
        in_training = network.covariance(model(points, radius).double()).numpy()
    training.finish(model, every, QUICK)
    # not exactly: of eight submaps, a variance with n and with n - 1 differ by a seventh
    assert gaussian.kl_divergence(in_training, training.predict(model, every)).max() < 0.1


def test_a_loss_that_is_no_number_ends_in_a_sentence():
    broken = samples(8)
    broken.clouds[0][:] = np.nan
    with pytest.raises(training.TrainingError, match=r"step \d+: the loss is nan; lower train\.learning_rate"):
        training.train(network.PointNetKL(SMALL), broken, samples(5), dataclasses.replace(QUICK, batch=32))


def test_settings_that_cannot_train_are_refused():
    for field, value in (("batch", 1), ("validation_share", 1.0), ("early_stopping", "never"), ("points", 0)):
        with pytest.raises(ValueError, match=f"^{field} is "):
            dataclasses.replace(QUICK, **{field: value})


def test_a_model_s_file_gives_back_the_same_predictions(model: network.PointNetKL, tmp_path: Path):
    (tmp_path / "model.pt").write_bytes(model_file.to_bytes(model, 0.02, {"surveys": ["baltic"]}))
    stored = model_file.read(tmp_path / "model.pt")
    assert (stored.voxel, stored.metadata) == (0.02, {"surveys": ["baltic"]})
    np.testing.assert_array_equal(training.predict(stored.model, samples(5)), training.predict(model, samples(5)))


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "flipped", "other"])
def test_a_damaged_model_s_file_is_refused_in_a_sentence(model: network.PointNetKL, tmp_path: Path, damage: str):
    path = tmp_path / "model.pt"
    content = bytearray(model_file.to_bytes(model, 0.01, {}))
    content[200] ^= 255
    other = io.BytesIO()
    torch.save({"weights": {}}, other)
    written = {"empty": b"", "cut": bytes(content[:5000]), "flipped": bytes(content), "other": other.getvalue()}
    if damage != "missing":
        path.write_bytes(written[damage])
    sentence = r"model\.pt: is (missing|damaged).*run dvc repro train"
    with pytest.raises(model_file.ModelFileError, match=sentence) as found:
        model_file.read(path)
    assert "\n" not in str(found.value)


def test_onnx_gives_the_same_covariances_for_any_number_of_points(model: network.PointNetKL):
    content = model_file.to_onnx(model)
    assert content == model_file.to_onnx(model)
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    for count in (10, 64):
        for cloud in samples(4).clouds:
            inputs = {"points": cloud[None, :count], "radius": np.array([100.0], np.float32)}
            (q,) = session.run(["covariance"], inputs)
            np.testing.assert_allclose(q[0], network.predict(model, cloud[:count], 100.0), rtol=1e-3, atol=1e-6)


def test_the_method_predicts_the_same_from_a_submap_and_from_its_cloud(model: network.PointNetKL, tmp_path: Path):
    (tmp_path / "model.pt").write_bytes(model_file.to_bytes(model, 0.05, {}))
    method = pointnetkl.load(tmp_path / "model.pt")
    rng = np.random.default_rng(0)
    submaps = [Submap("made", i, rng.uniform(-60, 60, (300, 3)), np.empty((0, 3)), np.empty((0, 3))) for i in range(3)]
    clouds = voxel.Clouds.of([0, 1, 2], [voxel.canonical(s.points, 0.05) for s in submaps])
    predicted = method.predict(clouds)
    for submap, q in zip(submaps, predicted, strict=True):
        np.testing.assert_array_equal(method.covariance(submap), gaussian.check(q, "test"))
    assert method.name == "pointnetkl"


def test_the_stage_writes_a_model_its_losses_and_its_scores(tmp_path: Path):
    for name in ("baltic", "shetland"):
        write(tmp_path / "training", name, 12)
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["study"]["train"] = {n: params["study"]["train"][n] for n in ("baltic", "shetland")}
    params["train"] |= {"steps": 2, "batch": 4, "points": 16, "validate_every": 1, "threads": 1}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    made = {"model": "m.pt", "onnx": "m.onnx", "loss": "loss.csv", "summary": "summary.json"}
    command = [sys.executable, ROOT / "pipeline/train.py", "--params", "params.yaml", "--training", "training"]
    command += [word for option, file in made.items() for word in (f"--{option}", file)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["submaps"] == {"training": 20, "validation": 4}
    assert set(summary["kl"]) == set(summary["kl_floor0"]) == {"training", "validation"}
    assert (tmp_path / "loss.csv").read_text().splitlines()[0] == "step,training,validation"
    stored = model_file.read(tmp_path / "m.pt")
    assert stored.metadata["surveys"] == ["baltic", "shetland"]
    (tmp_path / "training/shetland/clouds.npz").unlink()
    failed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert failed.returncode == 1
    assert failed.stderr.startswith("error: training/shetland/clouds.npz: is missing")
