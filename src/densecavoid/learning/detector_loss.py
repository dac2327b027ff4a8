"""YOLOv3's loss (Redmon, Farhadi 2018), with people of whom too little is seen left out."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from densecavoid.perception.detector.darknet_config import DarknetConfig

IGNORE_OVERLAP = 0.7
"""A cell that should find nobody, but whose box overlaps a true one by more, is not blamed."""
IGNORE_OVERLAP_HIDDEN = 0.5
"""The same for people who need not be found."""


class LossTerms(NamedTuple):
    """Means over the images of a batch."""

    box: Tensor
    objectness: Tensor
    label: Tensor

    @property
    def total(self) -> Tensor:
        return self.box + self.objectness + self.label


def overlaps(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union [..., N, M] of boxes [..., N, 4] and [..., M, 4] given by their corners."""
    low = torch.maximum(a[..., :, None, :2], b[..., None, :, :2])
    high = torch.minimum(a[..., :, None, 2:], b[..., None, :, 2:])
    both = (high - low).clamp(min=0).prod(-1)
    size_a, size_b = (a[..., 2:] - a[..., :2]).prod(-1), (b[..., 2:] - b[..., :2]).prod(-1)
    return both / (size_a[..., :, None] + size_b[..., None, :] - both).clamp(min=1e-9)


class YoloLoss:
    """Loss of a network's raw heads against true boxes."""

    def __init__(self, config: DarknetConfig) -> None:
        self._size = torch.tensor([config.input.width, config.input.height], dtype=torch.float32)
        self._heads = config.heads
        self._anchors = torch.tensor([anchor for head, _ in config.heads for anchor in head.anchors])

    def __call__(self, heads: list[Tensor], boxes: Tensor, wanted: Tensor, present: Tensor) -> LossTerms:
        """Loss of a batch.

        Args:
            heads: raw outputs of each head.
            boxes: [B, L, 4] corners in pixels of the network's input.
            wanted: bool [B, L] people to find.
            present: bool [B, L] these and others, whom it is no fault to find. All of class 0.
        """
        batch = len(boxes)
        targets = self._targets(boxes, wanted)
        losses = [torch.zeros((), device=boxes.device) for _ in range(3)]
        first = 0
        for raw, (head, shape) in zip(heads, self._heads, strict=True):
            anchors = self._anchors[first : first + len(head.anchors)]
            raw = raw.float().view(batch, len(anchors), 5 + head.classes, shape.height, shape.width)
            raw = raw.permute(0, 1, 3, 4, 2)
            excused = self._excused(raw.detach(), anchors, boxes, wanted, present)
            here = (targets.anchor >= first) & (targets.anchor < first + len(anchors))
            image, anchor = targets.image[here], targets.anchor[here] - first
            scale = torch.tensor([shape.width, shape.height]) / self._size
            centre, size = targets.centre[here] * scale, targets.size[here]
            cell = centre.floor().long()
            cell = torch.minimum(cell.clamp(min=0), torch.tensor([shape.width - 1, shape.height - 1]))
            found = raw[image, anchor, cell[:, 1], cell[:, 0]]

            weight = (2.0 - (size / self._size).prod(-1))[:, None]
            place = functional.binary_cross_entropy_with_logits(found[:, :2], centre - cell, weight, reduction="sum")
            extent = (weight * (found[:, 2:4] - (size / anchors[anchor]).log()) ** 2).sum()
            losses[0] = losses[0] + place + extent

            truth = torch.zeros_like(raw[..., 4])
            truth[image, anchor, cell[:, 1], cell[:, 0]] = 1.0
            blame = ((truth > 0) | ~excused).float()
            losses[1] = losses[1] + functional.binary_cross_entropy_with_logits(
                raw[..., 4], truth, blame, reduction="sum"
            )
            labels = torch.zeros_like(found[:, 5:])
            labels[:, 0] = 1.0
            losses[2] = losses[2] + functional.binary_cross_entropy_with_logits(found[:, 5:], labels, reduction="sum")
            first += len(anchors)
        return LossTerms(*(loss / batch for loss in losses))

    def _targets(self, boxes: Tensor, wanted: Tensor) -> _Targets:
        """People to find; the anchor of the most similar shape, of all heads, is responsible."""
        image, slot = wanted.nonzero(as_tuple=True)
        box = boxes[image, slot]
        centre, size = (box[:, :2] + box[:, 2:]) / 2, (box[:, 2:] - box[:, :2]).clamp(min=1.0)
        both = torch.minimum(size[:, None], self._anchors[None]).prod(-1)
        shape_overlap = both / (size.prod(-1)[:, None] + self._anchors.prod(-1)[None] - both)
        return _Targets(image, centre, size, shape_overlap.argmax(1))

    def _excused(self, raw: Tensor, anchors: Tensor, boxes: Tensor, wanted: Tensor, present: Tensor) -> Tensor:
        """bool [B, anchors, rows, columns]: boxes near enough to a person."""
        batch, _, rows, columns, _ = raw.shape
        step = self._size / torch.tensor([columns, rows])
        across, down = torch.meshgrid(torch.arange(columns), torch.arange(rows), indexing="xy")
        centre = (torch.stack([across, down], -1) + raw[..., :2].sigmoid()) * step
        half = 0.5 * anchors[:, None, None] * raw[..., 2:4].clamp(max=6.0).exp()
        corners = torch.cat([centre - half, centre + half], -1).view(batch, -1, 4)
        shared = overlaps(corners, boxes)
        near = (shared > IGNORE_OVERLAP) & wanted[:, None]
        near |= (shared > IGNORE_OVERLAP_HIDDEN) & (present & ~wanted)[:, None]
        return near.any(-1).view(raw.shape[:-1])


class _Targets(NamedTuple):
    image: Tensor  # [T] number of the image in the batch
    centre: Tensor  # [T, 2] px of the network's input
    size: Tensor  # [T, 2]
    anchor: Tensor  # [T] number among the anchors of all heads
