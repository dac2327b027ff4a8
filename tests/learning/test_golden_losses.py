"""Golden tensors of the losses.

`tests/golden/losses.safetensors` holds inputs, and losses and gradients computed by the formulas below in NumPy and
double precision, apart from the code under test. To renew it, when a loss is changed on purpose, and only then:
`PYTHONPATH=src python tests/learning/test_golden_losses.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

GOLDEN = Path(__file__).parents[1] / "golden" / "losses.safetensors"
CLIP = 0.2


def compute(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Losses (means) and their gradients, by the definitions (Schulman et al. 2017, eq. 7; value loss halved)."""
    ratio = np.exp(inputs["log_prob"] - inputs["old_log_prob"])
    advantage = inputs["advantage"]
    kept = np.where(advantage >= 0, np.minimum(ratio, 1 + CLIP), np.maximum(ratio, 1 - CLIP))
    follows = np.where(advantage >= 0, ratio <= 1 + CLIP, ratio >= 1 - CLIP)
    n = len(ratio)
    error = inputs["value"] - inputs["returns"]
    moved = np.clip(inputs["value"] - inputs["old_value"], -CLIP, CLIP)
    kept_error = inputs["old_value"] + moved - inputs["returns"]
    inside = np.abs(inputs["value"] - inputs["old_value"]) <= CLIP
    worse = np.abs(kept_error) > np.abs(error)
    return {
        "policy_loss": np.array([-np.mean(kept * advantage)]),
        "policy_gradient": np.where(follows, -ratio * advantage / n, 0.0),
        "value_loss": np.array([0.5 * np.mean(error**2)]),
        "value_gradient": error / n,
        "clipped_value_loss": np.array([0.5 * np.mean(np.maximum(error**2, kept_error**2))]),
        "clipped_value_gradient": np.where(worse, np.where(inside, kept_error, 0.0), error) / n,
    }


def test_losses_and_their_gradients_are_the_golden_ones() -> None:
    torch = pytest.importorskip("torch")
    from safetensors.numpy import load_file

    from densecavoid.learning import ppo

    golden = load_file(GOLDEN)
    given = {name: torch.from_numpy(array) for name, array in golden.items()}
    log_prob = given["log_prob"].clone().requires_grad_()
    losses, _ = ppo.policy_loss(log_prob, given["old_log_prob"], given["advantage"], CLIP)
    losses.mean().backward()
    torch.testing.assert_close(losses.mean().detach()[None], given["policy_loss"])
    torch.testing.assert_close(log_prob.grad, given["policy_gradient"])
    for clip, name in ((0.0, "value"), (CLIP, "clipped_value")):
        value = given["value"].clone().requires_grad_()
        loss = ppo.value_loss(value, given["old_value"], given["returns"], clip).mean()
        loss.backward()
        torch.testing.assert_close(loss.detach()[None], given[f"{name}_loss"])
        torch.testing.assert_close(value.grad, given[f"{name}_gradient"])


def main() -> None:
    from safetensors.numpy import save_file

    rng = np.random.default_rng(2026)
    names = ("log_prob", "old_log_prob", "advantage", "value", "old_value", "returns")
    inputs = {name: rng.normal(0.0, 0.3 if "log_prob" in name else 1.0, 64) for name in names}
    GOLDEN.parent.mkdir(exist_ok=True)
    save_file(inputs | compute(inputs), GOLDEN)


if __name__ == "__main__":
    main()
