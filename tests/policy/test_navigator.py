"""Promises of the policy as a navigator, with real frames of the simulator."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.benchmark.navigators import make_navigator  # noqa: E402
from densecavoid.env.observation import Observer, ObserverConfig  # noqa: E402
from densecavoid.frames import Navigator, Observation, RobotConfig, SensorFrame  # noqa: E402
from densecavoid.policy.card import PolicyCard  # noqa: E402
from densecavoid.policy.export import describe, export_onnx  # noqa: E402
from densecavoid.policy.navigator import PolicyNavigator, load_policy, read_observer_config  # noqa: E402
from densecavoid.policy.network import ActorCritic, NetworkConfig, ObservationTensors  # noqa: E402
from densecavoid.policy.noise import EpisodeNoise  # noqa: E402
from densecavoid.policy.runtime import OnnxPolicy  # noqa: E402
from densecavoid.scenarios import make_scenario  # noqa: E402
from densecavoid.sim.world import Simulator  # noqa: E402


@pytest.fixture(scope="module")
def network() -> ActorCritic:
    torch.manual_seed(0)
    network = ActorCritic(NetworkConfig.preset("compact"))
    torch.nn.init.orthogonal_(network.actor_output.weight)
    return network


@pytest.fixture(scope="module")
def path(network: ActorCritic, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "p.onnx"
    export_onnx(
        path, network, describe(network, "p", observation=dataclasses.asdict(ObserverConfig(horizons_s=(0.6,))))
    )
    return path


def simulator(worlds: int) -> Simulator:
    simulator = Simulator(make_scenario("random-pedestrians"), worlds)
    simulator.reset(np.arange(worlds, dtype=np.int64))
    return simulator


def frames(worlds: int, steps: int) -> list[SensorFrame]:
    """Copies, since the simulator reuses its buffers."""
    sim, navigator = simulator(worlds), []
    for _ in range(steps):
        frame = sim.sense()
        arrays = {f.name: getattr(frame, f.name) for f in dataclasses.fields(frame) if f.name != "truth"}
        navigator.append(
            dataclasses.replace(frame, **{name: array.copy() for name, array in arrays.items()}, truth=frame.truth)
        )
    return navigator


def test_it_is_a_navigator_and_says_when_it_reads_ground_truth(path: Path) -> None:
    navigator = load_policy(path)
    assert isinstance(navigator, Navigator)
    assert navigator.name == "p" and not navigator.privileged
    for people_from in ("truth", "boxes"):
        navigator = load_policy(path, people_from=people_from)
        assert navigator.name == f"p:{people_from}" and navigator.privileged


def test_it_finds_people_by_itself_unless_told_otherwise(path: Path) -> None:
    frame = frames(1, 1)[0]
    blind = dataclasses.replace(frame, truth=None)
    load_policy(path).act(blind)
    with pytest.raises(ValueError, match="no ground truth"):
        load_policy(path, people_from="truth").act(blind)


def test_names_say_where_people_come_from(path: Path) -> None:
    assert not make_navigator(str(path)).privileged
    assert make_navigator(f"{path}:truth").privileged
    assert make_navigator("densecavoid:truth").privileged and not make_navigator("densecavoid").privileged
    with pytest.raises(ValueError, match="unknown navigator"):
        make_navigator("go-to-goal:truth")


def test_the_first_policies_single_horizon_is_understood() -> None:
    config = read_observer_config({"horizon_s": 0.6, "people_from": "truth"}, "detector")
    assert config == ObserverConfig(horizons_s=(0.6,), people_from="detector")


def test_a_policy_without_the_prediction_frame_is_not_privileged(network: ActorCritic, tmp_path: Path) -> None:
    export_onnx(tmp_path / "d.onnx", network, describe(network, "d", sensors="depth-lidar"))
    for people_from in ("detector", "truth"):
        assert not load_policy(tmp_path / "d.onnx", people_from=people_from).privileged


@dataclasses.dataclass
class HalfSpeed:
    """Wants half of what its robot can do, and keeps what it was shown."""

    card: PolicyCard
    shown: Observation | None = None

    def __call__(self, observation: Observation, noise: np.ndarray | None = None) -> np.ndarray:
        assert noise is None
        self.shown = observation
        return np.tile(np.array([0.5, 0.4], np.float32), (len(observation.goal), 1))


@pytest.mark.parametrize(("weighs", "command", "velocity"), [(True, (0.3, 0.4), 0.5), (False, (0.5, 0.4), 0.3)])
def test_a_slower_robot_is_spoken_to_in_shares_of_what_it_can_do(
    network: ActorCritic, weighs: bool, command: tuple[float, float], velocity: float
) -> None:
    """By a policy that weighs commands; another one's are cut."""
    config = ObserverConfig(route_every_s=0.5, weighs_commands=weighs)
    policy = HalfSpeed(describe(network, "half", observation=dataclasses.asdict(config)))
    robot = RobotConfig(max_linear_velocity=0.6, max_angular_velocity=1.5)
    navigator = PolicyNavigator(policy, robot=robot)
    frame = dataclasses.replace(frames(1, 1)[0], velocity=np.array([[0.3, 0.1]], np.float32))
    assert np.stack(navigator.act(frame), axis=1)[0] == pytest.approx(command)
    assert policy.shown is not None and policy.shown.velocity[0] == pytest.approx((velocity, 0.1))
    limits = navigator.observer_config.robot
    assert (limits.max_linear_velocity, limits.max_angular_velocity) == pytest.approx((0.6, 0.4))
    slow = PolicyNavigator(policy, robot=RobotConfig(max_linear_velocity=0.2))
    assert np.stack(slow.act(frame), axis=1)[0, 0] == pytest.approx(0.1 if weighs else 0.2)


def test_its_command_is_the_networks_mean_of_the_observers_observation(path: Path, network: ActorCritic) -> None:
    navigator = load_policy(path, people_from="truth")
    navigator.reset(np.ones(3, bool))
    observer = Observer(ObserverConfig(horizons_s=(0.6,)), 3)
    for frame in frames(3, 3):
        command = navigator.act(frame)
        observation = observer.observe(frame)
        with torch.no_grad():
            mean = network.command(
                ObservationTensors(*(torch.from_numpy(array.copy()) for array in observation))
            ).numpy()
        np.testing.assert_allclose(command.linear_velocity, mean[:, 0], atol=1e-4)
        np.testing.assert_allclose(command.angular_velocity, mean[:, 1], atol=1e-4)


def test_reset_of_one_world_makes_it_as_new_and_leaves_the_others(path: Path) -> None:
    veteran, fresh = load_policy(path), load_policy(path)
    everyone, first = np.ones(2, bool), np.array([True, False])
    veteran.reset(everyone)
    sim = simulator(2)
    from densecavoid.frames import Command

    for _ in range(8):
        command = veteran.act(sim.sense())
        sim.step(Command(np.full(2, 0.6, np.float32), command.angular_velocity))
    before = [array.copy() for array in veteran._observer.observe(sim.sense())]
    veteran.reset(first)
    fresh.reset(everyone)
    after = veteran._observer.observe(sim.sense())
    new = fresh._observer.observe(sim.sense())
    assert np.array_equal(after.lidar[0], new.lidar[0]), "world 0 forgot its earlier scans"
    assert not np.array_equal(after.lidar[1], new.lidar[1]), "world 1 did not"
    assert np.array_equal(after.lidar[1, 1], before[0][1, 2])


def test_draws_scatter_as_the_policy_says_within_the_limits_and_follow_the_seed(path: Path) -> None:
    frame = frames(1, 1)[0]
    mean = load_policy(path).act(frame)
    navigator = load_policy(path, sample=True, seed=4)
    draws = [float(navigator.act(frame).angular_velocity[0]) for _ in range(300)]
    limit = float(np.float32(0.4))
    assert min(draws) >= -limit and max(draws) <= limit
    inside = [draw for draw in draws if abs(draw) < limit]
    assert len(set(inside)) == len(inside)
    median = float(np.median(draws))
    assert median == pytest.approx(float(mean.angular_velocity[0]), abs=0.04)
    for again in (navigator, load_policy(path, sample=True, seed=4)):
        again.reset(np.ones(1, bool))
        assert [float(again.act(frame).angular_velocity[0]) for _ in range(5)] == draws[:5], (
            "every episode's are the same"
        )


def test_a_policy_that_chooses_must_be_told_what_commands_are_worth_and_draws(tmp_path: Path) -> None:
    config = dataclasses.replace(NetworkConfig.preset("compact"), worth_features=8, chooses=True)
    chooser = ActorCritic(config)
    export_onnx(tmp_path / "chooser.onnx", chooser, describe(chooser, "chooser"))
    with pytest.raises(ValueError, match="weighs_commands in the card of policy 'chooser' is False, expected true"):
        load_policy(tmp_path / "chooser.onnx")
    weighing = dataclasses.asdict(ObserverConfig(route_every_s=0.5, weighs_commands=True))
    export_onnx(tmp_path / "chooser.onnx", chooser, describe(chooser, "chooser", observation=weighing))
    navigator, likeliest = (load_policy(tmp_path / "chooser.onnx", sample=sample) for sample in (None, False))
    drawn, expected = set(), set()
    for frame in frames(1, 30):
        command, mode = navigator.act(frame), likeliest.act(frame)
        assert navigator.observation is not None and navigator.noise is not None and likeliest.noise is None
        with torch.no_grad():
            policy = chooser.policy(
                ObservationTensors(*(torch.from_numpy(array.copy()) for array in navigator.observation))
            )
        found = float(command.linear_velocity[0]), float(command.angular_velocity[0])
        assert found == pytest.approx(tuple(policy.at(torch.from_numpy(navigator.noise).float())[0].tolist()))
        assert float(mode.linear_velocity[0]) == pytest.approx(float(policy.mode[0, 0]))
        drawn.add(found)
        expected.add((float(mode.linear_velocity[0]), float(mode.angular_velocity[0])))
    assert len(drawn) > len(expected)


def test_draws_of_a_world_do_not_depend_on_those_beside_it() -> None:
    noise, alone = EpisodeNoise(3, 2), EpisodeNoise(3, 1)
    first = [noise.next() for _ in range(5)]
    noise.reset(np.array([False, True]))
    rest = [noise.next() for _ in range(1500)]
    expected = np.concatenate([alone.next() for _ in range(1505)])
    np.testing.assert_array_equal(np.stack([*first, *rest])[:, 0], expected)
    np.testing.assert_array_equal(np.stack(rest)[:, 1], expected[:1500])
    assert abs(expected.mean()) < 0.1 and expected.std() == pytest.approx(1.0, abs=0.05)


def test_frames_of_another_size_than_announced_are_refused(path: Path) -> None:
    navigator = PolicyNavigator(OnnxPolicy(path), num_worlds=2)
    with pytest.raises(ValueError, match="the frame has 1 worlds, expected 2"):
        navigator.act(frames(1, 1)[0])
    navigator.reset(np.ones(1, bool))
    assert navigator.act(frames(1, 1)[0]).linear_velocity.shape == (1,)
