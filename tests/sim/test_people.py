"""Bodies and gait against measured people (FACTS, Crowds), and avoidance that works both ways."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.frames import RobotConfig
from densecavoid.sim.crowds.anticipation import anticipation_force
from densecavoid.sim.people import (
    HEAD,
    LEFT_ARM,
    LEFT_LEG,
    LEFT_TRUNK,
    PARTS,
    RIGHT_ARM,
    RIGHT_LEG,
    RIGHT_TRUNK,
    advance_gait,
    half_depth,
    place_body,
    remove_body,
    sample_bodies,
    step_length,
)


@pytest.mark.parametrize(
    ("speed", "length", "frequency"), [(0.5, 0.40, 1.29), (0.9, 0.56, 1.60), (1.3, 0.73, 1.79), (1.75, 0.85, 2.00)]
)
def test_gait_steps_as_measured(speed, length, frequency):
    assert step_length(speed) == pytest.approx(length, rel=0.05)
    strides = 2 * math.pi / (advance_gait(0.0, speed, 0.01) / 0.01)  # seconds a stride of two steps
    assert 2 / strides == pytest.approx(frequency, rel=0.05)


def body(phase: float, speed: float = 1.3, radius: float = 0.25, height: float = 1.75, heading: float = 0.0):
    """Cylinders of somebody at (1, 2), turned back to look along x from the origin."""
    parts = np.zeros((PARTS, 5), np.float32)
    place_body(parts, 1.0, 2.0, heading, speed, phase, radius, height)
    cos, sin = math.cos(heading), math.sin(heading)
    turned = parts.astype(float)
    turned[:, :2] = (parts[:, :2] - (1.0, 2.0)) @ np.array([[cos, -sin], [sin, cos]])
    return turned


WHOLE_STRIDE = np.linspace(0, 2 * math.pi, 48, endpoint=False)
OUTLINED = [LEFT_TRUNK, RIGHT_TRUNK, LEFT_ARM, RIGHT_ARM, HEAD]


def reach(parts: np.ndarray, axis: int) -> float:
    """How far the cylinders come from the body's middle, ahead (axis 0) or sideways (1)."""
    return float((np.abs(parts[:, axis]) + parts[:, 2]).max())


@pytest.mark.parametrize("radius", [0.19, 0.255, 0.33])
@pytest.mark.parametrize("speed", [0.0, 0.6, 1.3, 2.2])
def test_trunk_and_arms_fill_the_outline_and_stay_inside(radius, speed):
    """The outline is everything within half the depth of a line across the heading; discs, compared by hand."""
    depth, width = half_depth(radius), 0.0
    for phase in WHOLE_STRIDE:
        parts = body(phase, speed, radius)[OUTLINED]
        off_line = np.hypot(parts[:, 0], np.maximum(np.abs(parts[:, 1]) - (radius - depth), 0.0))
        assert (off_line + parts[:, 2] <= depth + 1e-6).all()
        assert reach(parts, 0) == pytest.approx(depth, abs=1e-6)
        assert reach(parts, 1) >= 0.9 * radius  # a swinging arm follows the rounded side
        width = max(width, reach(parts, 1))
    assert width == pytest.approx(radius, abs=1e-6)
    assert radius > 1.7 * depth  # shoulders are wider than deep


def test_a_body_turns_with_its_heading_and_stands_at_its_place():
    for heading in (0.7, 2.9, -1.8):
        np.testing.assert_allclose(body(0.9, heading=heading), body(0.9), atol=1e-6)
    parts = body(0.9)
    for left, right in ((LEFT_LEG, RIGHT_LEG), (LEFT_TRUNK, RIGHT_TRUNK), (LEFT_ARM, RIGHT_ARM)):
        assert parts[left, 1] > 0 > parts[right, 1]
        np.testing.assert_allclose(parts[left, :2], -parts[right, :2], atol=1e-6)


def test_legs_step_in_turn_and_arms_against_them():
    """Shins come ahead of the trunk's outline: a step is .73 m long at 1.3 m/s, a body half of that deep."""
    farthest = 0.0
    for phase in WHOLE_STRIDE:
        parts = body(phase)
        assert parts[LEFT_LEG, 0] == pytest.approx(-parts[RIGHT_LEG, 0])
        assert parts[LEFT_LEG, 0] * parts[LEFT_ARM, 0] <= 0
        farthest = max(farthest, reach(parts[[LEFT_LEG, RIGHT_LEG]], 0))
        assert np.hypot(*(parts[LEFT_LEG, :2] - parts[RIGHT_LEG, :2])) > 2 * parts[LEFT_LEG, 2]  # never in each other
    assert half_depth(0.25) < farthest < 0.73 / 2


@pytest.mark.parametrize("phase", [0.0, 1.0, 4.0])
def test_who_stands_has_both_legs_side_by_side_under_the_trunk(phase):
    parts = body(phase, speed=0.0)
    np.testing.assert_allclose(parts[[LEFT_LEG, RIGHT_LEG], 0], 0.0, atol=1e-6)
    assert reach(parts[[LEFT_LEG, RIGHT_LEG]], 1) < 0.25
    assert 0.2 < parts[LEFT_LEG, 1] - parts[RIGHT_LEG, 1] < 0.26


@pytest.mark.parametrize("height", [1.45, 1.71, 1.98])
def test_heights_are_those_of_people_and_leave_no_gap(height):
    """Shoulders at .82 of the height, hands at .38 to .49, legs up to .41 or more (Drillis, Contini 1966)."""
    parts = body(1.0, height=height)
    bottom, top = parts[:, 3], parts[:, 4]
    assert top[HEAD] == pytest.approx(height)
    np.testing.assert_allclose(top[LEFT_TRUNK : RIGHT_ARM + 1], 0.82 * height, rtol=1e-6)
    assert bottom[HEAD] == top[LEFT_TRUNK] and bottom[LEFT_TRUNK] == top[LEFT_LEG]
    np.testing.assert_array_equal(bottom[[LEFT_LEG, RIGHT_LEG]], 0.0)
    assert ((bottom[[LEFT_ARM, RIGHT_ARM]] >= 0.37 * height) & (bottom[[LEFT_ARM, RIGHT_ARM]] <= 0.49 * height)).all()
    assert (bottom[OUTLINED[:-1]] < RobotConfig().height_m).all()  # nobody is hollow to a robot


def test_who_left_has_no_body():
    parts = np.ones((PARTS, 5), np.float32)
    remove_body(parts)
    assert (parts[:, 2] == 0).all()


def test_bodies_are_drawn_from_the_measured_distribution():
    radius, height = sample_bodies(np.random.default_rng(0), 20_000)
    assert radius.mean() == pytest.approx(0.255, abs=0.003) and radius.std() == pytest.approx(0.035, abs=0.004)
    assert height.mean() == pytest.approx(1.71, abs=0.003) and height.std() == pytest.approx(0.09, abs=0.004)
    assert height.min() >= 1.45 and height.max() <= 1.98
    assert radius.min() >= 0.19 and radius.max() <= 0.33
    for values in (radius, height):  # few are at the bounds: they cut tails, not people
        assert np.isin(values, [values.min(), values.max()]).mean() < 0.06


def test_the_same_people_as_ever_are_drawn_from_a_seed():
    """Two normal draws, radii first: worlds of a seed stay the same."""
    radius, height = sample_bodies(np.random.default_rng(7), 3)
    rng = np.random.default_rng(7)
    np.testing.assert_array_equal(radius, np.clip(0.255 + 0.035 * rng.standard_normal(3), 0.19, 0.33))
    np.testing.assert_array_equal(height, np.clip(1.71 + 0.09 * rng.standard_normal(3), 1.45, 1.98))


def test_anticipation_is_the_gradient_of_the_power_law():
    """Against a numerical gradient of E(tau) = k tau^-2 exp(-tau/tau0) over the person's own place."""

    def energy(x, y):
        v = np.array([1.2, 0.1])
        offset = np.array([3.0 - x, 0.2 - y])
        a, b, c = v @ v, offset @ v, offset @ offset - 0.6**2
        tau = (b - math.sqrt(b * b - a * c)) / a
        return 1.5 / tau**2 * math.exp(-tau / 3.0)

    h = 1e-5
    gradient = [(energy(h, 0) - energy(-h, 0)) / (2 * h), (energy(0, h) - energy(0, -h)) / (2 * h)]
    force = anticipation_force(3.0, 0.2, 1.2, 0.1, 0.6)
    np.testing.assert_allclose(force, -np.array(gradient), rtol=1e-4, atol=1e-8)


def test_no_force_when_paths_part():
    assert anticipation_force(3.0, 0.0, -1.0, 0.0, 0.5) == (0.0, 0.0)
    assert anticipation_force(3.0, 2.0, 1.0, 0.0, 0.5) == (0.0, 0.0)
