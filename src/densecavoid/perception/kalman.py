"""A constant-velocity Kalman filter in the plane: x and y are independent and share one 2 x 2 covariance.

And two of them as one: an interacting multiple model (Blom and Bar-Shalom, IEEE Trans. Automatic Control 33, 1988) of a
person who walks on and of one who turns, starts or stops.
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel


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


@inner
def _merge(one, other, weight, out):
    """One Gaussian with the mean and the covariance of a mixture of two, of which `one` has the `weight`.

    Args:
        one, other, out: state and covariance in a row; `out` may be one of the two.
    """
    less = 1.0 - weight
    spread = 0.5 * weight * less
    pos_x, pos_y, vel_x, vel_y = one[0] - other[0], one[1] - other[1], one[2] - other[2], one[3] - other[3]
    for k in range(7):
        out[k] = weight * one[k] + less * other[k]
    out[4] += spread * (pos_x * pos_x + pos_y * pos_y)
    out[5] += spread * (pos_x * vel_x + pos_y * vel_y)
    out[6] += spread * (vel_x * vel_x + vel_y * vel_y)


@inner
def _tell(modes, state, covariance):
    """What both models say together."""
    _merge(modes[0], modes[1], modes[0, 7], modes[2])
    for k in range(4):
        state[k] = modes[2, k]
    for k in range(3):
        covariance[k] = modes[2, 4 + k]


@inner
def imm_begin(modes, state, covariance, turning):
    """Both models as one Gaussian says; `turning` is the chance of the second.

    Args:
        modes: f64 [3, 8], written, for who walks on and for who turns: state, covariance, chance. The third is room to
            work.
        state, covariance: as in `kalman_predict`.
    """
    for i in range(2):
        for k in range(4):
            modes[i, k] = state[k]
        for k in range(3):
            modes[i, 4 + k] = covariance[k]
    modes[0, 7], modes[1, 7] = 1.0 - turning, turning


@inner
def imm_predict(modes, state, covariance, dt, manner):
    """Moves both models on by `dt` s, in place, and writes what they say together into `state` and `covariance`.

    Args:
        manner: has `steady_std` and `turning_std` (m/s2), acceleration of who walks on and of who turns, and
            `turns_per_s` and `steadies_per_s`, how often people begin to turn and how soon they are done.
    """
    turn, steady = 1.0 - math.exp(-manner.turns_per_s * dt), 1.0 - math.exp(-manner.steadies_per_s * dt)
    goes_on, calms = modes[0, 7] * (1.0 - turn), modes[1, 7] * steady
    chance = goes_on + calms
    begins = modes[0, 7] * turn / (1.0 - chance)
    _merge(modes[0], modes[1], goes_on / chance, modes[2])
    _merge(modes[0], modes[1], begins, modes[1])
    for k in range(7):
        modes[0, k] = modes[2, k]
    kalman_predict(modes[0, :4], modes[0, 4:7], dt, manner.steady_std)
    kalman_predict(modes[1, :4], modes[1, 4:7], dt, manner.turning_std)
    modes[0, 7], modes[1, 7] = chance, 1.0 - chance
    _tell(modes, state, covariance)


@inner
def imm_correct(modes, state, covariance, x, y, std_m):
    """Takes in a measured position, in place, as `kalman_correct`."""
    odds = math.log(modes[0, 7] / modes[1, 7])
    for i in range(2):
        variance = modes[i, 4] + std_m * std_m
        off_x, off_y = x - modes[i, 0], y - modes[i, 1]
        fit = -math.log(variance) - 0.5 * (off_x * off_x + off_y * off_y) / variance
        odds += fit if i == 0 else -fit
        kalman_correct(modes[i, :4], modes[i, 4:7], x, y, std_m)
    odds = min(max(odds, -30.0), 30.0)
    modes[0, 7] = 1.0 / (1.0 + math.exp(-odds))
    modes[1, 7] = 1.0 - modes[0, 7]
    _tell(modes, state, covariance)
