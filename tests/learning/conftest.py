"""A network small enough to train inside a test, and the environment it fits."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).parent))

if TYPE_CHECKING:
    from densecavoid.policy.network import NetworkConfig


@pytest.fixture
def tiny_network() -> NetworkConfig:
    pytest.importorskip("torch")
    from small_network import TINY

    return TINY
