"""Promises of training in several processes: as in one, and never half dead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from one_of_many import ITERATIONS, STEPS, WORLDS, learn, settings  # noqa: E402

from densecavoid.learning.checkpoint import load_checkpoint  # noqa: E402
from densecavoid.learning.peers import Peers  # noqa: E402
from densecavoid.learning.run_folder import RunFolder  # noqa: E402
from densecavoid.policy.network import PRESETS  # noqa: E402

HERE = Path(__file__).parent


def torchrun(what: str, folder: Path) -> subprocess.CompletedProcess:
    source = HERE.parents[1] / "src"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(source), str(HERE)]), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2"]
    command += [str(HERE / "one_of_many.py"), what, str(folder)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)


@pytest.fixture(autouse=True)
def _presets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS, "compact", PRESETS["compact"])  # put back after what `learn` does to it


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> list[dict]:
    """The states that two processes end with."""
    folder = tmp_path_factory.mktemp("pair")
    done = torchrun("learn", folder)
    assert done.returncode == 0, done.stderr[-3000:]
    return [load_checkpoint(folder / f"state-{rank}-of-2") for rank in (0, 1)]


@pytest.mark.slow
def test_two_processes_learn_what_one_learns_from_the_joint_batch(pair: list[dict], tmp_path: Path) -> None:
    trainer, _ = learn(settings(tmp_path, 1))
    alone = load_checkpoint(tmp_path / "state-0-of-1")
    assert pair[0]["counters"]["steps"] == alone["counters"]["steps"] == ITERATIONS * WORLDS * STEPS
    for name, array in alone["network"].items():
        np.testing.assert_allclose(pair[0]["network"][name], array, atol=2e-5, rtol=1e-4, err_msg=name)
    # What is decided together: levels, successes, learning rate, which draws come next.
    assert pair[0]["curriculum"] == alone["curriculum"] and alone["curriculum"]["levels"] != [0.0] * 4
    assert pair[0]["recent"] == alone["recent"]
    assert pair[0]["optimiser"]["groups"][0]["lr"] == alone["optimiser"]["groups"][0]["lr"] != 5e-4
    assert np.array_equal(pair[0]["generator"], alone["generator"])
    # Where the worlds are: the second process holds the second half of them.
    for rank, half in ((0, slice(0, WORLDS // 2)), (1, slice(WORLDS // 2, WORLDS))):
        ours = pair[0]["worlds"][str(rank)]["envs"]["0"]
        for name, whole in alone["worlds"]["0"]["envs"]["0"].items():
            if whole.dtype.kind in "if" and whole.ndim:
                np.testing.assert_allclose(ours[name], whole[half], atol=1e-4, err_msg=name)
    assert trainer.network.config.normalise_inputs


@pytest.mark.slow
def test_both_processes_hold_the_same_bits(pair: list[dict]) -> None:
    first, second = pair
    for part in ("network", "generator", "curriculum", "recent", "counters"):
        assert str(first[part]) == str(second[part])
    for name, array in first["network"].items():
        assert array.tobytes() == second["network"][name].tobytes(), name


def test_worlds_in_two_groups_give_what_one_group_gives(tmp_path: Path) -> None:
    learn(settings(tmp_path, 1))
    one = load_checkpoint(tmp_path / "state-0-of-1")
    learn(settings(tmp_path, 1, world_groups=2))
    two = load_checkpoint(tmp_path / "state-0-of-1")
    assert len(two["worlds"]["0"]["envs"]) == 2
    for name, array in one["network"].items():
        np.testing.assert_allclose(two["network"][name], array, atol=2e-5, rtol=1e-4, err_msg=name)
    assert one["curriculum"] == two["curriculum"] and one["recent"] == two["recent"]


@pytest.mark.slow
def test_a_process_that_dies_ends_the_training_with_a_message_and_a_whole_checkpoint(tmp_path: Path) -> None:
    done = torchrun("die", tmp_path / "run")
    assert done.returncode != 0
    assert "process 0 of 2 lost the others" in done.stderr
    assert f"The last checkpoint is whole; to go on: densecavoid train --resume --run-dir {tmp_path / 'run'}" in (
        done.stderr
    )
    state = load_checkpoint(RunFolder(tmp_path / "run").last_checkpoint)
    assert state["counters"]["iteration"] == 2 and len(state["worlds"]) == 2


def test_moments_are_those_of_numpy() -> None:
    x = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)) * 4 + 7
    count, mean, variance = Peers().moments(x)
    assert count.tolist() == [50.0]
    np.testing.assert_allclose(mean, x.numpy().mean(0), rtol=1e-5)
    np.testing.assert_allclose(variance, x.numpy().var(0), rtol=1e-5)
