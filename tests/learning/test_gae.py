"""Promises of generalised advantage estimation."""

from __future__ import annotations

import warnings

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from densecavoid.learning.gae import estimate_advantages  # noqa: E402


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64).unsqueeze(1)


def flags(*values: int) -> Tensor:
    return torch.tensor(values, dtype=torch.bool).unsqueeze(1)


def test_three_steps_agree_with_values_computed_by_hand() -> None:
    # gamma = .5, lambda = .5. delta_t = r + .5 v' - v:
    # delta_2 = 3 + .5 * 8 - 4 = 3            A_2 = 3
    # delta_1 = 2 + .5 * 4 - 2 = 2            A_1 = 2 + .25 * 3 = 2.75
    # delta_0 = 1 + .5 * 2 - 1 = 1            A_0 = 1 + .25 * 2.75 = 1.6875
    advantages, returns = estimate_advantages(
        column(1, 2, 3), column(1, 2, 4), column(2, 4, 8), flags(0, 0, 0), flags(0, 0, 0), discount=0.5, trace_decay=0.5
    )
    assert advantages.flatten().tolist() == [1.6875, 2.75, 3.0]
    assert returns.flatten().tolist() == [2.6875, 4.75, 7.0]


def test_a_collision_is_followed_by_nothing_and_a_time_limit_by_the_value_of_its_final_state() -> None:
    # World 0 terminates at t = 0, world 1 is truncated there; the value of what came last is 10 in both.
    rewards = torch.tensor([[1.0, 1.0], [7.0, 7.0]])
    values = torch.tensor([[2.0, 2.0], [3.0, 3.0]])
    next_values = torch.tensor([[10.0, 10.0], [4.0, 4.0]])
    terminated = torch.tensor([[True, False], [False, False]])
    truncated = torch.tensor([[False, True], [False, False]])
    advantages, _ = estimate_advantages(
        rewards, values, next_values, terminated, truncated, discount=0.9, trace_decay=1.0
    )
    assert advantages[0].tolist() == pytest.approx([1.0 - 2.0, 1.0 + 0.9 * 10.0 - 2.0])
    # Nothing of the next episode leaks into either: the last step is the same in both worlds.
    assert advantages[1].tolist() == pytest.approx([7.0 + 0.9 * 4.0 - 3.0] * 2)


def test_with_lambda_one_returns_are_the_discounted_sums_of_a_slow_loop() -> None:
    generator = torch.Generator().manual_seed(3)
    T, N, discount = 30, 5, 0.97
    rewards, values = (torch.randn(T, N, generator=generator, dtype=torch.float64) for _ in range(2))
    bootstrap = torch.randn(T, N, generator=generator, dtype=torch.float64)
    terminated = torch.rand(T, N, generator=generator) < 0.1
    truncated = torch.rand(T, N, generator=generator) < 0.1
    ended = terminated | truncated
    next_values = torch.where(ended, bootstrap, torch.cat([values[1:], bootstrap[-1:]]))
    _, returns = estimate_advantages(
        rewards, values, next_values, terminated, truncated, discount=discount, trace_decay=1.0
    )
    for n in range(N):
        for t in range(T):
            total, weight, k = 0.0, 1.0, t
            while True:
                total += weight * float(rewards[k, n])
                weight *= discount
                if terminated[k, n]:
                    break
                if truncated[k, n] or k == T - 1:
                    total += weight * float(bootstrap[k, n])
                    break
                k += 1
            assert float(returns[t, n]) == pytest.approx(total, abs=1e-9)


def test_advantages_are_those_of_torchrl() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its imports
        functional = pytest.importorskip("torchrl.objectives.value.functional")
        generator = torch.Generator().manual_seed(5)
        T, N, discount, trace_decay = 40, 6, 0.98, 0.9
        rewards, values, final = (torch.randn(T, N, generator=generator, dtype=torch.float64) for _ in range(3))
        terminated = torch.rand(T, N, generator=generator) < 0.08
        truncated = (torch.rand(T, N, generator=generator) < 0.08) & ~terminated
        ended = terminated | truncated
        next_values = torch.where(ended, final, torch.cat([values[1:], final[-1:]]))
        # Its arrays are [batch, time, 1]; its `done` ends an episode, its `terminated` the task.
        columns = [x.T.unsqueeze(-1) for x in (values, next_values, rewards, ended, terminated)]
        expected, targets = functional.generalized_advantage_estimate(discount, trace_decay, *columns)
    advantages, returns = estimate_advantages(
        rewards, values, next_values, terminated, truncated, discount=discount, trace_decay=trace_decay
    )
    assert truncated.any() and terminated.any()
    # It computes the powers of gamma lambda in single precision.
    torch.testing.assert_close(advantages, expected.squeeze(-1).T, atol=5e-6, rtol=1e-5)
    torch.testing.assert_close(returns, targets.squeeze(-1).T, atol=5e-6, rtol=1e-5)
