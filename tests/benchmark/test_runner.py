"""The benchmark as a whole: its files, and that they do not depend on how the work is shared out."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from rich.console import Console

from densecavoid.benchmark.metrics import RATES
from densecavoid.benchmark.navigators import make_navigator
from densecavoid.benchmark.runner import TEST_SEEDS_START, BenchmarkConfig, run_benchmark
from densecavoid.foresight.planner import judge_worlds

QUIET = Console(quiet=True)


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory):
    """Worlds are judged once for all tests here, and not in the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr("densecavoid.benchmark.solvable.user_cache", lambda: folder)
        yield


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Two small cells, and the folder that they were written to."""
    out = tmp_path_factory.mktemp("benchmark")
    scenarios = ("random-sparse-ped", "dense-ped")
    config = BenchmarkConfig(("go-to-goal",), scenarios, episodes=12, out=out, batch_size=4, workers=1)
    return config, run_benchmark(config, QUIET)


def test_results_file_is_strict_json_of_the_promised_schema(measured):
    config, results = measured

    def refuse(constant: str):
        raise AssertionError(f"{constant} is no JSON")

    written = json.loads((config.out / "results.json").read_text(), parse_constant=refuse)
    assert written == results
    assert written["definition"] == "1"
    assert [cell["scenario"] for cell in written["cells"]] == ["random-sparse-ped", "dense-ped"]
    for cell in written["cells"]:
        assert cell["navigator"] == "go-to-goal"
        assert (cell["people"], cell["dynamics"], cell["sensors"]) == ("scripted", "ideal", "clean")
        assert cell["privileged"] is False
        assert cell["policy_sha256"] is None
        assert cell["episodes"] == 12
        assert cell["seeds"] == [TEST_SEEDS_START, TEST_SEEDS_START + 11]
        assert cell["success"] + cell["collision"] + cell["timeout"] == pytest.approx(1.0, abs=1e-5)
        assert cell["collision_at_fault"] + cell["walked_into"] == pytest.approx(cell["collision"], abs=1e-5)
        for rate in RATES:
            low, high = cell[f"{rate}_ci95"]
            assert 0 <= low <= cell[rate] <= high <= 1
        for figure in ("path_length_m", "time_to_goal_s", "spl", "clearance_people_m", "personal_space", "jerk_m_s3"):
            assert figure in cell
        assert "w_sign_changes_per_m" in cell
    for world in written["worlds"]:
        assert world["admitted"] == 12 <= world["solvable"] <= world["tried"] and world["filtered"]
        assert world["reference_time_s"] > 4.0


def test_each_episode_is_listed_for_paired_comparison(measured):
    config, results = measured
    listed = [json.loads(line) for line in (config.out / "episodes.jsonl").read_text().splitlines()]
    assert len(listed) == 24
    for cell in results["cells"]:
        mine = [episode for episode in listed if episode["scenario"] == cell["scenario"]]
        assert [episode["seed"] for episode in mine] == list(range(TEST_SEEDS_START, TEST_SEEDS_START + 12))
        assert sum(episode["outcome"] == "success" for episode in mine) / 12 == pytest.approx(cell["success"], abs=1e-5)


def test_every_navigator_meets_the_first_worlds_that_can_be_solved(tmp_path, monkeypatch):
    """Worlds without a way are left out, and the next ones taken."""
    import densecavoid.benchmark.runner as runner

    def every_third_is_hopeless(task):
        whole = judge_worlds(task.scenario, task.seeds, task.sim_config)
        return [replace(j, plan=None) if seed % 3 == 0 else j for seed, j in zip(task.seeds, whole, strict=True)]

    monkeypatch.setattr("densecavoid.benchmark.solvable.user_cache", lambda: tmp_path / "cache")
    monkeypatch.setattr(runner, "judge_task", every_third_is_hopeless)
    config = BenchmarkConfig(("go-to-goal",), ("random-goal",), episodes=6, out=tmp_path, workers=1)
    results = run_benchmark(config, QUIET)
    listed = [json.loads(line)["seed"] for line in (tmp_path / "episodes.jsonl").read_text().splitlines()]
    expected = [seed for seed in range(TEST_SEEDS_START, TEST_SEEDS_START + 10) if seed % 3][:6]
    assert listed == expected
    (world,) = results["worlds"]  # type: ignore[misc]
    assert world["tried"] == expected[-1] - TEST_SEEDS_START + 1 and world["solvable"] == 6


@pytest.mark.slow
def test_results_do_not_depend_on_workers_or_batch_size(measured, tmp_path, monkeypatch):
    config, results = measured
    monkeypatch.setattr("densecavoid.benchmark.runner.EPISODES_PER_TASK", 5)
    shared = BenchmarkConfig(config.navigators, config.scenarios, episodes=12, out=tmp_path, workers=2, batch_size=3)
    assert run_benchmark(shared, QUIET)["cells"] == results["cells"]


@pytest.mark.slow
def test_a_ray_cluster_of_two_nodes_gives_the_same_results(measured, tmp_path):
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    config, results = measured
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        spread = BenchmarkConfig(
            config.navigators, config.scenarios, episodes=12, out=tmp_path, batch_size=4, ray=cluster.address
        )
        assert run_benchmark(spread, QUIET)["cells"] == results["cells"]
    finally:
        cluster.shutdown()


def test_another_seed_is_other_worlds(measured, tmp_path):
    config, results = measured
    scenarios = config.scenarios[:1]
    other = BenchmarkConfig(config.navigators, scenarios, episodes=12, out=tmp_path, seed=1, batch_size=4, workers=1)
    (cell,) = run_benchmark(other, QUIET)["cells"]  # type: ignore[misc]
    assert cell["seeds"][0] == TEST_SEEDS_START + 100_000
    assert cell["jerk_m_s3"] != results["cells"][0]["jerk_m_s3"]


def test_a_stopped_run_keeps_what_it_has_and_goes_on_from_there(measured, tmp_path, monkeypatch):
    import densecavoid.benchmark.runner as runner

    config, results = measured
    whole, done = runner.run_task, []

    def stops(task):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append((task.scenario, task.seeds))
        return whole(task)

    monkeypatch.setattr(runner, "EPISODES_PER_TASK", 5)
    monkeypatch.setattr(runner, "run_task", stops)
    again = replace(config, out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(again, QUIET)
    # 12 episodes are three shares: the first scenario is done.
    written = json.loads((tmp_path / "results.json").read_text())
    assert [cell["scenario"] for cell in written["cells"]] == ["random-sparse-ped"]
    before = list(done)
    monkeypatch.setattr(runner, "run_task", lambda task: done.append((task.scenario, task.seeds)) or whole(task))
    assert run_benchmark(again, QUIET)["cells"] == results["cells"]
    assert len(done) == len(set(done)) == 6 and done[:3] == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "BenchmarkConfig.episodes is 0"),
        ({"workers": -1}, "BenchmarkConfig.workers is -1"),
        ({"navigators": ()}, "BenchmarkConfig.navigators"),
        ({"scenarios": ("dense-ped", "dense-ped")}, "each once"),
        ({"seed": -1}, "BenchmarkConfig.seed is -1"),
    ],
)
def test_impossible_configurations_are_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        BenchmarkConfig(**change)


def test_unknown_names_are_refused_before_anything_runs(tmp_path):
    with pytest.raises(ValueError, match=r"unknown navigator 'teleport'.*go-to-goal"):
        run_benchmark(BenchmarkConfig(("teleport",), out=tmp_path / "n"), QUIET)
    with pytest.raises(ValueError, match=r"unknown scenario 'moon'.*dense-ped"):
        run_benchmark(BenchmarkConfig(("go-to-goal",), ("moon",), out=tmp_path / "n"), QUIET)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.onnx"):
        make_navigator("nowhere.onnx")
    assert not (tmp_path / "n").exists()
