"""Trains a learned predictor: first the distance of the mean, and beside it the likelihood of the spread.

The mean learns from distances alone (errors have heavy tails, which the likelihood would follow); the spread learns the
likelihood around that mean. The weights kept are an exponential moving average.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from rich.console import Console
from torch import Tensor, nn

from densecavoid.frames import choose, require
from densecavoid.learning.checkpoint import as_tensors, load_checkpoint, save_checkpoint
from densecavoid.perception.predictor.calibration import INSIDE_HALF, mahalanobis_square
from densecavoid.perception.predictor.card import KINDS, PredictorCard
from densecavoid.perception.predictor.compact import CompactConfig
from densecavoid.perception.predictor.contract import (
    FIELD_PERIOD_S,
    FIELD_SEEN,
    ROBOT_HORIZONS_S,
    ROBOT_PERIOD_S,
    ROBOT_SAMPLES,
)
from densecavoid.perception.predictor.export import make_network, save_predictor
from densecavoid.perception.predictor.learned import every, network_inputs, to_world
from densecavoid.perception.predictor.robust_tp import RobustTPConfig
from densecavoid.perception.predictor.track_noise import TrackNoise, as_tracked
from densecavoid.perception.predictor.training_data import (
    FIELD_HORIZONS_S,
    TASKS,
    batches,
    field_windows,
    robot_windows,
    varied,
)
from densecavoid.perception.predictor.windows import HERMES_TEST, HERMES_VALIDATION, SCENES, Windows
from densecavoid.scenarios.recordings import resolve_data

_DECAY = 0.995  # of the moving average of weights, a step
_LIKELIHOOD_WEIGHT = 0.05
_WARM_UP = 200  # steps to the full learning rate
_CHECKPOINT_EVERY = 250


@dataclass(frozen=True)
class TrainPredictorConfig:
    """Settings of `densecavoid perceive train-predictor`."""

    data: Path | None = None
    """Folder of recordings (else DENSECAVOID_DATA)."""
    out: Path = Path("runs/predictor")
    """Folder for checkpoint and weights; a run that was cut off goes on from there."""
    kind: Literal["compact", "robust-tp"] = "compact"
    task: Literal["robot", "field"] = "robot"
    """robot: .1 to 1.2 s ahead, from HERMES, ETH/UCY, simulated crowds and noisy tracks. field: ETH/UCY, 12 steps."""
    fold: Literal["all", "eth", "hotel", "univ", "zara1", "zara2"] = "all"
    """Scene that is left out (field)."""
    steps: int = 6000
    """Batches."""
    batch: int = 512
    """People in one, about."""
    learning_rate: float = 1.5e-3
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        choose("kind", self.kind, KINDS)
        choose("task", self.task, TASKS)
        choose("fold", self.fold, ("all", *SCENES))
        require(self.task == "field" or self.fold == "all", "fold", self.fold, "'all' for the task 'robot'")
        for name in ("steps", "batch", "learning_rate", "threads"):
            require(getattr(self, name) > 0, f"TrainPredictorConfig.{name}", getattr(self, name), "positive")
        require(self.seed >= 0, "TrainPredictorConfig.seed", self.seed, "0 or more")

    @property
    def file_name(self) -> str:
        """Of the weights, without ending."""
        return f"predictor-{self.kind}-{self.task}" + ("" if self.fold == "all" else f"-without-{self.fold}")


def first_card(config: TrainPredictorConfig) -> PredictorCard:
    """The card of a predictor that is yet to be trained. RobustTP looks at steps of .4 s in either task."""
    coarse = config.task == "field" or config.kind == "robust-tp"
    samples = FIELD_SEEN if coarse else ROBOT_SAMPLES
    horizons = FIELD_HORIZONS_S if config.task == "field" else ROBOT_HORIZONS_S[1 if coarse else 0 :]
    network = (CompactConfig if config.kind == "compact" else RobustTPConfig)(samples=samples, horizons_s=horizons)
    return PredictorCard(
        name=config.kind,
        kind=config.kind,
        period_s=FIELD_PERIOD_S if coarse else ROBOT_PERIOD_S,
        samples=samples,
        horizons_s=horizons,
        base_acceleration_std=0.5 if coarse else 1.0,
        base_measurement_std=0.05,
        network=asdict(network),
        temperature=(1.0,) * len(horizons),
    )


def train_predictor(config: TrainPredictorConfig) -> Path:
    """Trains, fits temperatures, writes the weights in both forms and the card.

    Returns:
        The ONNX file.

    Raises:
        ValueError: if there are no recordings.
    """
    torch.set_num_threads(config.threads)
    console, data = Console(stderr=True), resolve_data(config.data)
    if config.task == "robot":
        training, validation = robot_windows(data, config.seed, lambda text: console.print(text, highlight=False))
    else:
        training, validation = field_windows(data, None if config.fold == "all" else config.fold)
    console.print(f"{config.file_name}: {len(training):,} histories, {len(validation):,} to validate", highlight=False)
    run = _Run(config, first_card(config))
    run.resume()
    for batch in _endless(training, config, run.step):
        if run.step >= config.steps:
            break
        loss = run.learn(batch)
        if run.step % _CHECKPOINT_EVERY == 0:
            run.save()
            minutes = run.seconds / 60
            console.print(f"step {run.step} of {config.steps}, {minutes:.1f} min: loss {loss:.4f}", highlight=False)
    network, card = run.averaged(), run.card
    seen = [validation]
    if config.task == "robot":  # as recorded, and as a tracker sees it
        seen.append(as_tracked(validation, TrackNoise(), np.random.default_rng(config.seed)))
    temperature = fit_temperature(network, card, seen)
    about = {
        "task": config.task,
        "left_out": [config.fold] if config.task == "field" else [*HERMES_TEST],
        "validated_by": "the last part of each file" if config.task == "field" else [*HERMES_VALIDATION],
        "steps": config.steps,
        "batch": config.batch,
        "seed": config.seed,
        "minutes": round(run.seconds / 60, 1),
        "histories": len(training),
    }
    return save_predictor(config.out, config.file_name, network, replace(card, temperature=temperature, training=about))


def loss_of(gaussians: Tensor, truth: Tensor, weight: Tensor, horizons_s: Tensor) -> Tensor:
    """Mean distance, with a small part of the likelihood of the spread; NaN truths count for nothing.

    Args:
        gaussians: [N, S, 5] as `compact.gaussians` makes them.
        truth: [N, S, 2] the correction that would have been right, m.
        weight: [N] how much a track counts.
        horizons_s: [S]. The last distances would drown the first: each is weighted by one over its horizon and a
            twelfth of the last.
    """
    known = torch.isfinite(truth).all(dim=2)
    miss = gaussians[..., :2] - torch.nan_to_num(truth)
    distance = (miss.square().sum(dim=2) + 1e-6).sqrt()
    std, correlation = gaussians[..., 2:4], gaussians[..., 4]
    z = miss.detach() / std
    rest = 1.0 - correlation.square()
    square = (z.square().sum(dim=2) - 2.0 * correlation * z[..., 0] * z[..., 1]) / rest
    likelihood = std.log().sum(dim=2) + 0.5 * rest.log() + 0.5 * square
    evened = 1.0 / (horizons_s[-1] / 12.0 + horizons_s)
    total = distance * evened + _LIKELIHOOD_WEIGHT * likelihood
    counted = known * weight[:, None]
    return (total * counted).sum() / counted.sum().clamp(min=1e-6)


def truth_of(windows: Windows, card: PredictorCard, velocity: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """[N, S, 2] where people were at the card's horizons, from the constant-velocity line, ahead and left; m."""
    future = windows.future[:, windows.future.shape[1] - len(card.horizons_s) :]
    off = future - windows.pos[:, -1:] - velocity[:, None] * np.asarray(card.horizons_s)[:, None]
    cos, sin = direction[:, None, 0], direction[:, None, 1]
    truth = np.stack([cos * off[..., 0] + sin * off[..., 1], cos * off[..., 1] - sin * off[..., 0]], axis=2)
    return np.where(windows.valid[:, -1, None, None], truth, np.nan).astype(np.float32)


def fit_temperature(network: nn.Module, card: PredictorCard, windows: Sequence[Windows]) -> tuple[float, ...]:
    """The factor on the standard deviations at each horizon that puts half of the truths into the 50 % ellipse."""
    horizons, squares = np.asarray(card.horizons_s), []
    for part in windows:
        for batch in batches(part, 2048, np.random.default_rng(0)):
            inputs, velocity, direction = network_inputs(card, every(batch.histories(), card.period_s))
            with torch.no_grad():
                raw = network(*map(torch.from_numpy, inputs)).numpy()
            now = batch.pos[:, -1].astype(np.float64)
            prediction = to_world(raw, card, horizons, now, velocity, direction)
            squares.append(mahalanobis_square(prediction, batch.future[:, batch.future.shape[1] - len(horizons) :]))
    median = np.nanmedian(np.concatenate(squares), axis=0)
    return tuple(round(float(value), 4) for value in np.sqrt(median / INSIDE_HALF))


def _endless(windows: Windows, config: TrainPredictorConfig, step: int) -> Iterator[Windows]:
    """Varied batches from the given step on: pass after pass, the same whether or not the run was cut off."""
    done, epoch = 0, 0
    while True:
        for batch in batches(windows, config.batch, np.random.default_rng((config.seed, epoch))):
            if done >= step:
                yield varied(batch, config.task, np.random.default_rng((config.seed, 1 + epoch, done)))
            done += 1
        epoch += 1


class _Run:
    """Network, optimiser and their averages between two batches."""

    def __init__(self, config: TrainPredictorConfig, card: PredictorCard) -> None:
        torch.manual_seed(config.seed)
        self.config, self.card = config, card
        self.network = make_network(card).train()
        self.average = {name: tensor.clone() for name, tensor in self.network.state_dict().items()}
        self.optimiser = torch.optim.AdamW(self.network.parameters(), config.learning_rate, weight_decay=1e-4)
        self.horizons = torch.tensor(card.horizons_s)
        self.step, self.seconds = 0, 0.0
        self.path = config.out / f"{config.file_name}.checkpoint.safetensors"

    def learn(self, batch: Windows) -> float:
        """One step. Returns the loss."""
        started_s = time.perf_counter()
        torch.manual_seed(self.config.seed * 1_000_003 + self.step)  # of dropout, so that a resumed run is the same
        inputs, velocity, direction = network_inputs(self.card, every(batch.histories(), self.card.period_s))
        truth = torch.from_numpy(truth_of(batch, self.card, velocity, direction))
        loss = loss_of(
            self.network(*map(torch.from_numpy, inputs)), truth, torch.from_numpy(batch.weight), self.horizons
        )
        share = min(1.0, (self.step + 1) / _WARM_UP) * 0.5 * (1 + np.cos(np.pi * self.step / self.config.steps))
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.learning_rate * max(share, 0.01)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        with torch.no_grad():
            for name, tensor in self.network.state_dict().items():
                if tensor.is_floating_point():
                    self.average[name].lerp_(tensor, max(1 - _DECAY, 1 / (self.step + 2)))
                else:
                    self.average[name].copy_(tensor)
        self.step += 1
        self.seconds += time.perf_counter() - started_s
        return float(loss.detach())

    def averaged(self) -> nn.Module:
        """The network with the averaged weights, ready to run."""
        network = make_network(self.card)
        network.load_state_dict(self.average)
        return network.eval()

    def save(self) -> None:
        """Writes everything that decides how the run goes on; a crash leaves the old file or the new one."""
        state = {
            "settings": self._settings(),
            "step": self.step,
            "seconds": self.seconds,
            "network": dict(self.network.state_dict()),
            "average": self.average,
            "optimiser": {str(k): dict(moments) for k, moments in self.optimiser.state_dict()["state"].items()},
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        save_checkpoint(self.path, state)

    def resume(self) -> None:
        """Goes on from the checkpoint, if there is one.

        Raises:
            ValueError: if it was made with other settings.
        """
        if not self.path.exists():
            return
        saved = load_checkpoint(self.path)
        require(saved["settings"] == self._settings(), str(self.path), saved["settings"], self._settings())
        self.step, self.seconds = saved["step"], saved["seconds"]
        self.network.load_state_dict(as_tensors(saved["network"]))
        self.average = as_tensors(saved["average"])
        state = {int(k): as_tensors(moments) for k, moments in saved["optimiser"].items()}
        self.optimiser.load_state_dict(self.optimiser.state_dict() | {"state": state})

    def _settings(self) -> str:
        config = self.config
        names = ("kind", "task", "fold", "steps", "batch", "learning_rate", "seed")
        return " ".join(str(getattr(config, name)) for name in names)
