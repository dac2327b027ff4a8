"""Time of perception for one robot among 15 people, beside YOLOv3 at 416 pixels on the same core.

python benchmarks/perception.py [--json FILE] [--seconds 10] [--predictor NAME]
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np

from densecavoid.env import DenseCAvoidVectorEnv, ObserverConfig
from densecavoid.frames import Command, SensorFrame
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.pipeline import PeoplePipeline, expect_people
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator
from simulator import median_us

PEOPLE, WIDEST_DEG, FAR_M, NEAR_M = 15, 66.0, 3.5, 2.7
"""Bearing of the outermost; distance of every other person, and of those in the gaps between them."""
FRAMES, LAST = 70, 25
"""Of a look around, and the last ones, for which times count."""
WORLDS = 64
PARTS = ("detect", "legs", "track", "predict", "draw")
ALL = np.ones(1, np.bool_)


class Arc:
    """Fifteen people about the robot, ahead and to the sides, all walking slowly away."""

    name = "arc"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        plan.room(-2.0, -8.0, 10.0, 8.0)
        bearing = np.radians(np.linspace(-WIDEST_DEG, WIDEST_DEG, PEOPLE))
        distance = np.where(np.arange(PEOPLE) % 2, NEAR_M, FAR_M)
        way = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        pos, count = distance[:, None] * way, PEOPLE
        kind, speed = np.full(count, TRAVERSING), np.full(count, 0.15)
        radius, height = rng.uniform(0.22, 0.28, count), rng.uniform(1.6, 1.8, count)
        crowd = Crowd(pos, pos + 3.0 * way, speed, radius, height, kind)
        return WorldSpec(self.name, plan, (0.0, 0.0, 0.0), (9.0, 0.0), crowd)


def record_frames() -> list[SensorFrame]:
    """What a robot with real sensors sees that looks to the left, to the right and ahead again."""
    simulator = Simulator(Arc(), 1, SimConfig(sensors="real", threads=1))
    simulator.reset(np.zeros(1, np.int64))
    frames = []
    for k in range(FRAMES):
        frame = simulator.sense()
        copies = {name: getattr(frame, name).copy() for name in ("scan_m", "depth_m", "odom_pose", "velocity")}
        frames.append(dataclasses.replace(frame, truth=None, **copies))
        turn = 0.4 if k < FRAMES // 4 or k >= 3 * FRAMES // 4 else -0.4
        simulator.step(Command(np.zeros(1, np.float32), np.full(1, turn, np.float32)))
    return frames


def time_pipeline(frames: list[SensorFrame], predictor: str, seconds: float) -> tuple[dict[str, float], float]:
    """Median milliseconds of each part and of the whole, and how many people are followed (mean)."""
    config = PerceptionConfig(people_from="detector", predictor=predictor, threads=1)  # type: ignore[arg-type]
    pipeline = PeoplePipeline(config, 1)
    assert pipeline.source is not None
    times: list[list[float]] = []
    followed: list[int] = []
    end = process_time() + seconds
    rounds = 0
    while rounds < 3 or process_time() < end:
        pipeline.reset(ALL)
        for number, frame in enumerate(frames):
            marks = [process_time()]
            found = pipeline.source.find(frame, ALL)
            marks.append(process_time())
            legs = pipeline.find_legs(frame, ALL)
            marks.append(process_time())
            tracks = pipeline.track(frame, found, legs, ALL)
            marks.append(process_time())
            expected = expect_people(tracks, pipeline.predictor, config.horizons_s, ALL)
            marks.append(process_time())
            pipeline.draw(frame, expected, ALL)
            marks.append(process_time())
            if rounds > 0 and number >= FRAMES - LAST:  # compiled, and everybody is followed
                times.append([1e3 * (b - a) for a, b in itertools.pairwise(marks)])
                followed.append(int(tracks.confirmed[0].sum()))
        rounds += 1
    table = np.array(times)
    parts = {f"{part}_ms": median(table[:, k].tolist()) for k, part in enumerate(PARTS)}
    return parts | {"pipeline_ms": median(table.sum(axis=1).tolist())}, float(np.mean(followed))


def time_yolov3(seconds: float) -> dict[str, float]:
    """Median milliseconds of a pass of the published networks at 416 pixels, random weights, one thread each.

    Returns:
        `yolov3_416_ms`, `yolov3_tiny_416_ms` (ONNX Runtime), and the same `_opencv_ms`; empty without torch and onnx,
        which write the networks' files, and without OpenCV for those of OpenCV.
    """
    try:
        from densecavoid.perception.detector.export import import_darknet
    except ModuleNotFoundError as error:
        print(f"YOLOv3: skipped, {error.name} is not installed")
        return {}
    import onnxruntime

    from densecavoid.perception.detector.darknet_config import load_config, read_config_text
    from densecavoid.perception.detector.darknet_weights import num_weights

    results: dict[str, float] = {}
    rng, options = np.random.default_rng(0), onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    image = rng.random((1, 3, 416, 416), np.float32)
    for name in ("yolov3", "yolov3-tiny"):
        key = name.replace("-", "_") + "_416"
        with tempfile.TemporaryDirectory() as folder:
            weights, graph = Path(folder) / f"{name}.weights", Path(folder) / f"{name}.onnx"
            numbers = rng.uniform(0.0, 0.02, num_weights(load_config(name))).astype("<f4")
            weights.write_bytes(np.array([0, 2, 0, 0, 0], "<i4").tobytes() + numbers.tobytes())
            import_darknet(weights, graph, name, (416, 416))
            session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])

            def run(session: onnxruntime.InferenceSession = session) -> object:
                return session.run(None, {"images": image})

            results[f"{key}_ms"] = median_us(run, seconds / 2) / 1e3
            opencv = _opencv_pass(name, read_config_text(name), weights, image)
            if opencv is not None:
                results[f"{key}_opencv_ms"] = median_us(opencv, seconds / 2) / 1e3
    return results


def _opencv_pass(name: str, text: str, weights: Path, image: np.ndarray) -> Callable[[], object] | None:
    try:
        import cv2
    except ModuleNotFoundError:
        return None
    cv2.setNumThreads(1)
    configuration = weights.with_suffix(".cfg")
    configuration.write_text(text, encoding="utf-8")
    try:
        network = cv2.dnn.readNetFromDarknet(str(configuration), str(weights))
    except (cv2.error, AttributeError) as error:
        print(f"OpenCV's {name}: skipped, {str(error).splitlines()[0]}")
        return None

    def run() -> object:
        network.setInput(image)
        return network.forward(network.getUnconnectedOutLayersNames())

    return run


def training_speed(seconds: float) -> dict[str, float]:
    """Environment steps a second on one thread: nobody perceived, exact places, the detector's errors with legs; and
    what perception then costs a world, microseconds. All in turns, so that the machine is the same for all."""
    rng = np.random.default_rng(0)
    actions = rng.uniform([0.0, -0.4], [1.0, 0.4], (64, WORLDS, 2)).astype(np.float32)
    sim = SimConfig(sensors="real", threads=1)
    envs = {}
    for people_from in ("nothing", "truth", "boxes"):
        observer = ObserverConfig(people_from=people_from, threads=1)
        envs[people_from] = DenseCAvoidVectorEnv("dense-ped", WORLDS, sim, observer, seed=1)
        envs[people_from].reset()
    times: dict[str, list[float]] = {name: [] for name in envs}
    end, k = process_time() + seconds, 0
    while k < 30 or process_time() < end:
        for name, env in envs.items():
            start = process_time()
            env.step(actions[k % len(actions)])
            times[name].append(process_time() - start)
        k += 1
    cost = {name: median(values[20:]) / WORLDS * 1e6 for name, values in times.items()}
    rates = {f"steps_per_second_{name}": 1e6 / us for name, us in cost.items()}
    perception = {f"perception_{name}_us": cost[name] - cost["nothing"] for name in ("truth", "boxes")}
    return rates | perception | {"boxes_to_truth": cost["truth"] / cost["boxes"]} | _parts_of_a_step()


def _parts_of_a_step() -> dict[str, float]:
    """What the parts of perception cost a world in training, microseconds."""
    sim = Simulator(DenseCAvoidVectorEnv("dense-ped", 1).scenario, WORLDS, SimConfig(sensors="real", threads=1))
    sim.reset(np.arange(WORLDS))
    which = np.ones(WORLDS, np.bool_)
    pipeline = PeoplePipeline(PerceptionConfig(people_from="boxes", threads=1), WORLDS)
    source = pipeline.source
    assert source is not None
    frame = sim.sense()
    for _ in range(20):
        pipeline.update(frame, which)
        sim.step(Command(np.full(WORLDS, 0.3, np.float32), np.zeros(WORLDS, np.float32)))
        frame = sim.sense()
    found, legs = source.find(frame, which), pipeline.find_legs(frame, which)
    expected = expect_people(pipeline.tracks, pipeline.predictor, (0.8,), which)
    calls: dict[str, Callable[[], object]] = {
        "boxes": lambda: source.find(frame, which),
        "legs": lambda: pipeline.find_legs(frame, which),
        "track": lambda: pipeline.track(frame, found, legs, which),
        "predict": lambda: expect_people(pipeline.tracks, pipeline.predictor, (0.8,), which),
        "draw": lambda: pipeline.draw(frame, expected, which),
    }
    return {f"training_{name}_us": median_us(call, 0.5) / WORLDS for name, call in calls.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", type=Path, help="where to write the results")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--predictor", default=PerceptionConfig().predictor)
    arguments = parser.parse_args()
    results, followed = time_pipeline(record_frames(), arguments.predictor, arguments.seconds)
    parts = ", ".join(f"{part} {results[f'{part}_ms']:.3f}" for part in PARTS)
    print(
        f"pipeline ({arguments.predictor}, {followed:.1f} people followed): {results['pipeline_ms']:.2f} ms ({parts})"
    )
    theirs = time_yolov3(arguments.seconds)
    for name, value in theirs.items():
        print(f"{name.removesuffix('_ms')}: {value:.1f} ms")
    training = training_speed(arguments.seconds)
    print(
        f"training, {WORLDS} worlds on one thread: {training['steps_per_second_boxes']:,.0f} steps/s with boxes, "
        f"{training['steps_per_second_truth']:,.0f} with truth: {training['boxes_to_truth']:.2f} of it"
    )
    print(", ".join(f"{name} {value:.1f}" for name, value in training.items() if name.endswith("_us")))
    if arguments.json:
        machine = {"machine": platform.processor() or platform.machine(), "python": platform.python_version()}
        values = {name: round(value, 4) for name, value in {**results, **theirs, **training}.items()}
        text = json.dumps(values | {"people_followed": round(followed, 1)} | machine, indent=1)
        arguments.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
