"""Bodies and gait against measured people (FACTS, Crowds), and avoidance that works both ways."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.sim.crowds.anticipation import anticipation_force
from densecavoid.sim.people import PARTS, advance_gait, place_body, sample_bodies, step_length


@pytest.mark.parametrize(
    ("speed", "length", "frequency"), [(0.5, 0.40, 1.29), (0.9, 0.56, 1.60), (1.3, 0.73, 1.79), (1.75, 0.85, 2.00)]
)
def test_gait_steps_as_measured(speed, length, frequency):
    assert step_length(speed) == pytest.approx(length, rel=0.05)
    strides = 2 * math.pi / (advance_gait(0.0, speed, 0.01) / 0.01)  # seconds a stride of two steps
    assert 2 / strides == pytest.approx(frequency, rel=0.05)


def test_legs_stay_inside_the_bodys_outline_and_swing_against_each_other():
    parts = np.zeros((PARTS, 5), np.float32)
    apart = []
    for phase in np.linspace(0, 2 * math.pi, 50):
        place_body(parts, 1.0, 2.0, 0.7, 1.3, phase, 0.25, 1.75)
        for leg in range(2):
            reach = math.hypot(parts[leg, 0] - 1.0, parts[leg, 1] - 2.0) + parts[leg, 2]
            assert reach <= 0.25 + 1e-5
        apart.append(math.hypot(*(parts[0, :2] - parts[1, :2])))
        assert parts[2, 2] == pytest.approx(0.25)
        assert parts[3, 4] == pytest.approx(1.75)
    assert np.median(apart) == pytest.approx(0.288, rel=0.15)  # legs of real people, seen by a shin-high lidar


def test_bodies_are_drawn_from_the_measured_distribution():
    radius, height = sample_bodies(np.random.default_rng(0), 20_000)
    assert radius.mean() == pytest.approx(0.255, abs=0.003) and radius.std() == pytest.approx(0.035, abs=0.004)
    assert height.min() >= 1.45 and height.max() <= 1.98


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
