"""Networks' cards with one value replaced by another: read, or refused. Bytes alone (`targets`) seldom stay JSON."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from targets import TARGETS, quiet

NUMBERS = st.one_of(st.integers(-3, 3), st.integers(), st.sampled_from([10**6, 10**12, 10**400]), st.floats())
LEAF = st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=8))
VALUE = st.one_of(LEAF, st.lists(LEAF, max_size=4), st.dictionaries(st.text(max_size=4), LEAF, max_size=2))


def places(values: Any, so_far: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys that lead to each value."""
    if so_far:
        yield so_far
    for key in values if isinstance(values, dict) else range(len(values)) if isinstance(values, list) else ():
        yield from places(values[key], (*so_far, key))


@pytest.mark.parametrize("name", ["policy-card", "detector-card", "predictor-card"])
def test_cards_with_another_value_are_read_or_refused(name: str) -> None:
    target = TARGETS[name]
    if target.missing:
        pytest.skip(f"needs {', '.join(target.missing)}")
    seeds = target.seeds()
    everywhere = [(seed, place) for seed in seeds for place in places(json.loads(seed))]

    @settings(max_examples=150 * len(seeds), deadline=None)
    @given(at=st.sampled_from(everywhere), value=VALUE)
    def check(at: tuple[bytes, tuple[Any, ...]], value: Any) -> None:
        seed, place = at
        card = json.loads(seed)
        inner = card
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        with quiet():
            target.run(json.dumps(card).encode())

    check()


@pytest.mark.parametrize(
    ("section", "change"),
    [("lidar", {"num_rays": 10**12}), ("camera", {"width": 10**6, "height": 10**6}), ("lidar", "a text")],
)
def test_sensors_that_would_only_take_memory_are_refused(section: str, change: Any) -> None:
    """A text, and a million million rays: a fuzzer found that neither was refused."""
    target = TARGETS["policy-card"]
    if target.missing:
        pytest.skip(f"needs {', '.join(target.missing)}")
    card = json.loads(target.seeds()[0])
    observation = card["observation"]
    observation[section] = observation[section] | change if isinstance(change, dict) else change
    assert not target.run(json.dumps(card).encode())


def test_a_network_that_its_file_has_no_tensors_for_takes_no_memory() -> None:
    target = TARGETS["safetensors"]
    if target.missing:
        pytest.skip(f"needs {', '.join(target.missing)}")
    seed = target.seeds()[0]
    (size,) = struct.unpack("<Q", seed[:8])
    header = json.loads(seed[8 : 8 + size])
    card = json.loads(header["__metadata__"]["densecavoid.policy"])
    card["network"]["lidar_layers"][0]["filters"] = 10**12
    header["__metadata__"]["densecavoid.policy"] = json.dumps(card)
    content = json.dumps(header).encode()
    assert not target.run(struct.pack("<Q", len(content)) + content + seed[8 + size :])


def test_an_input_that_is_a_single_number_is_refused() -> None:
    """A fuzzer's file: the graph's inputs were taken to have rows."""
    onnx = pytest.importorskip("onnx")
    target = TARGETS["onnx"]
    model = onnx.load_from_string(target.seeds()[0])
    del model.graph.input[2].type.tensor_type.shape.dim[:]
    assert not target.run(model.SerializeToString())
