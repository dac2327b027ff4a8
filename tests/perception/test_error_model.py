"""The error model: what it was told to do is what comes out, and fitting finds again what it was told."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from densecavoid.frames import Command, SensorFrame
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.detections import Detections
from densecavoid.perception.error_model import QUANTILES, DetectorErrors, load_errors
from densecavoid.perception.evaluation.driving import Moment
from densecavoid.perception.evaluation.error_fit import (
    DISTANCE_M,
    VISIBLE,
    fit_errors,
    lasting_correlation,
    record_errors,
)
from densecavoid.perception.projection import camera_view
from densecavoid.perception.sources import BoxSource, TruthSource
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator

GAUSSIAN = tuple(ndtri((np.arange(QUANTILES) + 0.5) / QUANTILES).tolist())
WORLDS = 24


def table(function) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(function(f, d)) for d in DISTANCE_M) for f in VISIBLE)


def make_errors(**changes) -> DetectorErrors:
    errors = DetectorErrors(
        visible=VISIBLE,
        distance_m=DISTANCE_M,
        found=table(lambda f, d: min(0.97, 0.2 + f) - 0.04 * d),
        along_mean_m=table(lambda f, d: 0.02 * d),
        along_std_m=table(lambda f, d: 0.03 * d),
        across_std_m=table(lambda f, d: 0.05 + 0.03 * (1 - f)),
        claimed_std_m=table(lambda f, d: 0.1),
        confidence=table(lambda f, d: 0.5 + 0.4 * f),
        radius_std_m=table(lambda f, d: 0.03),
        height_std_m=table(lambda f, d: 0.08),
        along_shape=GAUSSIAN,
        across_shape=GAUSSIAN,
        lasting=(0.6, 0.7, 0.3),
        lasts_s=(0.8, 0.5, 1.5),
        ghosts_per_image=0.03,
        ghost_lasts_s=0.4,
        ghost_confidence=0.4,
    )
    return dataclasses.replace(errors, **changes)


def begin(worlds=WORLDS, seed=0) -> Simulator:
    sim = Simulator(make_scenario("dense-ped"), worlds, SimConfig(threads=1))
    sim.reset(seed + np.arange(worlds))
    return sim


def go_on(sim: Simulator) -> SensorFrame:
    sim.step(Command(np.full(sim.num_worlds, 0.2, np.float32), np.zeros(sim.num_worlds, np.float32)))
    return sim.sense()


@pytest.fixture(scope="module")
def fitted() -> DetectorErrors:
    """Fitted to what the model with `make_errors` finds."""
    sim = Simulator(make_scenario("dense-ped"), 64, SimConfig(threads=0))
    source, everybody = BoxSource(PerceptionConfig(), 64, make_errors()), np.ones(64, np.bool_)

    def find(moment: Moment) -> Detections:
        source.reset(moment.fresh)
        return source.find(moment.frame, everybody)

    found = record_errors(sim, find, camera_view(sim.config.camera), 220, 1)
    return fit_errors(found, 0.1, "itself")


def worst(first, second, least_visible=1) -> float:
    """Largest difference where people are seen well enough for there to be many."""
    return float(np.abs(np.array(first) - np.array(second))[least_visible:, 1:].max())


def test_fit_finds_again_what_the_model_was_told(fitted):
    told = make_errors()
    assert worst(fitted.found, told.found) < 0.08
    assert worst(fitted.along_mean_m, told.along_mean_m) < 0.03
    assert worst(fitted.along_std_m, told.along_std_m, 2) < 0.025
    assert worst(fitted.across_std_m, told.across_std_m, 2) < 0.015
    assert worst(fitted.claimed_std_m, told.claimed_std_m) < 0.001
    assert worst(fitted.confidence, told.confidence) < 0.04
    assert worst(fitted.height_std_m, told.height_std_m) < 0.02
    np.testing.assert_allclose(fitted.along_shape, GAUSSIAN, atol=0.2)
    assert fitted.ghosts_per_image == pytest.approx(0.027, abs=0.012)  # some stand beside people
    assert fitted.ghost_lasts_s == pytest.approx(0.4, abs=0.2)


def test_fit_finds_again_how_long_errors_last(fitted):
    told = make_errors()
    lags = np.array([0.1, 0.4, 0.8])
    for k in range(3):
        mine, theirs = (e.lasting[k] * lasting_correlation(lags / e.lasts_s[k]) for e in (fitted, told))
        np.testing.assert_allclose(mine, theirs, atol=0.1)


def test_correlation_of_the_lasting_part_against_dice():
    rng = np.random.default_rng(0)
    knots, phase = rng.standard_normal((200_000, 5)), rng.random(200_000)

    def value(at):
        k, a = np.floor(at).astype(int), at - np.floor(at)
        rows = np.arange(len(at))
        return ((1 - a) * knots[rows, k] + a * knots[rows, k + 1]) / np.sqrt((1 - a) ** 2 + a**2)

    for lag in (0.0, 0.3, 1.0, 1.7, 2.5):
        dice = np.mean(value(phase) * value(phase + lag))
        assert lasting_correlation(np.array([lag]))[0] == pytest.approx(dice, abs=0.01)


def test_same_episode_gets_the_same_errors_whatever_the_batch_and_the_threads():
    errors = make_errors()
    alone, together = begin(1, seed=5), begin(8)
    config = PerceptionConfig(threads=1)
    one, many = BoxSource(config, 1, errors), BoxSource(dataclasses.replace(config, threads=2), 8, errors)
    seen = 0
    for _ in range(15):
        first = one.find(go_on(alone), np.ones(1, np.bool_))
        second = many.find(go_on(together), np.ones(8, np.bool_))
        count = first.count[0]
        assert count == second.count[5]
        np.testing.assert_array_equal(first.pos[0, :count], second.pos[5, :count])
        seen += count
    assert seen > 10
    many.reset(np.arange(8) == 5)  # another episode begins with another first frame, and has other errors
    frame = together.sense()
    before = many.find(frame, np.ones(8, np.bool_)).pos[5].copy()
    many.reset(np.arange(8) == 5)
    np.testing.assert_array_equal(before, many.find(frame, np.ones(8, np.bool_)).pos[5])


def test_perfect_detector_is_the_truth():
    nothing, sure = table(lambda f, d: 0.0), table(lambda f, d: 1.0)
    changes = dict.fromkeys(("along_mean_m", "along_std_m", "across_std_m", "radius_std_m", "height_std_m"), nothing)
    errors = make_errors(found=sure, ghosts_per_image=0.0, **changes)
    sim, everybody = begin(4), np.ones(4, np.bool_)
    exact, boxes = TruthSource(PerceptionConfig(), 4), BoxSource(PerceptionConfig(), 4, errors)
    people = bodies = 0
    for _ in range(10):
        frame = go_on(sim)
        truth, found = exact.find(frame, everybody), boxes.find(frame, everybody)
        for b in range(4):
            places = found.pos[b, : found.count[b]]  # who is hardly seen is in `found` alone
            for d in range(truth.count[b]):
                near = np.hypot(*(places - truth.pos[b, d]).T)
                assert near.min() < 1e-9
                body = found.body[b, near.argmin()]
                told = np.isfinite(body)  # what the image cuts is not
                np.testing.assert_allclose(body[told], truth.body[b, d][told], atol=1e-6)
                people += 1
                bodies += told.sum()
    assert people > 20 and bodies > 20


def test_errors_survive_the_file(tmp_path):
    errors = make_errors()
    errors.save(tmp_path / "errors.json")
    assert load_errors(tmp_path / "errors.json") == errors


def test_wrong_files_and_values_are_named(tmp_path):
    (tmp_path / "other.json").write_text('{"visible": [0.1, 0.2], "weight": 3}')
    with pytest.raises(ValueError, match=r"other\.json.*weight"):
        load_errors(tmp_path / "other.json")
    with pytest.raises(ValueError, match=r"DetectorErrors\.found"):
        make_errors(found=table(lambda f, d: 2.0))
    with pytest.raises(ValueError, match=r"DetectorErrors\.along_std_m"):
        make_errors(along_std_m=((math.nan,) * 6,) * 5)
    with pytest.raises(ValueError, match="ghosts_per_image"):
        make_errors(ghosts_per_image=1.5)


def test_dice_of_misses_match_their_chance():
    """The Gaussian behind misses is standard, so that the chance is the table's."""
    share = ndtr(np.array(GAUSSIAN)).mean()
    assert share == pytest.approx(0.5)
    errors = make_errors(found=table(lambda f, d: 0.7), ghosts_per_image=0.0)
    sim, everybody = begin(WORLDS), np.ones(WORLDS, np.bool_)
    boxes = BoxSource(PerceptionConfig(), WORLDS, errors)
    sure = BoxSource(PerceptionConfig(), WORLDS, make_errors(found=table(lambda f, d: 1.0), ghosts_per_image=0.0))
    there = found = 0
    for _ in range(80):
        frame = go_on(sim)
        found += boxes.find(frame, everybody).count.sum()
        there += sure.find(frame, everybody).count.sum()
    assert there > 3000 and found / there == pytest.approx(0.7, abs=0.05)
