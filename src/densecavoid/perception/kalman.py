"""A constant-velocity Kalman filter in the plane: x and y are independent and share one 2 x 2 covariance."""

from __future__ import annotations

from densecavoid.sim._jit import kernel


@kernel
def kalman_predict(state, covariance, dt, acceleration_std):
    """Moves on by `dt` s with white acceleration noise (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.3), in place.

    Args:
        state: x, y, vx, vy.
        covariance: of position, of position and velocity, of velocity.
        acceleration_std: m/s2, of an acceleration that is constant within a step.
    """
    q = acceleration_std * acceleration_std
    state[0] += state[2] * dt
    state[1] += state[3] * dt
    covariance[0] += 2.0 * dt * covariance[1] + dt * dt * covariance[2] + q * dt**4 / 4.0
    covariance[1] += dt * covariance[2] + q * dt**3 / 2.0
    covariance[2] += q * dt * dt


@kernel
def kalman_correct(state, covariance, x, y, std_m):
    """Takes in a measured position whose x and y have the standard deviation `std_m`, in place."""
    innovation = covariance[0] + std_m * std_m
    gain_pos, gain_vel = covariance[0] / innovation, covariance[1] / innovation
    miss_x, miss_y = x - state[0], y - state[1]
    state[0] += gain_pos * miss_x
    state[1] += gain_pos * miss_y
    state[2] += gain_vel * miss_x
    state[3] += gain_vel * miss_y
    covariance[2] -= gain_vel * covariance[1]
    covariance[1] *= 1.0 - gain_pos
    covariance[0] *= 1.0 - gain_pos
