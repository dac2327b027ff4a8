"""The command line: `densecavoid VERB --help`. Each verb is one call into a room; only its own room is imported."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.markup import escape

from densecavoid._verbs import Verb, needing_torch, run_verb


def _run(args: Sequence[str]) -> None:
    """one robot, one scenario: a film, episode.json and a line of result"""
    from densecavoid.viz.run import RunConfig, one_line, run

    config = tyro.cli(RunConfig, prog="densecavoid run", args=args)
    metrics = run(config)
    print(f"{config.navigator} in {config.scenario} (seed {config.seed}): {one_line(metrics)} -> {config.film_path}")


@dataclass(frozen=True)
class CompareConfig:
    """Settings of `densecavoid benchmark --compare`."""

    before: tyro.conf.Positional[Path]
    """A results.json, with episodes.jsonl beside it."""
    after: tyro.conf.Positional[Path]
    """Another one."""


def _benchmark(args: Sequence[str]) -> None:
    """navigators x scenarios x episodes: results.json, tables.md, index.html; --compare A B says what changed"""
    if "--compare" in args:
        from densecavoid.benchmark.compare import compare, comparison, other_conditions

        rest = [arg for arg in args if arg != "--compare"]
        pair = tyro.cli(CompareConfig, prog="densecavoid benchmark --compare", args=rest)
        print(comparison(compare(pair.before, pair.after), other_conditions(pair.before, pair.after)), end="")
        return
    from densecavoid.benchmark.report import write_report
    from densecavoid.benchmark.runner import BenchmarkConfig, run_benchmark
    from densecavoid.benchmark.scenes import write_scenes

    config = tyro.cli(BenchmarkConfig, prog="densecavoid benchmark", args=args)
    results = run_benchmark(config)
    write_scenes(config)
    write_report(results, config.out)
    for name in ("index.html", "tables.md", "success.png", "results.json"):
        print(config.out / name)


@dataclass(frozen=True)
class ResumeConfig:
    """Settings of `densecavoid train --resume`: the run's own, but for what is given here."""

    run_dir: Path
    """Folder of the run to go on with."""
    total_steps: int | None = None
    """Environment steps after which the run ends."""
    max_minutes: float | None = None
    """Minutes after which it ends all the same; 0 = no limit."""
    threads: int | None = None
    """Threads of torch; 0 = all cores."""


def _train(args: Sequence[str]) -> None:
    """train a policy with PPO in the paper's curriculum; --resume goes on with a run"""
    with needing_torch("training"):
        from densecavoid.learning.config import TrainConfig
        from densecavoid.learning.peers import PeerLostError
        from densecavoid.learning.ppo import TrainingDivergedError
        from densecavoid.learning.run import resume, train
    try:
        if "--resume" in args:
            rest = [arg for arg in args if arg != "--resume"]
            again = tyro.cli(ResumeConfig, prog="densecavoid train --resume", args=rest)
            result = resume(again.run_dir, again.total_steps, again.max_minutes, again.threads)
        else:
            config = tyro.cli(TrainConfig, prog="densecavoid train", args=args)
            result = train(config)
    except (PeerLostError, TrainingDivergedError) as error:
        raise ValueError(str(error)) from None
    if os.environ.get("RANK", "0") == "0":  # under torchrun, the first process speaks for all
        print(f"{result.steps:,} steps, stage {result.stage} at level {result.level:.1f} -> {result.policy}")


def _train_detector(args: Sequence[str]) -> None:
    """train the depth detector on simulated worlds; the same command goes on with an interrupted run"""
    with needing_torch("training"):
        from densecavoid.learning.train_detector import TrainDetectorConfig, train_detector
    config = tyro.cli(TrainDetectorConfig, prog="densecavoid perceive train-detector", args=args)
    card = train_detector(config)
    print(f"average precision {card.training['check_ap50']:.3f} in other training worlds -> {config.out}/detector.onnx")


@dataclass(frozen=True)
class ImportDarknetConfig:
    """Settings of `densecavoid perceive import-darknet`."""

    weights: Path
    """Darknet's .weights file, COCO's of YOLOv3 for example."""
    out: Path = Path("yolov3.onnx")
    """Where the ONNX file goes."""
    configuration: str = "yolov3"
    """Which network they are of: yolov3, yolov3-tiny, or a .cfg file."""
    size: int | None = None
    """Sides of the network's input, a multiple of 32; else the configuration's."""


def _import_darknet(args: Sequence[str]) -> None:
    """turn Darknet weights for colour images into an ONNX file that finds people"""
    with needing_torch("importing"):
        from densecavoid.perception.detector.export import import_darknet
    config = tyro.cli(ImportDarknetConfig, prog="densecavoid perceive import-darknet", args=args)
    size = None if config.size is None else (config.size, config.size)
    import_darknet(config.weights, config.out, config.configuration, size)
    print(config.out)


def _train_legs(args: Sequence[str]) -> None:
    """train the classifier of legs in lidar scans"""
    from densecavoid.perception.leg_training import LegTrainingConfig, train_legs

    config = tyro.cli(LegTrainingConfig, prog="densecavoid perceive train-legs", args=args)
    train_legs(config)
    print(config.out)


def _train_predictor(args: Sequence[str]) -> None:
    """train what foresees where people will be; a run that was cut off goes on"""
    with needing_torch("training"):
        from densecavoid.learning.train_predictor import TrainPredictorConfig, train_predictor
    print(train_predictor(tyro.cli(TrainPredictorConfig, prog="densecavoid perceive train-predictor", args=args)))


def _fit_error_model(args: Sequence[str]) -> None:
    """watch the detector at work and fit the errors that training gives true boxes"""
    from densecavoid.perception.evaluation.error_fit import ErrorFit, fit_detector_errors

    config = tyro.cli(ErrorFit, prog="densecavoid perceive fit-error-model", args=args)
    print(f"{fit_detector_errors(config).source} -> {config.out}")


def _evaluate_perception(args: Sequence[str]) -> None:
    """measure detector, tracker, legs, predictors, prediction frame: tables, JSON and pictures"""
    from densecavoid.baselines import GoToGoal
    from densecavoid.perception.evaluation.report import EvaluateConfig, evaluate

    evaluate(tyro.cli(EvaluateConfig, prog="densecavoid perceive evaluate", args=args), GoToGoal())


PERCEIVE: dict[str, Verb] = {
    "train-detector": _train_detector,
    "import-darknet": _import_darknet,
    "train-legs": _train_legs,
    "train-predictor": _train_predictor,
    "fit-error-model": _fit_error_model,
    "evaluate": _evaluate_perception,
}
"""What `densecavoid perceive` can do."""


def _perceive(args: Sequence[str]) -> None:
    """train and evaluate what sees, tracks and predicts people"""
    run_verb("densecavoid perceive", PERCEIVE, args)


def _export(args: Sequence[str]) -> None:
    """write the folder that robots run"""
    from densecavoid.robot.verbs import export

    export(args)


def _robot(args: Sequence[str]) -> None:
    """drive a robot: the ROS 1 node, the ROS 2 node, the fault campaign"""
    from densecavoid.robot.verbs import robot

    robot(args)


def _replay(args: Sequence[str]) -> None:
    """run a recording (.bag, .mcap, .db3) through the robot's loop, and film it"""
    from densecavoid.robot.verbs import replay
    from densecavoid.viz.replay_film import film_replay

    replay(args, film_replay)


VERBS: dict[str, Verb] = {
    "run": _run,
    "train": _train,
    "benchmark": _benchmark,
    "perceive": _perceive,
    "export": _export,
    "robot": _robot,
    "replay": _replay,
}


def _usage() -> str:
    verbs = "\n".join(f"  {name:10} {verb.__doc__}" for name, verb in VERBS.items())
    return f"usage: densecavoid VERB [options]\n\n{verbs}\n\n`densecavoid VERB --help` lists the options of a verb."


def main(argv: Sequence[str] | None = None) -> int:
    """The `densecavoid` command.

    Returns:
        0; 2 for a wrong argument or input, with one line that says what is wrong; 130 after Ctrl-C.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in ("-h", "--help"):
        print(_usage())
        return 0
    if args[0] not in VERBS:
        print(f"densecavoid: unknown verb {args[0]!r}\n\n{_usage()}", file=sys.stderr)
        return 2
    try:
        VERBS[args[0]](args[1:])
    except (ValueError, OSError) as error:
        text = f"[bold red]densecavoid {args[0]}:[/] {escape(str(error))}"  # an error's own [brackets] are no markup
        Console(stderr=True, soft_wrap=True).print(text, highlight=False)
        return 2
    except KeyboardInterrupt:
        return 130
    except SystemExit as stop:  # tyro has printed the help, or what is wrong with the arguments
        return stop.code if isinstance(stop.code, int) else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
