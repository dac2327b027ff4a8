"""Average precision: a case counted by hand, and COCO's own on random boxes with people who need not be found."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest

from densecavoid.perception.evaluation.average_precision import EXCUSED, FALSE, MATCHED, match, precision_recall

Image = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def matched(found: np.ndarray, truth: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kind, partner = np.zeros(len(found), np.int64), np.zeros(len(found), np.int64)
    match(found.astype(np.float32), truth.astype(np.float32), wanted, 0.5, kind, partner)
    return kind, partner


def test_the_surest_box_takes_a_person_and_only_one_box_does():
    truth = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [40, 0, 50, 10]])
    found = np.array([[0, 0, 10, 9], [0, 0, 10, 10], [20, 0, 30, 8], [40, 0, 50, 10], [60, 0, 70, 10]])
    kind, partner = matched(found, truth, np.array([True, True, False]))
    assert kind.tolist() == [MATCHED, FALSE, MATCHED, EXCUSED, FALSE]
    assert partner.tolist() == [0, -1, 1, 2, -1]


def test_average_precision_of_a_case_counted_by_hand():
    # Hits and misses, surest first: hit, miss, hit, (excused), miss; three people to find. Recall reaches 1/3 with
    # precision 1, 2/3 with 2/3: of the 101 recalls 0 ... 1, 34 (0 to .33) see 1, 33 (.34 to .66) see 2/3, the rest 0.
    kind = np.array([MATCHED, FALSE, MATCHED, EXCUSED, FALSE])
    result = precision_recall(np.array([0.9, 0.8, 0.7, 0.6, 0.5]), kind, 3)
    assert result.average_precision == pytest.approx((34 + 33 * 2 / 3) / 101)
    np.testing.assert_allclose(result.recall, [1 / 3, 1 / 3, 2 / 3, 2 / 3])
    np.testing.assert_allclose(result.precision, [1, 1 / 2, 2 / 3, 1 / 2])


def test_nobody_found_is_zero_and_nobody_to_find_is_not_a_number():
    nothing = np.zeros(0)
    assert precision_recall(nothing, nothing.astype(int), 5).average_precision == 0.0
    assert np.isnan(precision_recall(np.array([0.5]), np.array([FALSE]), 0).average_precision)


def random_images(seed: int) -> list[Image]:
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(40):
        corner = rng.uniform(0, 60, (rng.integers(0, 6), 2))
        truth = np.concatenate([corner, corner + rng.uniform(5, 20, corner.shape)], axis=1)
        copies = np.repeat(truth, rng.integers(0, 3, len(truth)), axis=0)
        noise = rng.uniform(0, 60, (rng.integers(0, 4), 2))
        stray = np.concatenate([noise, noise + rng.uniform(5, 20, noise.shape)], axis=1)
        found = np.concatenate([copies + rng.normal(0, 1.5, copies.shape), stray])
        confidence = np.sort(rng.random(len(found)))[::-1]
        images.append((truth, rng.random(len(truth)) < 0.7, found[rng.permutation(len(found))], confidence))
    return images


def coco_average_precision(images: list[Image]) -> float:
    coco = pytest.importorskip("pycocotools.coco")
    from pycocotools.cocoeval import COCOeval

    def row(box: np.ndarray, image: int, number: int) -> dict:
        u, v, width, height = *box[:2].tolist(), *(box[2:] - box[:2]).tolist()
        return {
            "id": number,
            "image_id": image,
            "category_id": 1,
            "bbox": [u, v, width, height],
            "area": width * height,
        }

    truths, results = [], []
    for n, (truth, wanted, found, confidence) in enumerate(images):
        for box, want in zip(truth, wanted.tolist(), strict=True):
            # COCO leaves out what its area range excludes; areas here are far below 1e4.
            area = 1.0 if want else 1e9
            truths.append(row(box, n, len(truths) + 1) | {"area": area, "iscrowd": 0})
        results += [row(b, n, 0) | {"score": float(c)} for b, c in zip(found, confidence, strict=True)]
    with contextlib.redirect_stdout(io.StringIO()):
        data = coco.COCO()
        data.dataset = {
            "info": {},
            "images": [{"id": n} for n in range(len(images))],
            "categories": [{"id": 1}],
            "annotations": truths,
        }
        data.createIndex()
        evaluation = COCOeval(data, data.loadRes(results), "bbox")
        evaluation.params.iouThrs = np.array([0.5])
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e4]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    return float(evaluation.eval["precision"][0, :, 0, 0, -1].mean())


@pytest.mark.parametrize("seed", range(3))
def test_average_precision_is_cocos(seed):
    images = random_images(seed)
    kinds = [matched(found, truth, wanted)[0] for truth, wanted, found, _ in images]
    confidence = np.concatenate([c for *_, c in images])
    result = precision_recall(confidence, np.concatenate(kinds), sum(int(wanted.sum()) for _, wanted, _, _ in images))
    assert 0.2 < result.average_precision < 0.95
    assert result.average_precision == pytest.approx(coco_average_precision(images), abs=1e-6)
