"""How far a fit has come, with the time that is left, and a first Ctrl-C that keeps what is done."""

import signal
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from hybrid_id.cli.console import err, remark

STAGES = {"windows": "short windows", "records": "whole records"}


def counting(noun: str) -> Progress:
    """Bar on stderr for pieces of work that are done one by one, with the time that is left."""
    console = err()
    columns = (
        TextColumn(noun),
        BarColumn(24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, disable=not console.is_terminal)


class FitProgress:
    """Bar on stderr while a fit runs; an instance is what `identify` takes as `progress`.

    The first Ctrl-C asks the fit to end with the values that it has; the second one ends the command.

    Args:
        n_sets: parameter sets that are fitted.
        max_iterations: of a stage.
        polite: whether the first Ctrl-C is taken here; not where the fit itself takes it.

    Attributes:
        stopped: whether the user asked the fit to end.
        cut: whether he did so before the fit had ended by itself.
        flag: file that is made then, for other processes to see.
    """

    def __init__(self, n_sets: int, max_iterations: int, *, polite: bool = True) -> None:
        self._polite = polite
        self.n_sets, self.max_iterations, self.stopped = n_sets, max_iterations, False
        self.cut = False
        console = err()
        columns = (TextColumn("{task.description}"), BarColumn(24), TextColumn("{task.fields[left]}"))
        self._bar = Progress(*columns, TimeElapsedColumn(), console=console, disable=not console.is_terminal)
        self._task = self._bar.add_task("start", total=n_sets, left="")
        self._last = (0, 0.0)
        self._before: Any = None
        self.flag: Path | None = None

    def __enter__(self) -> "FitProgress":
        self._bar.start()
        if self._polite and threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()
        self._bar.stop()

    def __call__(self, stage: str, iteration: int, cost: Any, running: Any) -> bool:
        """Show one iteration; whether the fit shall end."""
        now, going = time.monotonic(), len(running)
        self.n_sets = max(self.n_sets, going)  # several start points are sets too
        before, then = self._last
        seconds = (now - then) / (iteration - before) if 0 < before < iteration else 0.0
        self._last = (iteration, now)
        left = f"at most {seconds * (self.max_iterations - iteration):.0f} s left" if seconds else ""
        words = f"{STAGES.get(stage, stage)}, iteration {iteration}, {going} of {self.n_sets} sets to go"
        self._bar.update(
            self._task, description=words, left=left, total=self.n_sets, completed=self.n_sets - going
        )
        self.cut |= self.stopped
        return self.stopped

    def say(self, words: str) -> None:
        """Show what is being done after the fit."""
        self._bar.update(self._task, description=words, left="", total=None)

    def _interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        self.stopped = True
        self._restore()
        if self.flag is not None:
            self.flag.touch()
            self.cut = True
        remark(
            "stopping after this iteration with the values so far; press Ctrl-C again to leave without results"
        )

    def _restore(self) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            self._before = None
