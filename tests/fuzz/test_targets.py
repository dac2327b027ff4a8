"""What the fuzzer runs for minutes, for a moment and without it: seeds are read, and damage is refused as damage is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from targets import TARGETS, quiet

MOST_BYTES = 5_000
"""Damage is done to the beginning of larger files, where sizes and names are."""


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_are_read_and_damaged_ones_are_read_or_refused(name: str) -> None:
    target = TARGETS[name]
    if target.missing:
        pytest.skip(f"needs {', '.join(target.missing)}")
    rng = np.random.default_rng(5)
    seeds = target.seeds()
    with quiet():
        # The tensors of these seeds are too few for their cards: reading all weights would take too long.
        assert all(target.run(seed) for seed in seeds) or name == "safetensors"
        assert not target.run(b"")
        assert not target.run(rng.bytes(200))
        for count in range(16):
            bad = bytearray(seeds[count % len(seeds)])
            if count % 4 == 0:
                bad = bad[: int(rng.integers(len(bad)))]
            for place in rng.integers(0, max(1, min(len(bad), MOST_BYTES)), 1 + count):
                bad[place : place + 1] = rng.bytes(1)
            target.run(bytes(bad))


def test_the_command_says_what_it_did_or_why_not(tmp_path: Path) -> None:
    command = [
        sys.executable,
        str(Path(__file__).parent / "run.py"),
        "darknet",
        "--seconds",
        "1",
        "--out",
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(("darknet: no fault in ", "skipped: atheris is not installed"))
