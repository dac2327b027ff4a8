"""The public API and the command line, as a newcomer meets them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import densecavoid
from densecavoid.baselines.go_to_goal import GoToGoal
from densecavoid.cli import main


def test_everything_promised_is_there():
    for name in densecavoid.__all__:
        assert getattr(densecavoid, name) is not None


def test_the_base_package_imports_no_torch():
    code = "import sys, densecavoid, densecavoid.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_simulator_and_frames_import_neither_torch_nor_gymnasium():
    code = (
        "import sys, types; package = types.ModuleType('densecavoid'); package.__path__ = [sys.argv[1]];"
        "sys.modules['densecavoid'] = package; import densecavoid.sim.world;"
        "sys.exit('torch' in sys.modules or 'gymnasium' in sys.modules)"
    )
    path = str(Path(densecavoid.__file__).parent)
    assert subprocess.run([sys.executable, "-c", code, path], check=False).returncode == 0


def test_evaluate_agrees_with_itself_for_any_batch():
    one, many = (densecavoid.evaluate(GoToGoal(), "random-goal", 6, batch_size=size) for size in (1, 4))
    assert one == many
    assert one["success"] == 1.0 and one["episodes"] == 6


def test_run_writes_film_picture_and_episode(tmp_path, capsys):
    command = ["run", "--scenario", "random-goal", "--navigator", "go-to-goal", "--seed", "5", "--out", str(tmp_path)]
    assert main(command) == 0
    line = capsys.readouterr().out
    assert line.startswith("go-to-goal in random-goal (seed 5): success after") and line.count("\n") == 1
    episode = json.loads((tmp_path / "episode.json").read_text())
    assert episode["outcome"] == "success" and episode["seed"] == 5
    x, y = episode["trajectory"]["x"][-1], episode["trajectory"]["y"][-1]
    assert np.hypot(x - episode["goal"][0], y - episode["goal"][1]) < 0.3
    with Image.open(tmp_path / "episode.gif") as film:
        assert getattr(film, "n_frames", 1) > 5
    with Image.open(tmp_path / "episode.png") as picture:
        assert picture.size[0] > 300


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["fly"], "unknown verb 'fly'"),
        (
            ["run", "--navigator", "go-to-goal", "--scenario", "moon"],
            "unknown scenario 'moon', expected one of: random-goal",
        ),
        (["run", "--navigator", "magic"], "magic"),
        (["run", "--scenario", "tracks:nowhere.txt", "--navigator", "go-to-goal"], "nowhere.txt"),
        (["run", "--seed", "-3", "--navigator", "go-to-goal"], "seed is -3"),
        (["benchmark", "--episodes", "0"], "episodes is 0"),
    ],
)
def test_a_wrong_argument_is_one_clear_line(command, says, capsys):
    assert main(command) == 2
    error = capsys.readouterr().err
    assert says in " ".join(error.split()) and "Traceback" not in error


def test_a_malformed_recording_names_file_and_line(tmp_path, capsys):
    path = tmp_path / "broken.txt"
    path.write_text("0 1 0.0 0.0\n10 1 oops 0.0\n")
    out = ["--navigator", "go-to-goal", "--out", str(tmp_path)]
    assert main(["run", "--scenario", f"tracks:{path}", *out]) == 2
    error = capsys.readouterr().err.replace("\n", "")
    assert f"{path}:2" in error and "oops" in error


def test_recorded_people_of_any_track_file_are_met(tmp_path, capsys):
    rows = [f"{10 * k} {person} {0.4 * k - 4:.3f} {person:.3f}" for k in range(60) for person in range(-3, 4)]
    path = tmp_path / "tracks.txt"
    path.write_text("\n".join(rows))
    (tmp_path / "tracks.walls").write_text("# a wall\n-10 -6 10 -6\n")
    command = ["run", "--scenario", f"tracks:{path}", "--navigator", "go-to-goal", "--out", str(tmp_path)]
    assert main(command) == 0
    assert "go-to-goal in tracks:" in capsys.readouterr().out


def test_the_robot_is_put_among_the_people_of_a_hermes_run(data_dir, tmp_path, capsys):
    command = ["run", "--scenario", "hermes:bo-360-050-050", "--data", str(data_dir), "--navigator", "go-to-goal"]
    assert main([*command, "--out", str(tmp_path), "--film", "mp4"]) == 0
    assert "nearest person" in capsys.readouterr().out
    assert (tmp_path / "episode.mp4").stat().st_size > 10_000


def test_help_lists_the_verbs(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {verb} " in out for verb in ("run", "train", "benchmark"))


def test_what_is_wrong_is_said_to_the_letter_brackets_included(capsys):
    assert main(["perceive", "nonsense"]) == 2
    assert "usage: densecavoid perceive WHAT [options]" in capsys.readouterr().err
