"""Promises of the policy's distribution, against torch.distributions and by counting."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from densecavoid.frames import COMMAND_GRID  # noqa: E402
from densecavoid.policy.distribution import DiagonalGaussian, GridChoice  # noqa: E402


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


@pytest.fixture
def choice() -> GridChoice:
    logits = 2.0 * torch.randn(50, 25, generator=torch.Generator().manual_seed(2))
    return GridChoice(
        torch.log_softmax(logits, dim=1), torch.from_numpy(COMMAND_GRID).float() * torch.tensor([1.0, 0.4])
    )


def test_a_choice_has_the_figures_of_torchs_categorical(choice: GridChoice) -> None:
    categorical = torch.distributions.Categorical(logits=choice.log_probs)
    index = torch.randint(25, (50,), generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(choice.log_prob(choice.grid[index]), categorical.log_prob(index))
    torch.testing.assert_close(choice.entropy(), categorical.entropy().mean())
    assert torch.equal(choice.mode, choice.grid[categorical.probs.argmax(dim=1)])
    order = torch.randperm(25, generator=torch.Generator().manual_seed(4))
    torch.testing.assert_close(choice.shares(choice.grid[order][None]), categorical.probs[:, order])


def test_a_choice_is_drawn_as_often_as_it_is_likely(choice: GridChoice) -> None:
    one = GridChoice(choice.log_probs[:1].expand(40_000, -1), choice.grid)
    sample = one.at(torch.randn(40_000, 2, generator=torch.Generator().manual_seed(5)))
    counted = (sample[:, None] == one.grid).all(dim=2).float().mean(dim=0)
    assert counted.tolist() == pytest.approx(one.log_probs[0].exp().tolist(), abs=0.008)
    assert sample.std(0).tolist() == pytest.approx(one.std.tolist(), rel=0.02)


@pytest.mark.parametrize("noise", [-40.0, 40.0])
def test_the_farthest_draws_are_commands_that_are_likely(choice: GridChoice, noise: float) -> None:
    certain = torch.full((50, 25), -torch.inf)
    certain[:, 7] = 0.0
    torch.testing.assert_close(
        GridChoice(certain, choice.grid).at(torch.full((50, 2), noise)), choice.grid[7].expand(50, 2)
    )
