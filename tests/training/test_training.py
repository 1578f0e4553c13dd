"""Training: it learns, it repeats to the bit, and its files survive a journey."""

import dataclasses
import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
import yaml

from pointnetkl.models import cholesky, model_file
from pointnetkl.models import pointnetkl as network
from pointnetkl.models import trained as trained_method
from pointnetkl.models.model import predict
from pointnetkl.models.samples import Samples
from pointnetkl.registration.covariance import gaussian
from pointnetkl.surveys import voxel
from pointnetkl.surveys.submap import Submap
from pointnetkl.training import checkpoint, device, loop
from pointnetkl.workflow import parameters
from toy_labels import until
from training_surveys import write

ROOT = Path(__file__).parents[2]
CPU = torch.device("cpu")
SMALL = network.Settings(scale_input=True, hidden_layers=2, hidden_width=64, dropout=0.1)
QUICK = loop.CloudSettings(
    seed=3,
    device="cpu",
    threads=1,
    steps=6,
    batch=4,
    points=16,
    precision="float32",
    learning_rate=1e-3,
    weight_decay=1e-4,
    gradient_norm=10.0,
    floor_m2=0.01,
    validation_share=0.2,
    validation_blocks=2,
    validate_every=2,
    patience=20,
    early_stopping="whole",
    statistics_batches=2,
    statistics_batch=8,
)


def samples(count: int, seed: int = 0) -> Samples:
    """Return clouds whose roughness decides their label: flat ones slide, rough ones do not."""
    rng = np.random.default_rng(seed)
    rough = np.linspace(0, 1, count)
    flat = rng.uniform(-0.6, 0.6, (count, 64, 3)).astype(np.float32)
    clouds = [c * [1, 1, r] for c, r in zip(flat, rough, strict=True)]
    label = np.exp(1.5 - 4 * rough)[:, None, None] * np.eye(2)
    return Samples(
        np.full(count, "made"), np.arange(count, dtype=np.int32), [c.astype(np.float32) for c in clouds],
        np.full(count, 100.0), label,
    )  # fmt: skip


def trained(
    settings: loop.CloudSettings, kind: network.Settings = SMALL, kept: checkpoint.Checkpoint | None = None
) -> tuple[network.PointNetKL, loop.Outcome]:
    device.prepare(settings.seed, settings.threads, CPU)
    model = network.PointNetKL(kind)
    model.start(samples(8))
    outcome = loop.train(model, samples(8), samples(5, seed=1), settings, kept)
    loop.finish(model, samples(8), settings)
    return model, outcome


@pytest.fixture(scope="module")
def model() -> network.PointNetKL:
    return trained(QUICK)[0]


def test_settings_that_a_kind_of_model_does_not_use_are_refused(tmp_path: Path):
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump({"train": parameters.as_metadata(QUICK)}))
    assert parameters.read(path, "train", loop.KINDS["pointnetkl"]) == QUICK
    with pytest.raises(parameters.SettingsError, match=r"train\.\w+ is unknown"):
        parameters.read(path, "train", loop.KINDS["mean_field"])


def test_training_and_the_report_judge_kl_at_one_floor():
    assert parameters.read(ROOT / "params.yaml", "report.kl_floor_m2", float) == gaussian.KL_FLOOR_M2


def test_every_kind_of_model_has_settings():
    assert loop.KINDS.keys() == model_file.KINDS.keys()


@pytest.mark.slow
def test_a_few_submaps_are_learned_by_heart():
    settings = dataclasses.replace(QUICK, steps=60, batch=8, points=48, validate_every=10)
    learned = samples(8)
    device.prepare(1, 1, CPU)
    model = network.PointNetKL(SMALL)
    model.start(learned)
    outcome = loop.train(model, learned, learned, settings)
    loop.finish(model, learned, settings)
    constant = np.broadcast_to(learned.label.mean(axis=0), learned.label.shape)
    best_constant = gaussian.kl_divergence(learned.label, constant).mean()
    assert gaussian.kl_divergence(learned.label, loop.predict(model, learned)).mean() < best_constant / 3
    assert outcome.history["training"].iloc[-1] < outcome.history["training"].iloc[0] / 2


def test_a_model_starts_as_the_best_constant_which_is_the_mean_label():
    model = network.PointNetKL(SMALL).eval()
    model.start(samples(8))
    expected = samples(8).label.mean(axis=0)
    for q in loop.predict(model, samples(3)):
        np.testing.assert_allclose(q, expected, atol=1e-6)


def test_two_trainings_give_the_same_bytes():
    first, second = (model_file.to_bytes("pointnetkl", trained(QUICK)[0], 0.01, {"train": {}}) for _ in range(2))
    assert first == second


def test_another_seed_gives_another_model(model: network.PointNetKL):
    other = trained(dataclasses.replace(QUICK, seed=4))[0]
    assert model_file.to_bytes("pointnetkl", other, 0.01, {}) != model_file.to_bytes("pointnetkl", model, 0.01, {})


def test_the_best_weights_are_kept_and_not_the_last():
    settings = dataclasses.replace(QUICK, steps=8, learning_rate=0.01, validate_every=1)
    device.prepare(settings.seed, 1, CPU)
    model = network.PointNetKL(SMALL)
    outcome = loop.train(model, samples(8), samples(5, seed=1), settings)
    scores = outcome.history["validation"].to_numpy()
    assert outcome.best_step == outcome.history["step"][scores.argmin()]
    assert scores[-1] > scores.min()
    again = loop._validate(model, samples(8), samples(5, seed=1), settings, 0)
    assert again == pytest.approx(scores.min(), rel=1e-5)


def test_training_stops_when_validation_no_longer_improves():
    settings = dataclasses.replace(QUICK, steps=60, learning_rate=0.05, validate_every=2, patience=3)
    outcome = trained(settings)[1]
    assert outcome.steps == outcome.best_step + 6 < 60
    assert outcome.history["step"].tolist() == list(range(0, outcome.steps + 1, 2))


def test_the_paper_s_stopping_looks_at_another_batch_after_every_step():
    outcome = trained(dataclasses.replace(QUICK, early_stopping="paper", steps=5))[1]
    assert outcome.history["step"].tolist() == [0, 1, 2, 3, 4, 5]


def test_validating_more_often_does_not_change_what_is_trained_on():
    kind = dataclasses.replace(SMALL, dropout=0.0)
    often, seldom = (trained(dataclasses.replace(QUICK, validate_every=n), kind)[1] for n in (1, 6))
    assert often.history["training"][1:].mean() == pytest.approx(seldom.history["training"].iloc[1], rel=1e-6)


def test_batch_norm_statistics_make_evaluation_agree_with_training():
    every, kind = samples(8), dataclasses.replace(SMALL, dropout=0.0)
    model, _ = trained(dataclasses.replace(QUICK, steps=20), kind)
    model.train()
    with torch.no_grad():
        points, radius = (torch.from_numpy(a) for a in every.draw(np.arange(8), 64, np.random.default_rng(0)))
        in_training = cholesky.covariance(model(points, radius).double()).numpy()
    loop.finish(model, every, QUICK)
    # not exactly: of eight submaps, a variance with n and with n - 1 differ by a seventh
    assert gaussian.kl_divergence(in_training, loop.predict(model, every)).max() < 0.1


def test_a_loss_that_is_no_number_ends_in_a_sentence():
    broken = samples(8)
    broken.clouds[0][:] = np.nan
    with pytest.raises(loop.TrainingError, match=r"step \d+: the loss is nan; lower learning_rate"):
        loop.train(network.PointNetKL(SMALL), broken, samples(5), dataclasses.replace(QUICK, batch=32))


def test_settings_that_cannot_train_are_refused():
    for field, value in (
        ("batch", 1),
        ("validation_share", 1.0),
        ("early_stopping", "never"),
        ("device", "tpu"),
        ("points", 0),
    ):
        with pytest.raises(ValueError, match=f"^{field} is "):
            dataclasses.replace(QUICK, **{field: value})


def test_a_model_s_file_gives_back_the_same_predictions(model: network.PointNetKL, tmp_path: Path):
    (tmp_path / "model.pt").write_bytes(model_file.to_bytes("pointnetkl", model, 0.02, {"surveys": ["baltic"]}))
    stored = model_file.read(tmp_path / "model.pt")
    assert (stored.kind, stored.voxel, stored.metadata) == ("pointnetkl", 0.02, {"surveys": ["baltic"]})
    np.testing.assert_array_equal(loop.predict(stored.model, samples(5)), loop.predict(model, samples(5)))


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "flipped", "other"])
def test_a_damaged_model_s_file_is_refused_in_a_sentence(model: network.PointNetKL, tmp_path: Path, damage: str):
    path = tmp_path / "model.pt"
    content = bytearray(model_file.to_bytes("pointnetkl", model, 0.01, {}))
    content[len(content) // 2] ^= 1  # of a weight
    other = io.BytesIO()
    torch.save({"weights": {}}, other)
    written = {"empty": b"", "cut": bytes(content[:5000]), "flipped": bytes(content), "other": other.getvalue()}
    if damage != "missing":
        path.write_bytes(written[damage])
    sentence = r"model\.pt: is (missing.*made by dvc repro$|damaged.*run dvc repro train@model$)"
    with pytest.raises(model_file.ModelFileError, match=sentence) as error:
        model_file.read(path)
    assert "\n" not in str(error.value)


def test_onnx_gives_the_same_covariances_for_any_number_of_points(model: network.PointNetKL):
    content = model_file.to_onnx(model)
    assert content == model_file.to_onnx(model)
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    for count in (10, 64):
        for cloud in samples(4).clouds:
            inputs = {"points": cloud[None, :count], "radius": np.array([100.0], np.float32)}
            (q,) = session.run(["covariance"], inputs)
            np.testing.assert_allclose(
                q[0], predict(model, (cloud[None, :count], inputs["radius"]))[0], rtol=1e-3, atol=1e-6
            )


def test_the_method_answers_as_the_model_does_on_the_voxelised_cloud(model: network.PointNetKL, tmp_path: Path):
    (tmp_path / "pointnetkl.pt").write_bytes(model_file.to_bytes("pointnetkl", model, 0.05, {}))
    method = trained_method.load(tmp_path / "pointnetkl.pt")
    points = np.random.default_rng(0).uniform(-60, 60, (300, 3))
    cloud = voxel.canonical(points, 0.05)
    alone = predict(model, (cloud.points[None], np.array([cloud.radius], np.float32)))[0]
    q = method.covariance(Submap("made", 1, points, np.empty((0, 3)), np.empty((0, 3))))
    np.testing.assert_array_equal(q, gaussian.check(alone, "test"))
    assert method.name == "pointnetkl"


def test_a_training_that_goes_on_from_a_checkpoint_ends_as_one_that_was_never_stopped(tmp_path: Path):
    kind = dataclasses.replace(SMALL, dropout=0.3)  # which draws from torch's generator
    whole, undisturbed = trained(QUICK, kind)

    class Stopped(Exception):
        pass

    class Once(checkpoint.Checkpoint):
        def offer(self, state):
            super().offer(state)
            if state()["values"]["step"] == 5:  # between two validations
                raise Stopped

    with pytest.raises(Stopped):
        trained(QUICK, kind, Once(tmp_path, "a", 0.0))
    model, outcome = trained(QUICK, kind, checkpoint.Checkpoint(tmp_path, "a", 0.0))
    assert model_file.to_bytes("pointnetkl", model, 0.01, {}) == model_file.to_bytes("pointnetkl", whole, 0.01, {})
    assert outcome.history.equals(undisturbed.history)
    checkpoint.Checkpoint(tmp_path, "a", 0.0).discard()
    assert list(tmp_path.iterdir()) == []


def test_a_longer_training_goes_on_from_a_shorter_one_and_ends_as_if_there_had_been_none(tmp_path: Path):
    longer = dataclasses.replace(QUICK, steps=10)
    whole, undisturbed = trained(longer)
    trained(QUICK, kept=checkpoint.Checkpoint(tmp_path, "a", 1e9))
    kept = checkpoint.Checkpoint(tmp_path, "a", 1e9)
    assert kept.load()["values"]["step"] == QUICK.steps
    model, outcome = trained(longer, kept=kept)
    assert model_file.to_bytes("pointnetkl", model, 0.01, {}) == model_file.to_bytes("pointnetkl", whole, 0.01, {})
    assert outcome.history.equals(undisturbed.history)
    shorter = trained(QUICK, kept=kept)[1]  # what is kept is beyond its end
    assert shorter.history.equals(trained(QUICK)[1].history)


def test_states_of_abandoned_trainings_are_deleted_and_the_own_is_not(tmp_path: Path):
    kept = checkpoint.Checkpoint(tmp_path, "a", 0.0)
    for name in ("a", "b"):
        checkpoint.Checkpoint(tmp_path, name, 0.0).keep({"step": 3})
    (tmp_path / ".b.pt.partial").touch()
    kept.discard_others()
    assert [path.name for path in tmp_path.iterdir()] == ["a.pt"]


def test_a_damaged_checkpoint_is_none(tmp_path: Path):
    kept = checkpoint.Checkpoint(tmp_path, "a", 0.0)
    kept.offer(lambda: {"step": 3})
    assert kept.load() == {"step": 3}
    kept.path.write_bytes(kept.path.read_bytes()[:-30])
    assert kept.load() is None


def test_a_checkpoint_s_name_changes_with_settings_and_data_and_not_from_run_to_run():
    def name(steps: int = 6, count: int = 8) -> str:
        return checkpoint.name({"steps": steps}, (samples(count), samples(5, seed=1)))

    moved = samples(8)
    moved.label[3] *= 1.001
    others = [name(steps=7), name(count=9), checkpoint.name({"steps": 6}, (moved, samples(5, seed=1)))]
    assert name() == name()
    assert len({name(), *others}) == 4


def test_a_gpu_is_taken_where_there_is_one_and_demanded_only_in_a_sentence(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device.choose("auto").type == device.choose("cpu").type == "cpu"
    with pytest.raises(device.DeviceError, match="device is cuda, but torch finds no NVIDIA GPU"):
        device.choose("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert device.choose("auto").type == device.choose("cuda").type == "cuda"
    assert device.choose("cpu").type == "cpu"
    for able, expected in ((True, torch.bfloat16), (False, torch.float16)):
        monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda able=able: able)
        assert device.low_precision(torch.device("cuda")) is expected
    assert device.low_precision(CPU) is None


def test_products_that_may_round_train_about_as_well():
    exact, rounded = (trained(dataclasses.replace(QUICK, precision=p))[1].history for p in ("float32", "bfloat16"))
    losses = ["step", "training", "validation"]
    np.testing.assert_allclose(rounded[losses], exact[losses], rtol=0.05)
    assert torch.get_float32_matmul_precision() == "highest"


def test_mixed_precision_trains_about_as_well(monkeypatch: pytest.MonkeyPatch):
    kind = dataclasses.replace(SMALL, dropout=0.0)
    full = trained(QUICK, kind)[1].history
    monkeypatch.setattr(device, "low_precision", lambda where: torch.bfloat16)
    mixed = trained(QUICK, kind)[1].history
    assert not mixed.equals(full)
    losses = ["step", "training", "validation"]
    np.testing.assert_allclose(mixed[losses], full[losses], rtol=0.05)


def test_one_wild_label_does_not_make_the_step_long():
    wild = samples(8)
    wild.label[0] = 1e-9 * np.eye(2)
    settings = dataclasses.replace(QUICK, floor_m2=0.0, steps=2, validate_every=1, gradient_norm=1.0)
    lengths = []
    clip = torch.nn.utils.clip_grad_norm_

    def watched(params, longest):
        params = list(params)
        before = clip(params, longest)
        after = torch.nn.utils.get_total_norm([p.grad for p in params if p.grad is not None])
        lengths.append((float(before), float(after)))
        return before

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop.nn.utils, "clip_grad_norm_", watched)
        loop.train(network.PointNetKL(SMALL), wild, samples(5), settings)
    assert all(before > 1 >= after - 1e-5 for before, after in lengths)


def test_evaluation_does_not_blow_up_on_a_batch_unlike_what_was_trained_on():
    """Batch norms that remember passing batches answered such ones with a validation KL of thousands."""
    model, _ = trained(dataclasses.replace(QUICK, steps=30, learning_rate=0.01))
    steep = samples(8, seed=2)
    wild = Samples(
        steep.survey, steep.submap, [c * np.float32([1, 1, 3]) for c in steep.clouds], 5 * steep.radius, steep.label
    )
    q = loop.predict(model, wild)
    constant = np.broadcast_to(steep.label.mean(axis=0), steep.label.shape)
    worst = gaussian.kl_divergence(*(gaussian.with_floor(each, 0.01) for each in (wild.label, constant))).max()
    kl = gaussian.kl_divergence(*(gaussian.with_floor(each, 0.01) for each in (wild.label, q)))
    assert np.isfinite(q).all()
    assert kl.max() < 30 * worst


def prepare_stage(folder: Path) -> list[str | Path]:
    """Write two training surveys and parameters; return the command of the stage that trains on them."""
    for name in ("baltic", "shetland"):
        write(folder / "training", name, 12)
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["study"]["train"] = {n: params["study"]["train"][n] for n in ("baltic", "shetland")}
    small = {"scale_input": True, "hidden_layers": 1, "hidden_width": 16, "dropout": 0.1}
    settings = {**parameters.as_metadata(QUICK), "steps": 40, "validate_every": 5}
    params["models"] = {"mine": {"kind": "pointnetkl", "network": small, "train": settings}}
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    made = {"weights": "m.pt", "onnx": "m.onnx", "loss": "loss.csv", "summary": "summary.json"}
    made["every-s"] = "0.4"
    command = [sys.executable, ROOT / "pipeline/train.py", "mine", "--params", "params.yaml"]
    command += ["--training", "training", "--checkpoints", "checkpoints"]
    return command + [word for option, value in made.items() for word in (f"--{option}", value)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the stage has run undisturbed."""
    folder = tmp_path_factory.mktemp("whole")
    result = subprocess.run(prepare_stage(folder), cwd=folder, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


@pytest.mark.slow
def test_the_stage_writes_a_model_its_losses_and_its_scores(whole: Path):
    summary = json.loads((whole / "summary.json").read_text())
    assert summary["submaps"] == {"training": 20, "validation": 4}
    assert (summary["floor_m2"], summary["steps"]) == (0.01, 40)
    assert summary["model"]["kind"] == "pointnetkl"
    assert summary["labels"]["submaps"] == {"baltic": 12, "shetland": 12}
    assert summary["labels"]["label"]["noise_sigma_m"] == 0.1
    assert set(summary["kl"]) == set(summary["kl_floor0"]) == {"training", "validation"}
    losses = (whole / "loss.csv").read_text().splitlines()
    assert losses[0] == "step,training,validation,gradient_median,gradient_largest"
    assert [int(line.split(",")[0]) for line in losses[1:]] == list(range(0, 41, 5))
    assert model_file.read(whole / "m.pt").metadata["surveys"] == ["baltic", "shetland"]
    assert len(list((whole / "checkpoints").iterdir())) == 1  # from which a longer training goes on


@pytest.mark.slow
def test_a_killed_stage_goes_on_and_makes_the_very_files_of_an_undisturbed_one(whole: Path, tmp_path: Path):
    command, loss = prepare_stage(tmp_path), tmp_path / "loss.csv"
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    # its losses are there while it runs
    until(lambda: loss.exists() and len(loss.read_text().splitlines()) > 3 and any(tmp_path.glob("checkpoints/*.pt")))
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert not (tmp_path / "m.pt").exists()
    loss.unlink()  # as DVC does before it runs a stage
    resumed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert resumed.returncode == 0, resumed.stderr
    assert " 0/40" not in resumed.stderr
    for file in ("m.pt", "m.onnx", "loss.csv", "summary.json"):
        assert (tmp_path / file).read_bytes() == (whole / file).read_bytes(), file
