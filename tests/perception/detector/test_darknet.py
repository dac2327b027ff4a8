"""Darknet's configurations and weights: against OpenCV's own importer, published sizes, and files that are wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from densecavoid.perception.detector.configurations import SHIPPED
from densecavoid.perception.detector.darknet_config import (
    DarknetConfig,
    Route,
    Yolo,
    load_config,
    parse_config,
    read_config_text,
)
from densecavoid.perception.detector.darknet_weights import (
    ConvolutionWeights,
    kernel_shapes,
    num_weights,
    read_weights,
    write_weights,
)
from densecavoid.perception.detector.decode import Decoder

SMALL = """[net]
width=16
height=8
channels=1
[convolutional]
batch_normalize=1
filters=2
size=3
stride=2
pad=1
activation=leaky
[convolutional]
filters=6
size=1
stride=1
pad=1
activation=linear
[yolo]
mask=0
anchors=4,5
classes=1
"""


def random_weights(config: DarknetConfig, seed: int = 0) -> list[ConvolutionWeights]:
    """Such that values neither die out nor explode on their way through a hundred layers."""
    rng = np.random.default_rng(seed)

    def draw(low: float, high: float, count: int) -> np.ndarray:
        return rng.uniform(low, high, count).astype(np.float32)

    weights = []
    for shape, norm in kernel_shapes(config):
        kernel = rng.standard_normal(shape, np.float32) * np.float32((1.5 / np.prod(shape[1:])) ** 0.5)
        out, bias = shape[0], draw(-0.1, 0.1, shape[0])
        scale, mean, variance = (draw(*span, out) if norm else None for span in ((0.5, 1), (-0.1, 0.1), (0.5, 1.5)))
        weights.append(ConvolutionWeights(bias, scale, mean, variance, kernel))
    return weights


def thin(text: str) -> str:
    """The same network with an eighth of the filters, but for the heads': fast, and every layer is still there."""
    return re.sub(r"filters=(\d+)", lambda m: m[0] if m[1] == "255" else f"filters={max(4, int(m[1]) // 8)}", text)


@pytest.mark.parametrize(
    ("name", "side", "thinned"),
    [
        ("yolov3-tiny", 96, False),
        ("yolov3", 96, True),
        pytest.param("yolov3", 416, False, marks=pytest.mark.slow),
        pytest.param("yolov3-tiny", 416, False, marks=pytest.mark.slow),
    ],
)
def test_raw_outputs_and_boxes_are_those_of_opencvs_darknet_importer(name, side, thinned, tmp_path):
    torch = pytest.importorskip("torch")
    cv2 = pytest.importorskip("cv2")
    from densecavoid.perception.detector.network import DarknetNetwork

    text = re.sub(r"(width|height)=416", rf"\1={side}", read_config_text(name))
    text = thin(text) if thinned else text
    config = parse_config(text)
    (tmp_path / "net.cfg").write_text(text)
    write_weights(tmp_path / "net.weights", random_weights(config))
    network = DarknetNetwork(config).eval()
    for block, arrays in zip(network.convolutions(), read_weights(tmp_path / "net.weights", config), strict=True):
        block.load(arrays)
    image = np.random.default_rng(1).random((1, 3, side, side), np.float32)
    with torch.no_grad():
        ours = [head.numpy() for head in network(torch.from_numpy(image))]

    engine = cv2.dnn.readNetFromDarknet(str(tmp_path / "net.cfg"), str(tmp_path / "net.weights"))
    engine.setInput(image)
    heads = [k for k, layer in enumerate(config.layers) if isinstance(layer, Yolo)]
    theirs = engine.forward([f"conv_{k - 1}" for k in heads])
    for a, b in zip(ours, theirs, strict=True):
        assert np.abs(b).max() > 0.1
        np.testing.assert_allclose(a, b, atol=1e-3)

    # OpenCV's rows: middle, width and height as shares of the image, objectness, and class probabilities above .2.
    rows = np.concatenate(engine.forward([f"yolo_{k}" for k in heads]))
    scores = rows[:, 5:]
    # Between two scores, so that rounding cannot move one across.
    threshold = float(np.sort(scores.ravel())[-101:-99].mean())
    assert threshold > 0.2
    decoded = Decoder(config, threshold, 1.0)([head[0] for head in ours])
    row, label = np.nonzero(scores > threshold)
    assert len(row) == 100 and len(decoded.confidence) == 100
    corners = np.concatenate([rows[row, :2] - rows[row, 2:4] / 2, rows[row, :2] + rows[row, 2:4] / 2], axis=1) * side
    expected = np.column_stack([scores[row, label], label, corners])
    found = np.column_stack([decoded.confidence, decoded.label, decoded.box])

    def ordered(table: np.ndarray) -> np.ndarray:
        return table[np.lexsort((np.round(table[:, 2], 1), np.round(table[:, 3], 1), table[:, 1]))]

    np.testing.assert_allclose(ordered(found), ordered(expected), atol=2e-2, rtol=1e-4)


def test_files_have_the_published_numbers_of_weights():
    assert num_weights(load_config("yolov3")) == 62_001_757
    assert num_weights(load_config("yolov3-tiny")) == 8_858_734
    shapes = [tuple(shape) for _, shape in load_config("yolov3").heads]
    assert shapes == [(255, 13, 13), (255, 26, 26), (255, 52, 52)]
    layers = load_config("yolov3").layers
    assert [layer.sources[1] for layer in layers if isinstance(layer, Route) and len(layer.sources) > 1] == [61, 36]


def test_weights_are_read_as_they_were_written_and_torch_gives_them_back(tmp_path):
    config = load_config("depth-yolo")
    path = tmp_path / "net.weights"
    written = random_weights(config)
    write_weights(path, written, images_seen=7)
    assert path.stat().st_size == 20 + 4 * num_weights(config)
    read = read_weights(path, config)
    for a, b in zip(written, read, strict=True):
        for one, other in zip(a, b, strict=True):
            np.testing.assert_array_equal(one, other)
    pytest.importorskip("torch")
    from densecavoid.perception.detector.network import DarknetNetwork

    network = DarknetNetwork(config)
    for block, arrays in zip(network.convolutions(), read, strict=True):
        block.load(arrays)
        for one, other in zip(block.darknet_weights(), arrays, strict=True):
            assert (one is None) == (other is None)
            if one is not None and other is not None:
                np.testing.assert_allclose(one, other, rtol=1e-5)


def test_old_files_count_images_in_four_bytes(tmp_path):
    config = parse_config(SMALL)
    new, old = tmp_path / "new.weights", tmp_path / "old.weights"
    write_weights(new, random_weights(config))
    old.write_bytes(np.array([0, 1, 0, 5], "<i4").tobytes() + new.read_bytes()[20:])
    for a, b in zip(read_weights(new, config), read_weights(old, config), strict=True):
        np.testing.assert_array_equal(a.kernel, b.kernel)


def test_a_file_of_the_wrong_version_or_size_says_what_was_expected_and_found(tmp_path):
    config = parse_config(SMALL)
    path = tmp_path / "net.weights"
    write_weights(path, random_weights(config))
    good = path.read_bytes()
    assert len(good) == 20 + 4 * (2 * 4 + 2 * 9 + 6 + 6 * 2)
    for content, message in (
        (good[:-4], r"192 bytes.*expected 196 bytes"),
        (good + b"\0\0\0\0", r"200 bytes.*expected 196 bytes"),
        (np.array([3, 0, 0], "<i4").tobytes() + good[12:], r"version.*3\.0\.0.*expected 0\.1 or 0\.2"),
        (good[:5], r"version.*none, in 5 bytes"),
        (good[:-4] + np.array([np.nan], "<f4").tobytes(), "not all finite"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            read_weights(path, config)
    with pytest.raises(ValueError, match="248,007,048 bytes for this"):
        path.write_bytes(good)
        read_weights(path, load_config("yolov3"))


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        ("[net]", "[convolutional]", r"begins \[net\]"),
        ("width=16", "width=", r"width is '', expected a whole number"),
        ("width=16", "width=1e9", "expected a whole number from 1 to 8192"),
        ("filters=2", "filters=100000", "expected a whole number from 1 to 16384"),
        ("size=3", "three", r"configuration:8 is 'three', expected \[a kind"),
        ("[yolo]", "[softmax]", r"unknown layer at configuration:18 'softmax'"),
        ("leaky", "swish", "unknown activation"),
        ("classes=1", "classes=2", r"channels before .* 6, expected 7"),
        ("anchors=4,5", "anchors=4", "pairs of positive numbers"),
        ("mask=0", "mask=1", "numbers of the 1 anchors"),
        ("[yolo]", "[shortcut]\nfrom=-3\n[yolo]", "from is -3, expected one of the 2 layers"),
        ("[yolo]", "[shortcut]\nfrom=-2\n[yolo]", "shape of layer 0"),
        ("[yolo]", "[route]\nlayers=-1,x\n[yolo]", "numbers with commas"),
        ("[yolo]", "[end]", "unknown layer"),
        ("[yolo]\nmask=0\nanchors=4,5\nclasses=1", "", "heads of"),
    ],
)
def test_a_wrong_configuration_says_where_and_what_was_expected(wrong, right, message):
    with pytest.raises(ValueError, match=message):
        parse_config(SMALL.replace(wrong, right))


def test_an_unknown_configuration_names_those_there_are():
    with pytest.raises(FileNotFoundError, match=", ".join(SHIPPED)):
        load_config("yolov9")
    with pytest.raises(FileNotFoundError):
        load_config(Path("/nowhere/net.cfg"))
