"""Promises of guided training: rewards add up to what happened, worlds are the same by number, and runs go on."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.foresight.future import foresee, solid_bodies  # noqa: E402
from densecavoid.frames import Command  # noqa: E402
from densecavoid.learning.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from densecavoid.learning.config import TrainConfig  # noqa: E402
from densecavoid.learning.foreseen_envs import UNIT, ForeseenVectorEnv  # noqa: E402
from densecavoid.learning.foreseen_worlds import AnyLevel, ForeseenWorlds, ForesightConfig, build_world  # noqa: E402
from densecavoid.learning.guidance import guide, losses_of_commands  # noqa: E402
from densecavoid.learning.trainer import Trainer  # noqa: E402
from densecavoid.policy.distribution import DiagonalGaussian  # noqa: E402
from densecavoid.policy.network import PRESETS, ActorCritic  # noqa: E402
from densecavoid.scenarios import TRAINING  # noqa: E402
from densecavoid.sim.config import SimConfig  # noqa: E402
from densecavoid.sim.people import STANDING  # noqa: E402
from densecavoid.sim.world import Simulator  # noqa: E402

SIM = SimConfig(threads=1)
FEW = ForesightConfig(steps=1000, worlds=4, memory_mb=200, processes=1, renewed=1)


@pytest.fixture(scope="module")
def worlds() -> Iterator[ForeseenWorlds]:
    made = ForeseenWorlds(FEW, SIM, seed=3)
    made.fill()
    yield made
    made.close()


def test_the_rewards_of_an_episode_add_up_to_its_end_less_its_beginning(worlds: ForeseenWorlds) -> None:
    env = ForeseenVectorEnv(worlds, 6, sim=SIM, seed=1)
    env.reset(seed=1)
    rng, gamma = np.random.default_rng(0), FEW.values.discount
    first, added, ended = env._value.copy(), np.zeros(6), 0
    age = np.zeros(6)
    for _ in range(300):
        _, reward, terminated, truncated, infos = env.step(
            np.stack([rng.uniform(0.3, 1.0, 6), rng.uniform(-0.4, 0.4, 6)], axis=1).astype(np.float32)
        )
        added += gamma**age * reward
        age += 1
        assert not truncated.any()
        for b in np.flatnonzero(terminated):
            outcome = infos["episode"]
            end = 1.0 if outcome["success"][b] else FEW.values.collision if outcome["collision"][b] else 0.0
            assert added[b] == pytest.approx(UNIT * (gamma ** (age[b] - 1) * end - first[b]), abs=1e-3)
            first[b], added[b], age[b], ended = env._value[b], 0.0, 0.0, ended + 1
    assert ended >= 6


def test_a_world_is_the_same_by_number_and_its_people_do_what_was_foreseen() -> None:
    one, other = (build_world(3, 1, FEW, SIM) for _ in range(2))
    assert one.starts == other.starts and one.field.values.tobytes() == other.field.values.tobytes()
    assert build_world(4, 1, FEW, SIM).spec.start_pose != one.spec.start_pose
    crowded = next(world for number in range(20) if len((world := build_world(3, number, FEW, SIM)).field.values) > 1)

    class Again:
        name = "again"

        def spawn(self, rng: np.random.Generator):
            rng.bit_generator.state = crowded.random_state
            return crowded.spec

    (future,) = foresee(Again(), [0], SIM)
    simulator = Simulator(Again(), 1, SIM)
    simulator.reset(np.array([77]))
    still = Command(np.zeros(1, np.float32), np.zeros(1, np.float32))
    steps = 0
    while steps < 50 and not simulator.done[0]:
        simulator.step(still)
        steps += 1
    np.testing.assert_array_equal(
        solid_bodies(simulator, 0)[:, :2].astype(np.float32), future.bodies[steps * SIM.sub_steps - 1, :, :2]
    )


def test_a_setting_under_which_no_world_can_be_built_is_named() -> None:
    hasty = dataclasses.replace(FEW, values=dataclasses.replace(FEW.values, hold_s=2.0))
    with pytest.raises(ValueError, match=r"the last: FieldConfig\.hold_s is 2\.0, expected shorter than"):
        build_world(3, 1, hasty, SIM)


def test_those_who_would_appear_stand_there_from_the_start() -> None:
    scenario = AnyLevel(TRAINING["dense-random-pedestrians"], (1.0, 1.0))
    specs = [scenario.spawn(np.random.default_rng(seed)) for seed in range(30)]
    lines = [spec for spec in specs if (spec.crowd.behaviour == STANDING).all()]
    assert lines and all(spec.appearance is None for spec in specs)
    for spec in lines:
        assert np.ptp(spec.crowd.pos[:, 0]) == 0.0 and spec.crowd.pos[0, 0] > spec.start_pose[0] + 2.4


def test_worlds_are_renewed_oldest_first_and_come_back_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    made, again = (ForeseenWorlds(dataclasses.replace(FEW, worlds=3, renewed=2), SIM, seed=5) for _ in range(2))
    try:
        made.fill()
        numbers = [made.state_dict()["numbers"]]
        for _ in range(2):
            made.renew()
            numbers.append(made.state_dict()["numbers"])
        assert numbers == [[0, 1, 2], [3, 4, 2], [6, 4, 5]]
        again.load_state_dict(made.state_dict())
        with monkeypatch.context() as patched:  # nothing is left to build
            patched.setattr(again, "_submit", lambda number: pytest.fail(f"world {number} is built again"))
            again.load_state_dict(made.state_dict())
        made.renew()
        again.renew()
        assert again.state_dict() == made.state_dict()
        slots, pose, now = np.arange(3), np.array([[2.0, 1.0, 0.5]] * 3), np.full(3, 1.7)
        assert np.array_equal(made.fields.of_poses(slots, pose, now), again.fields.of_poses(slots, pose, now))
    finally:
        made.close()
        again.close()


def test_signals_that_stop_a_run_leave_its_builders_alive() -> None:
    made = ForeseenWorlds(dataclasses.replace(FEW, worlds=2), SIM, seed=0)
    try:
        made.fill()
        for pid in list(made._builders._processes):
            os.kill(pid, signal.SIGINT)
            os.kill(pid, signal.SIGTERM)
        for _ in range(3):
            made.renew()
        assert made.state_dict()["numbers"] == [4, 3]
    finally:
        made.close()


def test_too_little_memory_is_said() -> None:
    made = ForeseenWorlds(dataclasses.replace(FEW, memory_mb=1, shares=(0.0, 0.0, 0.0, 1.0)), SIM, seed=0)
    try:
        with pytest.raises(MemoryError, match="hold fewer than 4 worlds, or raise memory_mb from 1"):
            made.fill()
    finally:
        made.close()


def test_the_loss_is_what_a_loop_gives_and_its_gradient_leads_to_the_best_command() -> None:
    rng = torch.Generator().manual_seed(0)
    commands = torch.tensor([(v, w) for v in (0.0, 0.5, 1.0) for w in (-0.4, 0.0, 0.4)])
    values, mean, std = torch.rand(2, 9, generator=rng), torch.rand(2, 2, generator=rng), torch.tensor([0.3, 0.2])
    policy, losses = DiagonalGaussian(mean, std.log()), losses_of_commands(values, 0.5, 0.1)
    loss = (policy.shares(commands.expand(2, -1, -1)) * losses).sum(dim=1)
    for b in range(2):
        density = np.array([np.exp(-0.5 * float((((c - mean[b]) / std) ** 2).sum())) for c in commands])
        lost = np.minimum((values[b].max() - values[b]).numpy(), 0.5)
        lost /= 0.1 + lost.max()
        assert float(loss[b]) == pytest.approx(float(density @ lost / density.sum()), rel=1e-5)
    best = commands[4]
    values = -((commands - best) ** 2).sum(dim=1)[None]
    at = torch.tensor([[0.2, -0.2]], requires_grad=True)
    optimiser = torch.optim.Adam([at], lr=0.02)
    for _ in range(200):
        optimiser.zero_grad()
        policy = DiagonalGaussian(at, std.log())
        (policy.shares(commands[None]) * losses_of_commands(values, 9.0, 0.1)).sum().backward()
        optimiser.step()
    assert float((at[0] - best).abs().max().detach()) < 0.1


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    return TrainConfig(
        run_dir=tmp_path / "run",
        num_envs=8,
        steps_per_rollout=16,
        total_steps=512,
        threads=1,
        precision="float32",
        sim=SIM,
        foresight=dataclasses.replace(FEW, steps=256),
    )


@pytest.mark.slow
def test_guided_training_goes_on_to_the_same_bits_and_hands_over_to_ppo(config: TrainConfig, tmp_path: Path) -> None:
    whole, first = (Trainer(config) for _ in range(2))
    trainers = [whole, first]
    try:
        records = [whole.iterate() for _ in range(4)]
        assert [record["curriculum/stage"] for record in records] == ["guided", "foreseen", "foreseen", "foreseen"]
        assert ["guidance/regret" in record for record in records] == [True, True, False, False]
        assert whole.network.log_std is not None
        assert whole.network.log_std.exp().tolist() == pytest.approx(config.foresight.last_std, abs=0.01)
        first.iterate()
        save_checkpoint(tmp_path / "checkpoint", first.state_dict())
        rest = Trainer(config, state=load_checkpoint(tmp_path / "checkpoint"))
        trainers.append(rest)
        for _ in range(3):
            rest.iterate()
        for name, weights in whole.network.state_dict().items():
            assert torch.equal(weights, rest.network.state_dict()[name]), name
    finally:
        for trainer in trainers:
            trainer.close()


@pytest.mark.slow
def test_a_policy_that_chooses_begins_as_it_is_while_the_critic_learns(config: TrainConfig) -> None:
    config = dataclasses.replace(
        config,
        route_every_s=0.5,
        weighs_commands=True,
        choose_commands=True,
        foresight=dataclasses.replace(config.foresight, critic_alone=True),
    )
    trainer = Trainer(config)
    try:
        before = {name: tensor.clone() for name, tensor in trainer.network.state_dict().items()}
        assert "guidance/regret" in trainer.iterate()
        after = trainer.network.state_dict()
        changed = {name for name in before if not torch.equal(before[name], after[name])}
        assert "critic_output.weight" in changed and not {name for name in changed if name.startswith("actor_o")}
        trainer.iterate()
        record = trainer.iterate()
        assert record["ppo/first_ratio_error"] < 1e-4 and record["ppo/std_linear"] > 0
        assert not torch.equal(before["actor_output.weight"], trainer.network.state_dict()["actor_output.weight"])
    finally:
        trainer.close()


def test_guidance_lowers_the_regret_of_what_it_saw_and_goes_on_turning_where_all_is_as_good(
    config: TrainConfig,
) -> None:
    trainer = Trainer(config)
    try:
        rollout = trainer.collector.collect(trainer.network, trainer.generator)
        commands = torch.as_tensor(trainer.envs[0].commands, dtype=torch.float32)

        def guided(steadiness: float) -> tuple[list[float], ActorCritic]:
            network = ActorCritic(PRESETS["compact"])
            optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
            settings = (rollout, commands, 2, 0.1, 0.03, steadiness, 1.0, trainer.ppo_config, trainer.generator)
            return [guide(network, optimiser, *settings).regret for _ in range(15)], network

        regrets, _ = guided(0.0)
        assert regrets[-1] < 0.7 * regrets[0]
        assert rollout.command_values is not None
        rollout.command_values.zero_()
        _, network = guided(1.0)
        with torch.no_grad():
            turn = network.command(rollout.flat_observation())[:, 1]
        assert float(torch.corrcoef(torch.stack([turn, rollout.flat_observation().velocity[:, 1]]))[0, 1]) > 0.8
    finally:
        trainer.close()


def test_who_is_not_told_what_commands_are_worth_cannot_choose_nor_imitate_who_does_not() -> None:
    with pytest.raises(ValueError, match="choose_commands is True, expected false without weighs_commands"):
        TrainConfig(choose_commands=True)
    with pytest.raises(ValueError, match="none with choose_commands"):
        teacher = dataclasses.replace(TrainConfig().imitation, teacher=Path("x"))
        TrainConfig(route_every_s=0.5, weighs_commands=True, choose_commands=True, imitation=teacher)


def test_what_cannot_be_foreseen_is_refused() -> None:
    with pytest.raises(ValueError, match="no future of their own"):
        TrainConfig(foresight=FEW, sim=SimConfig(people="reactive"))
    with pytest.raises(ValueError, match=r"none together with foresight\.steps"):
        TrainConfig(foresight=FEW, imitation=dataclasses.replace(TrainConfig().imitation, teacher=Path("x")))
