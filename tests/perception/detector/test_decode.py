"""Decoding and suppression of boxes: by hand, against a slow loop, and average precision against COCO's own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.perception.detector.darknet_config import parse_config
from densecavoid.perception.detector.decode import Decoder, overlap, suppress

CONFIG = """[net]
width=32
height=16
channels=1
[convolutional]
filters=14
size=1
stride=8
activation=linear
[yolo]
anchors=4,6, 10,12
classes=2
"""


def head_with(values: dict[tuple[int, int, int, int], float]) -> np.ndarray:
    """A head whose cells find nothing but where given: (anchor, number, row, column) -> raw value."""
    raw = np.full((2, 7, 2, 4), -20.0, np.float32)
    for where, value in values.items():
        raw[where] = value
    return raw.reshape(14, 2, 4)


def test_a_box_is_where_the_formulas_of_yolov3_put_it():
    config = parse_config(CONFIG)
    assert config.heads[0][1] == (14, 2, 4)
    raw = head_with(
        {(1, 0, 1, 2): math.log(3), (1, 1, 1, 2): 0.0, (1, 2, 1, 2): math.log(0.5), (1, 3, 1, 2): 0.0}
        | {(1, 4, 1, 2): math.log(4), (1, 6, 1, 2): math.log(9)}
    )
    found = Decoder(config, 0.5, 0.45)([raw])
    # Middle (2 + 3/4) x 8 = 22 across, (1 + 1/2) x 8 = 12 down; half of 10 wide, 12 high; confidence 4/5 x 9/10.
    np.testing.assert_allclose(found.box, [[19.5, 6.0, 24.5, 18.0]], rtol=1e-5)
    np.testing.assert_allclose(found.confidence, [0.72], rtol=1e-5)
    assert found.label.tolist() == [1]


def test_a_cell_may_be_two_classes_and_classes_do_not_suppress_each_other():
    config = parse_config(CONFIG)
    raw = head_with({(0, k, 0, 0): 3.0 if k >= 4 else 0.0 for k in range(7)})
    found = Decoder(config, 0.5, 0.45)([raw])
    assert sorted(found.label.tolist()) == [0, 1]
    np.testing.assert_array_equal(found.box[0], found.box[1])


def test_values_out_of_all_bounds_give_finite_boxes():
    config = parse_config(CONFIG)
    found = Decoder(config, 0.5, 0.45)([np.full((14, 2, 4), 1e30, np.float32)])
    assert np.isfinite(found.box).all()
    assert len(Decoder(config, 0.5, 0.45)([np.full((14, 2, 4), np.nan, np.float32)]).label) == 0


def test_suppression_keeps_what_a_slow_loop_keeps():
    rng = np.random.default_rng(3)
    corner = rng.uniform(0, 60, (100, 2))
    rows = np.concatenate(
        [corner, corner + rng.uniform(4, 25, (100, 2)), rng.random((100, 1)), rng.integers(0, 2, (100, 1))], axis=1
    ).astype(np.float32)
    order = np.argsort(-rows[:, 4], kind="stable")

    def iou(a: np.ndarray, b: np.ndarray) -> float:
        grid = np.arange(0, 90, 0.25) + 0.125  # counted, not computed
        inside = [((grid > box[k]) & (grid < box[k + 2])) for box in (a, b) for k in (0, 1)]
        first, second = np.outer(inside[0], inside[1]), np.outer(inside[2], inside[3])
        return (first & second).sum() / (first | second).sum()

    kept: list[int] = []
    close = 0
    for i in order.tolist():
        shared = [iou(rows[i], rows[j]) for j in kept if rows[i, 5] == rows[j, 5]]
        close += any(abs(value - 0.4) < 0.02 for value in shared)
        if all(overlap(rows[i].astype(float), rows[j].astype(float)) <= 0.4 for j in kept if rows[i, 5] == rows[j, 5]):
            assert max(shared, default=0.0) < 0.42
            kept.append(i)
        else:
            assert max(shared) > 0.38
    found = np.empty(100, np.int64)
    assert found[: suppress(rows, order, 0.4, found)].tolist() == kept
    assert 20 < len(kept) < 90


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((0, 0, 2, 2), (1, 1, 3, 3), 1 / 7),
        ((0, 0, 2, 2), (0, 0, 2, 2), 1.0),
        ((0, 0, 2, 2), (2, 0, 4, 2), 0.0),
        ((0, 0, 4, 4), (1, 1, 2, 2), 1 / 16),
    ],
)
def test_overlap_is_intersection_over_union(a, b, expected):
    assert overlap(np.array(a, float), np.array(b, float)) == pytest.approx(expected)


@pytest.mark.parametrize("name", ["threshold", "max_overlap"])
def test_a_wrong_setting_is_named(name):
    config = parse_config(CONFIG)
    with pytest.raises(ValueError, match=name):
        Decoder(config, **({"threshold": 0.5, "max_overlap": 0.5} | {name: 1.5}))
