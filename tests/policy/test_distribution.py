"""Promises of the policy's distribution, against torch.distributions and by counting."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from densecavoid.policy.distribution import DiagonalGaussian  # noqa: E402


@pytest.fixture
def policy() -> DiagonalGaussian:
    generator = torch.Generator().manual_seed(0)
    return DiagonalGaussian(torch.randn(50, 2, generator=generator), torch.tensor([0.3, 0.15]).log())


def test_log_probability_and_entropy_are_those_of_torch(policy: DiagonalGaussian) -> None:
    action = policy.at(torch.randn(50, 2, generator=torch.Generator().manual_seed(1)))
    normal = torch.distributions.Normal(policy.mean, policy.log_std.exp())
    torch.testing.assert_close(policy.log_prob(action), normal.log_prob(action).sum(1))
    torch.testing.assert_close(policy.entropy(), normal.entropy().sum(1)[0])


def test_draws_have_the_mean_and_deviation() -> None:
    policy = DiagonalGaussian(torch.tensor([[0.5, -0.2]]).expand(40_000, 2), torch.tensor([0.3, 0.15]).log())
    sample = policy.at(torch.randn(40_000, 2, generator=torch.Generator().manual_seed(5)))
    assert sample.mean(0).tolist() == pytest.approx([0.5, -0.2], abs=0.006)
    assert sample.std(0).tolist() == pytest.approx([0.3, 0.15], rel=0.02)
