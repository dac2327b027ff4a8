"""Trains the depth detector on simulated worlds (`densecavoid perceive train-detector`)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from densecavoid.frames import CameraConfig, require
from densecavoid.learning.checkpoint import as_tensors, load_checkpoint, save_checkpoint
from densecavoid.learning.detector_loss import YoloLoss
from densecavoid.learning.finish_detector import write_detector
from densecavoid.perception.detector.card import DetectorCard
from densecavoid.perception.detector.darknet_config import DarknetConfig, parse_config, read_config_text
from densecavoid.perception.detector.encoding import PADDING_ROWS, encode_images
from densecavoid.perception.detector.network import DarknetNetwork
from densecavoid.perception.detector.views import Views, ViewsConfig, take_views
from densecavoid.perception.detector.worlds import training_rooms, training_worlds
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION

_WARM_UP_STEPS = 200
_LAST_RATE = 0.01  # of the learning rate, at the end
_CHECKPOINT_STEPS = 250
_RECORDED = (
    "seed",
    "images",
    "check_images",
    "passes",
    "batch",
    "learning_rate",
    "keep_empty",
    "network",
)  # in the detector's card
_KINDS = ("train", "check", "rooms")


@dataclass(frozen=True)
class TrainDetectorConfig:
    """Settings of `densecavoid perceive train-detector`. The same command goes on with an interrupted run."""

    out: Path = Path("runs/detector")
    """Folder of the images, the checkpoint and the result."""
    seed: int = 1
    images: int = 24_000
    """Labelled images of training worlds."""
    check_images: int = 2_000
    """Images of other training worlds: for the threshold and the claimed errors, never trained on."""
    passes: int = 10
    """Over all images."""
    batch: int = 32
    learning_rate: float = 2e-3
    keep_empty: float = 0.5
    """Share of images without anybody that are kept."""
    threads: int = 1
    """Of torch and of the simulator."""
    network: str = "depth-yolo"
    """A Darknet configuration: shipped, or a file. Its anchors are fitted to the people anew."""
    camera: CameraConfig = field(default_factory=CameraConfig)

    def __post_init__(self) -> None:
        for name in ("images", "check_images", "passes", "batch", "threads"):
            require(getattr(self, name) >= 1, f"TrainDetectorConfig.{name}", getattr(self, name), "at least 1")
        require(self.images >= self.batch, "TrainDetectorConfig.images", self.images, f"a batch, {self.batch}, or more")
        require(self.learning_rate > 0, "TrainDetectorConfig.learning_rate", self.learning_rate, "positive")
        require(0 < self.keep_empty <= 1, "TrainDetectorConfig.keep_empty", self.keep_empty, "in (0, 1]")

    @property
    def command(self) -> str:
        """The command line with these settings, but for the folder and the threads."""
        default = TrainDetectorConfig()
        changed = [name for name in _RECORDED if getattr(self, name) != getattr(default, name)]
        options = [f" --{name.replace('_', '-')} {getattr(self, name)}" for name in changed]
        return "densecavoid perceive train-detector" + "".join(options)

    @property
    def steps(self) -> int:
        """Updates of the weights in all."""
        return self.passes * (self.images // self.batch)


class Batch(NamedTuple):
    """What one update sees."""

    images: Tensor  # f32 [B, 3, 64, 80]
    boxes: Tensor  # f32 [B, L, 4] px of the network's input
    wanted: Tensor  # bool [B, L] people to find
    present: Tensor  # bool [B, L] everybody


def train_detector(config: TrainDetectorConfig) -> DetectorCard:
    """Makes the images, trains, and writes the detector with its card; goes on where an earlier call was interrupted.

    Raises:
        ValueError: if the folder holds a run of other settings.
        OSError: if the folder cannot be written.
    """
    config.out.mkdir(parents=True, exist_ok=True)
    views = images_of(config, "train", config.images)
    text = network_text(config, views)
    network = train_network(config, text, views)
    del views
    check, rooms = (images_of(config, kind, config.check_images) for kind in ("check", "rooms"))
    settings = {name: getattr(config, name) for name in _RECORDED}
    training = {"command": config.command, "settings": settings, "torch": torch.__version__}
    return write_detector(config.out, network, text, config.camera, check, rooms, training)


def images_of(config: TrainDetectorConfig, kind: str, count: int) -> Views:
    """The run's images to `train` on, to `check` with, or of `rooms` without anybody to check with: from its folder, or
    made anew and kept there."""
    path, which = config.out / f"views-{kind}.npz", _KINDS.index(kind)
    if path.is_file():
        with np.load(path) as arrays:
            views = Views(**{name: arrays[name] for name in Views._fields})
        require(
            len(views.num_people) == count, f"images in {path}", len(views.num_people), f"{count}; else remove the file"
        )
        return views
    seed = int(np.random.SeedSequence([config.seed, which]).generate_state(1)[0])
    worlds = training_rooms() if kind == "rooms" else training_worlds()
    keep_empty = 1.0 if kind == "rooms" else config.keep_empty
    looking = ViewsConfig(camera=config.camera, keep_empty=keep_empty, threads=config.threads)
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task(f"images to {kind}" if which < 2 else "images of empty rooms", total=count)
        views = take_views(worlds, count, seed, looking, lambda done: bar.update(task, completed=float(done)))
    temporary = path.with_suffix(".tmp.npz")
    np.savez(temporary, **views._asdict())
    temporary.replace(path)
    return views


def wanted_and_present(views: Views) -> tuple[np.ndarray, np.ndarray]:
    """bool [N, L] each: people of whom enough is seen to be found, and everybody of whom anything is."""
    present = np.arange(views.share.shape[1]) < views.num_people[:, None]
    return present & (views.share >= MIN_VISIBLE_FRACTION), present


def fit_anchors(sizes: np.ndarray, count: int, rounds: int = 100) -> np.ndarray:
    """Widths and heights [count, 2], least area first, that people's boxes [N, 2] are like: k-means with the distance
    1 - IoU of boxes with one centre (Redmon, Farhadi 2017). The same for the same boxes."""
    order = np.argsort(sizes.prod(axis=1), kind="stable")
    anchors = np.array([np.median(part, axis=0) for part in np.array_split(sizes[order], count)])
    for _ in range(rounds):
        both = np.minimum(sizes[:, None], anchors[None]).prod(axis=2)
        shared = both / (sizes.prod(axis=1)[:, None] + anchors.prod(axis=1)[None] - both)
        nearest = shared.argmax(axis=1)
        moved = np.array(
            [sizes[nearest == k].mean(axis=0) if (nearest == k).any() else anchors[k] for k in range(count)]
        )
        if np.allclose(moved, anchors):
            break
        anchors = moved
    return anchors[np.argsort(anchors.prod(axis=1), kind="stable")]


def with_anchors(text: str, anchors: np.ndarray) -> str:
    """A configuration's text with other anchors in all its heads."""
    flat = ", ".join(f"{width:.1f},{height:.1f}" for width, height in anchors)
    return re.sub(r"(?m)^anchors\s*=.*$", f"anchors={flat}", text)


def network_text(config: TrainDetectorConfig, views: Views) -> str:
    """The configuration with anchors fitted to the training images."""
    text = read_config_text(config.network)
    count = sum(len(head.anchors) for head, _ in parse_config(text, config.network).heads)
    wanted, _ = wanted_and_present(views)
    corners = views.box[wanted]
    return with_anchors(text, fit_anchors(corners[:, 2:] - corners[:, :2], count))


def batches(config: TrainDetectorConfig, views: Views, first_step: int) -> Iterator[Batch]:
    """The batches of all passes from a step on; each step's depends on the seed and its number alone."""
    a_pass = config.images // config.batch
    wanted, present = wanted_and_present(views)
    for step in range(first_step, config.steps):
        order = np.random.default_rng([config.seed, 2, step // a_pass]).permutation(config.images)
        k = step % a_pass
        rows = np.sort(order[k * config.batch : (k + 1) * config.batch])
        flip = np.random.default_rng([config.seed, 3, step]).random(config.batch) < 0.5
        yield make_batch(views.rows(rows), wanted[rows], present[rows], config.camera, flip)


def make_batch(
    views: Views, wanted: np.ndarray, present: np.ndarray, camera: CameraConfig, flip: np.ndarray | None = None
) -> Batch:
    """Encodes some images, those in `flip` mirrored left to right."""
    depth, box = views.depth_m, views.box.copy()
    if flip is not None:
        depth[flip] = depth[flip, :, ::-1]
        box[flip, :, 0::2] = camera.width - box[flip, :, 2::-2]
    box[:, :, 1::2] += PADDING_ROWS
    most = max(1, int(views.num_people.max()))
    return Batch(
        torch.from_numpy(encode_images(depth, views.mount, camera)),
        torch.from_numpy(box[:, :most]),
        torch.from_numpy(wanted[:, :most]),
        torch.from_numpy(present[:, :most]),
    )


def rate_at(config: TrainDetectorConfig, step: int) -> float:
    """The learning rate: a short rise, then half a cosine."""
    rise = min(1.0, (step + 1) / _WARM_UP_STEPS)
    fall = 0.5 * (1.0 + math.cos(math.pi * step / config.steps))
    return config.learning_rate * rise * (_LAST_RATE + (1.0 - _LAST_RATE) * fall)


def train_network(config: TrainDetectorConfig, text: str, views: Views) -> DarknetNetwork:
    """Trains the network on the images; goes on from the folder's checkpoint where there is one.

    Raises:
        ValueError: if the checkpoint is of other settings.
    """
    torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    darknet: DarknetConfig = parse_config(text, config.network)
    network = DarknetNetwork(darknet).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate, foreach=True)
    settings = {name: str(value) for name, value in asdict(config).items() if name not in ("out", "threads")}
    path = config.out / "checkpoint.safetensors"
    first_step = 0
    if path.is_file():
        first_step = _resume(path, settings | {"text": text}, network, optimizer)
    loss_of = YoloLoss(darknet)
    network.train()
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), TextColumn("{task.fields[loss]}")
    step = first_step
    running = np.full(3, np.nan)
    with Progress(*columns) as bar:
        task = bar.add_task("training", total=config.steps, completed=first_step, loss="")
        try:
            for batch in batches(config, views, first_step):
                for group in optimizer.param_groups:
                    group["lr"] = rate_at(config, step)
                images = batch.images.contiguous(memory_format=torch.channels_last)
                terms = loss_of(network(images), batch.boxes, batch.wanted, batch.present)
                optimizer.zero_grad(set_to_none=True)
                terms.total.backward()
                optimizer.step()
                step += 1
                latest = np.array([term.item() for term in terms])
                running = np.where(np.isnan(running), latest, 0.98 * running + 0.02 * latest)
                text_of_loss = "box {:.3f} objectness {:.3f} class {:.3f}".format(*running)
                bar.update(task, completed=step, loss=text_of_loss)
                if step % _CHECKPOINT_STEPS == 0 or step == config.steps:
                    _save(path, settings | {"text": text}, network, optimizer, step)
                    bar.console.print(f"step {step:,} of {config.steps:,}: {text_of_loss}")
        except KeyboardInterrupt:
            _save(path, settings | {"text": text}, network, optimizer, step)
            raise
    return network.eval()


def _save(
    path: Path, settings: dict[str, str], network: DarknetNetwork, optimizer: torch.optim.Adam, step: int
) -> None:
    moments = {
        f"{k}": {name: value for name, value in optimizer.state[parameter].items()}
        for k, parameter in enumerate(network.parameters())
        if parameter in optimizer.state
    }
    save_checkpoint(
        path, {"settings": settings, "step": step, "network": dict(network.state_dict()), "moments": moments}
    )


def _resume(path: Path, settings: dict[str, str], network: DarknetNetwork, optimizer: torch.optim.Adam) -> int:
    saved = load_checkpoint(path)
    for name, value in settings.items():
        was = saved["settings"].get(name)
        require(was == value, f"{name} of {path}", was, f"{value}; else remove the file")
    network.load_state_dict(as_tensors(saved["network"]))
    for k, parameter in enumerate(network.parameters()):
        optimizer.state[parameter] = as_tensors(saved["moments"].get(str(k), {}))
    return int(saved["step"])
