"""From raw heads to boxes, and the suppression of double ones; the same for every network. No torch, no runtime."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from densecavoid.frames import require
from densecavoid.perception.detector.darknet_config import DarknetConfig
from densecavoid.sim._jit import kernel

_MOST_CANDIDATES = 2048
_LARGEST_LOGIT = 30.0


class Boxes(NamedTuple):
    """Boxes found in one image, the surest first."""

    box: Float32[np.ndarray, "N 4"]
    """u_min, v_min, u_max, v_max in pixels; a pixel's centre is at +.5."""
    confidence: Float32[np.ndarray, "N"]
    """Objectness times the class's probability, in [0, 1]."""
    label: Int32[np.ndarray, "N"]
    """Number of the class."""


@kernel
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


@kernel
def decode_head(raw, anchors, net_width, net_height, threshold, out, count):
    """Adds one head's boxes to `out` rows (u_min, v_min, u_max, v_max, confidence, class) from row `count` on.

    YOLOv3 (Redmon, Farhadi 2018): bx = (column + sigmoid(tx)) / columns, bw = anchor exp(tw); confidence = sigmoid(to)
    sigmoid(class). One row for each class whose confidence is above the threshold.

    Args:
        raw: f32 [anchors x (5 + classes), rows, columns].
        anchors: f32 [anchors, 2] width and height in pixels of the network's input.

    Returns:
        The number of rows then; what does not fit in `out` is left out.
    """
    num_anchors = anchors.shape[0]
    per_anchor = raw.shape[0] // num_anchors
    rows, columns = raw.shape[1], raw.shape[2]
    step_x, step_y = net_width / columns, net_height / rows
    # Nothing can be above the threshold whose objectness is not: most cells end here, without an exponential.
    least_logit = math.log(threshold / (1.0 - threshold))
    for a in range(num_anchors):
        first = a * per_anchor
        for r in range(rows):
            for c in range(columns):
                if not raw[first + 4, r, c] > least_logit:
                    continue
                objectness = _sigmoid(raw[first + 4, r, c])
                for k in range(per_anchor - 5):
                    confidence = objectness * _sigmoid(raw[first + 5 + k, r, c])
                    if confidence <= threshold or count == out.shape[0]:
                        continue
                    u = (c + _sigmoid(raw[first, r, c])) * step_x
                    v = (r + _sigmoid(raw[first + 1, r, c])) * step_y
                    half_width = 0.5 * anchors[a, 0] * math.exp(min(raw[first + 2, r, c], _LARGEST_LOGIT))
                    half_height = 0.5 * anchors[a, 1] * math.exp(min(raw[first + 3, r, c], _LARGEST_LOGIT))
                    out[count, 0], out[count, 1] = u - half_width, v - half_height
                    out[count, 2], out[count, 3] = u + half_width, v + half_height
                    out[count, 4], out[count, 5] = confidence, k
                    count += 1
    return count


@kernel
def overlap(a, b):
    """Intersection over union of two boxes (u_min, v_min, u_max, v_max); 0 for empty ones."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0.0 or height <= 0.0:
        return 0.0
    both = width * height
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


@kernel
def suppress(rows, order, max_overlap, kept):
    """Greedy non-maximum suppression in each class: fills `kept` with numbers of rows, surest first.

    Args:
        rows: [N, 6] as `decode_head` writes them.
        order: [N] numbers of the rows, surest first.
        max_overlap: a box that overlaps a surer one of its class by more goes.

    Returns:
        How many were kept.
    """
    count = 0
    for i in order:
        free = True
        for j in kept[:count]:
            free = free and not (rows[i, 5] == rows[j, 5] and overlap(rows[i], rows[j]) > max_overlap)
        if free:
            kept[count] = i
            count += 1
    return count


class Decoder:
    """Turns the raw heads of one network into boxes."""

    def __init__(self, config: DarknetConfig, threshold: float, max_overlap: float) -> None:
        """Args: the network; the least confidence; what `suppress` lets overlap."""
        require(0.0 < threshold < 1.0, "threshold", threshold, "in (0, 1)")
        require(0.0 <= max_overlap <= 1.0, "max_overlap", max_overlap, "in [0, 1]")
        self._width, self._height = float(config.input.width), float(config.input.height)
        self._anchors = [np.array(head.anchors, np.float32) for head, _ in config.heads]
        self.threshold, self.max_overlap = threshold, max_overlap
        self._rows = np.empty((_MOST_CANDIDATES, 6), np.float32)
        self._kept = np.empty(_MOST_CANDIDATES, np.int64)

    def __call__(self, heads: Sequence[Float32[np.ndarray, "channels rows columns"]]) -> Boxes:
        """Boxes in pixels of the network's input."""
        count = 0
        for raw, anchors in zip(heads, self._anchors, strict=True):
            count = decode_head(raw, anchors, self._width, self._height, self.threshold, self._rows, count)
        order = np.argsort(-self._rows[:count, 4], kind="stable")
        kept = self._kept[: suppress(self._rows, order, self.max_overlap, self._kept)]
        rows = self._rows[kept]
        return Boxes(rows[:, :4].copy(), rows[:, 4].copy(), rows[:, 5].astype(np.int32))
