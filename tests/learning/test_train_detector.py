"""Training a detector: the loss and anchors by hand, batches, resuming to the bit, and the command as a whole."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.cli import main  # noqa: E402
from densecavoid.learning import train_detector as training  # noqa: E402
from densecavoid.learning.detector_loss import YoloLoss, overlaps  # noqa: E402
from densecavoid.learning.train_detector import (  # noqa: E402
    TrainDetectorConfig,
    fit_anchors,
    make_batch,
    network_text,
    train_network,
    wanted_and_present,
)
from densecavoid.perception.detector.darknet_config import parse_config  # noqa: E402
from densecavoid.perception.detector.decode import overlap  # noqa: E402
from densecavoid.perception.detector.views import Views, ViewsConfig, take_views  # noqa: E402
from densecavoid.perception.detector.worlds import PeopleAmongThings  # noqa: E402

ONE_HEAD = """[net]
width=32
height=16
channels=1
[convolutional]
filters=12
size=1
stride=8
activation=linear
[yolo]
anchors=4,6, 10,12
classes=1
"""
LN2 = math.log(2)


def loss_of(raw, boxes, wanted, present=None):
    boxes, wanted = torch.tensor([boxes], dtype=torch.float32), torch.tensor([wanted])
    present = wanted if present is None else torch.tensor([present])
    return YoloLoss(parse_config(ONE_HEAD))([raw], boxes, wanted, present)


def test_the_loss_of_a_network_that_says_nothing_is_what_the_formulas_give():
    # 10 x 12 around (22, 12): the second anchor's shape, in column 2 of row 1, three quarters across, half down.
    terms = loss_of(torch.zeros(1, 12, 2, 4), [[17.0, 6.0, 27.0, 18.0]], [True])
    weight = 2 - 10 * 12 / (32 * 16)
    assert terms.box.item() == pytest.approx(weight * 2 * LN2)
    assert terms.objectness.item() == pytest.approx(16 * LN2)
    assert terms.label.item() == pytest.approx(LN2)
    # Twice as wide as the anchor: the logarithm of 2, squared, more.
    wide = loss_of(torch.zeros(1, 12, 2, 4), [[12.0, 6.0, 32.0, 18.0]], [True])
    weight = 2 - 20 * 12 / (32 * 16)
    assert wide.box.item() == pytest.approx(weight * (2 * LN2 + LN2**2), rel=1e-5)


def test_the_right_answer_costs_nothing_but_what_uncertain_places_cost():
    raw = torch.full((1, 2, 6, 2, 4), -30.0)
    raw[0, 1, :, 1, 2] = torch.tensor([0.0, 0.0, 0.0, 0.0, 30.0, 30.0])
    terms = loss_of(raw.view(1, 12, 2, 4), [[15.0, 6.0, 25.0, 18.0]], [True])
    assert terms.objectness.item() < 1e-6 and terms.label.item() < 1e-6
    assert terms.box.item() == pytest.approx((2 - 120 / 512) * 2 * LN2)


def test_people_of_whom_too_little_is_seen_are_neither_demanded_nor_forbidden():
    hidden = [[-1.0, -2.0, 9.0, 10.0]]  # just what the second anchor of the first cell says
    raw = torch.zeros(1, 12, 2, 4)
    assert loss_of(raw, hidden, [False], [True]).objectness.item() == pytest.approx(15 * LN2)
    assert loss_of(raw, hidden, [False], [False]).objectness.item() == pytest.approx(16 * LN2)
    assert loss_of(raw, hidden, [False], [True]).box.item() == 0.0


def test_a_box_near_a_person_of_another_cell_is_not_blamed():
    # The neighbours' boxes, 8 px away, overlap too little; those of the same place but another cell do not exist here,
    # so the truth is put between two cells: IoU of a box 10 wide, 1.2 px aside, is 8.8 / 11.2 > .7.
    raw = torch.zeros(1, 12, 2, 4)
    raw[0, 6 + 0, 0, 1] = 20.0  # cell 1's box at its right edge, 16
    terms = loss_of(raw, [[12.2, -2.0, 22.2, 10.0]], [True])  # centre 17.2: cell 2 is responsible
    assert terms.objectness.item() == pytest.approx(15 * LN2)


def test_overlaps_are_those_of_the_decoder():
    rng = np.random.default_rng(0)
    corner = rng.uniform(0, 10, (2, 7, 2))
    boxes = np.concatenate([corner, corner + rng.uniform(1, 8, corner.shape)], axis=-1)
    found = overlaps(torch.from_numpy(boxes[0]), torch.from_numpy(boxes[1])).numpy()
    np.testing.assert_allclose(found, [[overlap(a, b) for b in boxes[1]] for a in boxes[0]], atol=1e-12)


def test_anchors_are_the_middles_of_clear_clusters():
    rng = np.random.default_rng(1)
    middles = np.array([[6.0, 20.0], [12.0, 36.0], [25.0, 48.0]])
    sizes = np.concatenate([m + rng.normal(0, 0.3, (n, 2)) for m, n in zip(middles, (120, 100, 110), strict=True)])
    np.testing.assert_allclose(fit_anchors(sizes[rng.permutation(330)], 3), middles, atol=0.15)


@pytest.fixture(scope="module")
def views() -> Views:
    config = ViewsConfig(images_a_world=3, worlds_at_once=16, keep_empty=0.1)
    return take_views(PeopleAmongThings(), 32, 4, config)


def test_mirrored_images_have_mirrored_boxes(views):
    wanted, present = wanted_and_present(views)
    camera = TrainDetectorConfig().camera
    plain, flipped = (make_batch(views, wanted, present, camera, np.full(32, flip)) for flip in (False, True))
    np.testing.assert_array_equal(flipped.images.numpy(), plain.images.numpy()[..., ::-1])
    there = plain.present.numpy()
    a, b = plain.boxes.numpy()[there], flipped.boxes.numpy()[there]
    np.testing.assert_allclose(a[:, [0, 2]], 80 - b[:, [2, 0]], atol=1e-5)
    np.testing.assert_array_equal(a[:, [1, 3]], b[:, [1, 3]])
    # Rows of the network's input begin above the image's.
    np.testing.assert_allclose(a[:, 1], views.box[present][:, 1] + 2, atol=1e-5)


def test_the_networks_anchors_are_fitted_to_the_images(views):
    config = parse_config(network_text(TrainDetectorConfig(), views))
    anchors = [anchor for head, _ in config.heads for anchor in head.anchors]
    wanted, _ = wanted_and_present(views)
    height = (views.box[..., 3] - views.box[..., 1])[wanted]
    assert min(a[1] for a in anchors) >= height.min() - 0.1 and max(a[1] for a in anchors) <= height.max() + 0.1
    near, far = config.heads[0][0].anchors, config.heads[1][0].anchors
    assert min(w * h for w, h in near) > max(w * h for w, h in far)


def test_an_interrupted_run_goes_on_to_the_same_bits(views, tmp_path, monkeypatch):
    config = TrainDetectorConfig(out=tmp_path / "whole", images=32, batch=8, passes=2)
    text = network_text(config, views)
    config.out.mkdir()
    whole = train_network(config, text, views)
    other = dataclasses.replace(config, out=tmp_path / "parts")
    other.out.mkdir()
    batches = training.batches

    def interrupted(*args):
        for k, batch in enumerate(batches(*args)):
            if k == 3:
                raise KeyboardInterrupt
            yield batch

    monkeypatch.setattr(training, "batches", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train_network(other, text, views)
    monkeypatch.setattr(training, "batches", batches)
    parts = train_network(other, text, views)
    for (name, a), b in zip(whole.state_dict().items(), parts.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    with pytest.raises(ValueError, match=r"learning_rate of .* is '0\.002', expected 0\.1"):
        train_network(dataclasses.replace(other, learning_rate=0.1), text, views)


@pytest.mark.parametrize(
    ("change", "name"), [({"images": 5}, "images"), ({"keep_empty": 0.0}, "keep_empty"), ({"passes": 0}, "passes")]
)
def test_a_wrong_setting_is_named(change, name):
    with pytest.raises(ValueError, match=f"TrainDetectorConfig.{name}"):
        TrainDetectorConfig(**change)


@pytest.mark.slow
def test_the_command_writes_a_detector_with_its_card_and_learns(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--images", "800", "--check-images", "60", "--passes", "12", "--batch", "16", "--seed", "3"]
    assert main(["perceive", "train-detector", "--out", str(out), *options]) == 0
    capsys.readouterr()
    card = json.loads((out / "detector.json").read_text())
    assert card["training"]["command"].startswith("densecavoid perceive train-detector --seed 3")
    assert card["training"]["settings"]["images"] == 800
    assert card["training"]["check_ap50"] > 0.3
    assert Path(out / "detector.onnx").stat().st_size < 1_000_000 and (out / "detector.safetensors").exists()
