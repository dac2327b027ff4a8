"""The detectors a robot runs: the shipped one on held-out worlds, ONNX against torch, colour images, wrong files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from standing import view_of

from densecavoid.frames import CameraConfig
from densecavoid.perception.detector.card import DetectorCard
from densecavoid.perception.detector.detector import DETECTORS, DepthDetector, RgbDetector, letterbox
from densecavoid.perception.detector.encoding import encode_images
from densecavoid.perception.detector.views import ViewsConfig, take_views
from densecavoid.perception.detector.worlds import held_out_rooms, held_out_worlds
from densecavoid.perception.evaluation.detector import (
    curve,
    error_table,
    false_alarms_per_image,
    look_at,
    place_errors,
    to_find,
)

WEIGHTS = Path(__file__).parents[3] / "src" / "densecavoid" / "perception" / "weights"


@pytest.fixture(scope="module")
def detector() -> DepthDetector:
    return DepthDetector("depth-yolo")


def test_somebody_in_view_is_found_and_placed(detector):
    views = view_of([(3.0, 0.5), (4.0, -0.8)], sensors="real")
    found = detector.detect(views.depth_m[0], np.array([1.0, 0.0, 0.0]))
    assert found.count.tolist() == [2]
    order = np.argsort(found.pos[0, :2, 0])
    np.testing.assert_allclose(found.pos[0, order], [[4.0, 0.5], [5.0, -0.8]], atol=0.12)
    assert (found.confidence[0, :2] >= detector.card.threshold).all()
    assert (found.std_m[0, :2] > 0).all() and (found.std_m[0, :2] < 0.3).all()


def test_an_image_without_any_depth_shows_nobody(detector):
    assert detector.detect(np.full((60, 80), np.nan, np.float32)).count.tolist() == [0]
    assert detector.detect(np.full((60, 80), np.inf, np.float32)).count.tolist() == [0]


def measure(detector: DepthDetector, images: int, rooms: int) -> dict[str, float]:
    config = ViewsConfig(vary_mount=False)
    low = DepthDetector("depth-yolo", threshold=0.02)
    views, empty = take_views(held_out_worlds(), images, 17, config), take_views(held_out_rooms(), rooms, 18, config)
    found = look_at(views, low)
    table = error_table(views, found, detector.card.threshold)
    return {
        "ap50": curve(views, found, to_find(views, (1.4, 5.0), (1 / 3, np.inf))).average_precision,
        "false": false_alarms_per_image(look_at(empty, detector), detector.card.threshold),
        "median_m": place_errors(table)["median_m"],
    }


def test_on_a_few_held_out_images_people_are_found_and_placed(detector):
    results = measure(detector, 60, 30)
    assert results["ap50"] >= 0.9 and results["median_m"] <= 0.1 and results["false"] <= 0.1


@pytest.mark.slow
def test_what_is_promised_holds_on_held_out_worlds(detector):
    results = measure(detector, 1000, 1000)
    assert results["ap50"] >= 0.90
    assert results["false"] <= 0.02
    assert results["median_m"] <= 0.10


def test_the_table_of_errors_says_what_became_of_everybody(detector):
    config = ViewsConfig(vary_mount=False)
    views = take_views(held_out_worlds(), 40, 3, config)
    table = error_table(views, look_at(views, detector), detector.card.threshold)
    assert len(table["detected"]) == views.num_people.sum() and table["num_images"] == 40
    assert np.isnan(table["along_m"][~table["detected"]]).all()
    hits = table["detected"]
    assert hits.sum() > 10 and np.isfinite(table["along_m"][hits]).all()
    assert np.percentile(np.hypot(table["along_m"], table["across_m"])[hits], 90) < 0.2
    assert (table["confidence"][hits] >= detector.card.threshold).all()
    # From the other end: where each was said to be, and where they are.
    place = np.concatenate([views.place[n, :count] for n, count in enumerate(views.num_people)])
    np.testing.assert_allclose(table["distance_m"], np.hypot(*place.T), rtol=1e-6)
    np.testing.assert_allclose(table["bearing_rad"], np.arctan2(place[:, 1], place[:, 0]), atol=1e-6)


def test_onnx_and_torch_give_the_same_heads(detector):
    torch = pytest.importorskip("torch")
    import onnxruntime

    from densecavoid.perception.detector.export import load_detector

    network, card = load_detector(WEIGHTS / "depth-yolo.safetensors")
    assert card == detector.card
    images = encode_images(
        *(lambda v: (v.depth_m, v.mount))(take_views(held_out_worlds(), 6, 1, ViewsConfig())), CameraConfig()
    )
    session = onnxruntime.InferenceSession(DETECTORS.read("depth-yolo"), providers=["CPUExecutionProvider"])
    with torch.no_grad():
        expected = [head.numpy() for head in network(torch.from_numpy(images))]
    for a, b in zip(session.run(None, {"images": images}), expected, strict=True):
        np.testing.assert_allclose(np.asarray(a), b, atol=1e-4)


def test_the_shipped_card_is_the_one_beside_it(detector):
    assert DETECTORS.names() == ("depth-yolo",)
    text = (WEIGHTS / "depth-yolo.json").read_text()
    assert DetectorCard.from_metadata({"densecavoid.detector": text}, "depth-yolo.json") == detector.card
    assert (WEIGHTS / "depth-yolo.onnx").stat().st_size < 1_000_000


@pytest.mark.parametrize(
    "change", [{"width": 64}, {"height": 48}, {"fov_horizontal_rad": 1.5}, {"fov_vertical_rad": 1.2}]
)
def test_another_camera_is_refused_and_another_mount_is_not(change):
    with pytest.raises(ValueError, match="camera's"):
        DepthDetector(camera=dataclasses.replace(CameraConfig(), **change))
    DepthDetector(camera=CameraConfig(mount_height_m=0.5, mount_pitch_rad=0.05, mount_x_m=0.1))


def test_a_wrong_image_or_file_is_named(detector, tmp_path):
    with pytest.raises(ValueError, match=r"depth_m's shape is \(80, 60\), expected \(60, 80\)"):
        detector.find(np.zeros((80, 60), np.float32))
    with pytest.raises(FileNotFoundError, match="not one of those shipped \\(depth-yolo\\)"):
        DepthDetector("no-such")
    (tmp_path / "broken.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"broken\.onnx is not an ONNX file"):
        DepthDetector(tmp_path / "broken.onnx")
    with pytest.raises(ValueError, match="kind of depth-yolo is 'depth', expected 'rgb'"):
        RgbDetector("depth-yolo")
    with pytest.raises(ValueError, match="is not a detector of this project"):
        DepthDetector(WEIGHTS.parents[1] / "policy" / "weights" / "densecavoid.onnx")


def test_a_letterbox_keeps_proportions_and_boxes_come_back_to_the_image():
    rgb = np.zeros((50, 200, 3), np.uint8)
    rgb[10:20, 100:150] = 255
    image, scale, left, top = letterbox(rgb, 96, 64)
    assert image.shape == (3, 64, 96) and scale == pytest.approx(0.48) and (left, top) == (0, 20)
    assert image[:, :20].mean() == pytest.approx(127 / 255) and image[:, 45:].mean() == pytest.approx(127 / 255)
    rows, columns = np.nonzero(image[0] > 0.9)
    assert (columns.min() - left) / scale == pytest.approx(100, abs=3)
    assert (columns.max() + 1 - left) / scale == pytest.approx(150, abs=3)
    assert (rows.min() - top) / scale == pytest.approx(10, abs=3)
    assert (rows.max() + 1 - top) / scale == pytest.approx(20, abs=3)


@pytest.mark.slow
def test_darknet_weights_run_on_colour_images_at_once(tmp_path):
    pytest.importorskip("torch")
    from test_darknet import random_weights, thin

    from densecavoid.perception.detector.darknet_config import parse_config, read_config_text
    from densecavoid.perception.detector.darknet_weights import write_weights
    from densecavoid.perception.detector.export import import_darknet

    text = thin(read_config_text("yolov3-tiny"))
    (tmp_path / "net.cfg").write_text(text)
    write_weights(tmp_path / "net.weights", random_weights(parse_config(text)))
    card = import_darknet(tmp_path / "net.weights", tmp_path / "net.onnx", tmp_path / "net.cfg", (96, 64))
    assert parse_config(card.network).input == (3, 64, 96)
    detector = RgbDetector(tmp_path / "net.onnx", threshold=0.2)
    rgb = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
    found = detector.find(rgb, label=None)
    assert len(found.label) > 0 and (found.box >= 0).all()
    assert (found.box[:, 0::2] <= 160).all() and (found.box[:, 1::2] <= 120).all()
    people = detector.find(rgb)
    assert (people.label == 0).all() and len(people.label) == (found.label == 0).sum()
