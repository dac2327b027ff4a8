"""What a training run shows and logs: JSON lines, TensorBoard, and a live panel that becomes plain lines where there is
no terminal. It draws what it is given and computes nothing about learning.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text
from torch.utils.tensorboard import SummaryWriter


class MetricsLog:
    """One record an iteration, to JSON lines and TensorBoard alike. Owns both files."""

    def __init__(self, json_lines: Path, tensorboard: Path, purge_after: int | None = None) -> None:
        """
        Args:
            json_lines: file to append to.
            tensorboard: folder of event files.
            purge_after: hide what earlier event files hold beyond this step (when resuming).
        """
        self._file = json_lines.open("a")
        self._writer = SummaryWriter(str(tensorboard), purge_step=purge_after)

    def write(self, record: Mapping[str, Any]) -> None:
        """A flat mapping; `steps` is its abscissa. Numbers go to both logs, text to JSON alone."""
        self._file.write(json.dumps(record) + "\n")
        self._file.flush()
        for name, value in record.items():
            if name != "steps" and isinstance(value, int | float):
                self._writer.add_scalar(name, value, record["steps"])

    def close(self) -> None:
        self._writer.close()
        self._file.close()


@dataclass
class Progress:
    """What the panel shows. Filled by the trainer."""

    total_steps: int
    steps: int = 0
    steps_per_s: float = 0.0
    activity: str = "starting"
    stage: str = ""
    level: float = 0.0
    success: dict[str, tuple[float, int]] = field(default_factory=dict)
    """Scenario -> success rate and the number of episodes it rests on."""
    reward_terms: dict[str, float] = field(default_factory=dict)
    """Mean of each unscaled term a step."""
    learning: dict[str, float] = field(default_factory=dict)

    @property
    def time_left_s(self) -> float:
        """At the present speed; infinite before it is known."""
        return (self.total_steps - self.steps) / self.steps_per_s if self.steps_per_s > 0 else float("inf")


class Display:
    """Shows `Progress`: a live panel on a terminal, one line an iteration elsewhere. A context manager."""

    def __init__(self, progress: Progress, title: str, console: Console | None = None) -> None:
        self.progress = progress
        self.title = title
        self.console = console or Console()
        self._live = Live(console=self.console, auto_refresh=False) if self.console.is_terminal else None
        self._refreshed_s = 0.0

    def __enter__(self) -> Display:
        if self._live:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.__exit__(kind, error, traceback)

    def tick(self) -> None:
        """Cheap; redraws at most four times a second."""
        now = time.monotonic()
        if self._live and now - self._refreshed_s > 0.25:
            self._refreshed_s = now
            self._live.update(self._panel(), refresh=True)

    def iteration_done(self) -> None:
        """Redraws the panel, or prints the line."""
        if self._live:
            self._live.update(self._panel(), refresh=True)
        else:
            self.console.print(self._line(), highlight=False, soft_wrap=True)

    def message(self, text: str) -> None:
        """A line that stays."""
        self.console.print(text, highlight=False, soft_wrap=True)

    def _line(self) -> str:
        p = self.progress
        success = "  ".join(f"{name} {rate:.0%}" for name, (rate, _) in p.success.items())
        return (
            f"{p.steps:>10,}/{p.total_steps:,} steps  {p.steps_per_s:,.0f}/s  {_duration(p.time_left_s)} left  "
            f"stage {p.stage} level {p.level:.1f}  success: {success or 'no episode yet'}"
        )

    def _panel(self) -> Panel:
        p = self.progress
        head = Table.grid(padding=(0, 2))
        head.add_row(
            ProgressBar(total=p.total_steps, completed=p.steps, width=30),
            f"{p.steps:,} of {p.total_steps:,} steps",
            f"{p.steps_per_s:,.0f} steps/s",
            f"{_duration(p.time_left_s)} left",
        )
        stage = Text(f"stage {p.stage}, level {p.level:.1f} ({p.activity})")
        columns = Table.grid(padding=(0, 4))
        columns.add_row(
            _table("success", {name: f"{rate:.0%} of {count}" for name, (rate, count) in p.success.items()}),
            _table("reward a step", {name: f"{value:+.4f}" for name, value in p.reward_terms.items()}),
            _table("learning", {name: f"{value:.4g}" for name, value in p.learning.items()}),
        )
        return Panel(Group(head, stage, columns), title=self.title, subtitle="Ctrl-C saves and stops", expand=False)


def _table(title: str, rows: Mapping[str, str]) -> Table:
    table = Table(title=title, title_justify="left", box=None, show_header=False, padding=(0, 1))
    table.add_column(min_width=12)
    table.add_column(justify="right")
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _duration(seconds: float) -> str:
    if seconds == float("inf"):
        return "?"
    minutes = int(seconds // 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {int(seconds % 60):02d} s"
