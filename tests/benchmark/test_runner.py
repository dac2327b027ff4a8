"""The benchmark as a whole: its files, and that they do not depend on how the work is shared out."""

from __future__ import annotations

import json

import pytest
from rich.console import Console

from densecavoid.benchmark.metrics import RATES
from densecavoid.benchmark.navigators import make_navigator
from densecavoid.benchmark.runner import TEST_SEEDS_START, BenchmarkConfig, run_benchmark

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Two small cells, and the folder that they were written to."""
    out = tmp_path_factory.mktemp("benchmark")
    config = BenchmarkConfig(("go-to-goal",), ("random-sparse-ped", "dense-ped"), episodes=12, out=out, batch_size=4)
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


def test_each_episode_is_listed_for_paired_comparison(measured):
    config, results = measured
    listed = [json.loads(line) for line in (config.out / "episodes.jsonl").read_text().splitlines()]
    assert len(listed) == 24
    for cell in results["cells"]:
        mine = [episode for episode in listed if episode["scenario"] == cell["scenario"]]
        assert [episode["seed"] for episode in mine] == list(range(TEST_SEEDS_START, TEST_SEEDS_START + 12))
        assert sum(episode["outcome"] == "success" for episode in mine) / 12 == pytest.approx(cell["success"], abs=1e-5)


def test_results_do_not_depend_on_workers_or_batch_size(measured, tmp_path, monkeypatch):
    config, results = measured
    monkeypatch.setattr("densecavoid.benchmark.runner.EPISODES_PER_TASK", 5)
    shared = BenchmarkConfig(config.navigators, config.scenarios, episodes=12, out=tmp_path, workers=2, batch_size=3)
    assert run_benchmark(shared, QUIET)["cells"] == results["cells"]


def test_another_seed_is_other_worlds(measured, tmp_path):
    config, results = measured
    other = BenchmarkConfig(config.navigators, config.scenarios[:1], episodes=12, out=tmp_path, seed=1, batch_size=4)
    (cell,) = run_benchmark(other, QUIET)["cells"]  # type: ignore[misc]
    assert cell["seeds"][0] == TEST_SEEDS_START + 100_000
    assert cell["jerk_m_s3"] != results["cells"][0]["jerk_m_s3"]


def test_a_stopped_run_keeps_the_cells_it_has(tmp_path, monkeypatch):
    import densecavoid.benchmark.runner as runner

    whole = runner.run_task

    def stops_at_second_cell(task, on_episode=None):
        if task.scenario == "dense-ped":
            raise KeyboardInterrupt
        return whole(task, on_episode)

    monkeypatch.setattr(runner, "run_task", stops_at_second_cell)
    config = BenchmarkConfig(
        ("go-to-goal",), ("random-sparse-ped", "dense-ped"), episodes=4, out=tmp_path, batch_size=4
    )
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(config, QUIET)
    written = json.loads((tmp_path / "results.json").read_text())
    assert [cell["scenario"] for cell in written["cells"]] == ["random-sparse-ped"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "BenchmarkConfig.episodes is 0"),
        ({"workers": 0}, "BenchmarkConfig.workers is 0"),
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
