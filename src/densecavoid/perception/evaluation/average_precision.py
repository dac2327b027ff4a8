"""Average precision of boxes, as COCO counts it: greedy matching, truths that may be missed, precision's envelope."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from densecavoid.perception.detector.decode import overlap
from densecavoid.sim._jit import kernel

MATCHED, FALSE, EXCUSED = 1, 0, -1
"""What a found box is: a person to find; nobody; somebody who need not be found."""
_RECALLS = np.linspace(0.0, 1.0, 101)
"""At which COCO reads precision."""


@kernel
def match(found, truth, wanted, least_overlap, kind, partner):
    """Pairs found boxes [N, 4], surest first, with true ones [M, 4]; each takes the free one it overlaps most.

    Those to find come first, and only who matches none of them may match one who need not be found (COCO, evaluateImg).

    Args:
        wanted: bool [M] who is to be found; the others are neither missed nor false alarms.
        kind: [N] gets `MATCHED`, `FALSE` or `EXCUSED`.
        partner: [N] gets the number of the true box, -1 for none.
    """
    taken = np.zeros(len(truth), np.bool_)
    for i in range(len(found)):
        partner[i], kind[i] = -1, FALSE
        for turn in range(2):
            best = least_overlap
            for j in range(len(truth)):
                if taken[j] or wanted[j] != (turn == 0):
                    continue
                shared = overlap(found[i], truth[j])
                if shared >= best:
                    best, partner[i] = shared, j
            if partner[i] >= 0:
                taken[partner[i]] = True
                kind[i] = MATCHED if turn == 0 else EXCUSED
                break


class PrecisionRecall(NamedTuple):
    """Over all images; found boxes surest first, those excused left out."""

    precision: np.ndarray
    recall: np.ndarray
    confidence: np.ndarray

    @property
    def average_precision(self) -> float:
        """Mean of the best precision at each of 101 recalls or beyond (COCO); NaN where there was nobody to find."""
        if np.isnan(self.recall).any():
            return float("nan")
        envelope = np.maximum.accumulate(self.precision[::-1])[::-1]
        at = np.searchsorted(self.recall, _RECALLS, side="left")
        return float(np.append(envelope, 0.0)[at].mean())


def precision_recall(confidence: np.ndarray, kind: np.ndarray, num_wanted: int) -> PrecisionRecall:
    """Precision and recall as the threshold falls.

    Args:
        confidence: [N] of all found boxes of all images.
        kind: [N] what each of them is (`MATCHED`, ...).
        num_wanted: people to find in all images.
    """
    counted = kind != EXCUSED
    order = np.argsort(-confidence[counted], kind="stable")
    hit = (kind[counted] == MATCHED)[order]
    hits = np.cumsum(hit)
    total = np.arange(1, len(hit) + 1)
    recall = hits / num_wanted if num_wanted else np.full(len(hit), np.nan)
    return PrecisionRecall(hits / total, recall, confidence[counted][order])
