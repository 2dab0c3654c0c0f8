"""What the commands print: results to stdout; remarks, progress and the time that is left to stderr."""

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment

from hybrid_id.errors import shown

WIDTH = 120  # where the output goes into a file or a pipe
TIMED = 10
"""Fits by whose time that of a search is guessed."""
ONE, EACH, LONG = 2.0, 4.0, 60.0
"""Time of a whole step, and of a search's step for each effect, over that of its fits if all took as long as the first
ones (seen on three machines: 2.0 to 3.6, and 0.7 to 4); seconds from which a search is long."""
STAGES = {"windows": "short windows", "records": "whole records"}


class Screen(Console):
    """A console that obeys no name: what a file or a program says may hold escape sequences."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Segments of what is printed; a question mark stands for each control character in words."""
        for one in super().render(renderable, options):
            yield one if one.control else Segment(shown(one.text, lines=True), one.style)


def console(*, stderr: bool = False) -> Screen:
    """Console for results, or for what is said beside them, so that stdout can be piped."""
    stream = sys.stderr if stderr else sys.stdout
    return Screen(stderr=stderr, highlight=False, emoji=False, width=None if stream.isatty() else WIDTH)


def show(*parts: RenderableType) -> None:
    """Print results; words in brackets are words and no markup."""
    out = console()
    for part in parts:
        out.print(part, markup=False, soft_wrap=isinstance(part, str))


def remark(sentence: str) -> None:
    """Say something beside the result."""
    console(stderr=True).print(sentence, markup=False, soft_wrap=True, style="dim")


def show_json(command: str, result: Mapping[str, Any]) -> None:
    """Print a result as JSON and nothing else."""
    from hybrid_id.reporting.results import as_json

    show(as_json(command, result))


def bar(*columns: Any) -> Progress:
    """A bar on stderr, unless that goes into a file or a pipe."""
    err = console(stderr=True)
    return Progress(*columns, console=err, disable=not err.is_terminal)


def counting(noun: str) -> Progress:
    """Bar for pieces of work that are done one by one, with the time that is left."""
    return bar(
        TextColumn(noun), BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )


@contextmanager
def doing(prefix: str = "") -> Iterator[Callable[..., None]]:
    """Bar over stages, and once it is known how long one takes that takes long, a sentence that says so.

    Yields:
        What is called with the stage in words, and where it has steps, with how many are done and of how many at most.
    """
    stage, since = "", 0.0
    with bar(
        TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn(), TimeRemainingColumn()
    ) as progress:
        task = progress.add_task("", total=None)

        def say(now: str, done: int = 0, total: int = 0) -> None:
            nonlocal stage, since
            if now != stage:
                stage, since = now, time.monotonic()
                progress.reset(task)
            left = (time.monotonic() - since) / max(done - 1, 1) * (total - done)
            if done == TIMED + 1 and left > LONG:
                progress.console.print(
                    f"{stage}: the fit takes {rough_time(left)} at most, a guess by its first {TIMED} steps",
                    style="dim", markup=False, soft_wrap=True,
                )  # fmt: skip
            words = prefix + stage + (f", {done} of at most {total}" if total > 1 else "")
            progress.update(task, description=words, completed=done, total=total if total > 1 else None)

        yield say


@contextmanager
def kept_pieces(noun: str, total: int, folder: Path) -> Iterator[Callable[..., None]]:
    """Show which pieces are done, and say after Ctrl-C how many are kept.

    Args:
        noun: what the pieces are.
        total: how many there are.
        folder: that keeps them.

    Yields:
        What is called with name and result of each piece, a :class:`hybrid_id.study.many.Failure` where it broke, and
        whether it is one of an earlier run.
    """
    from hybrid_id.study.many import Failure

    names: dict[bool, list[str]] = {True: [], False: []}
    try:
        with counting(noun) as bar:
            task = bar.add_task(noun, total=total)

            def done(name: str, result: Any, earlier: bool) -> None:
                broke = isinstance(result, Failure)
                names[broke].append(name)
                count = len(names[True]) + len(names[False])
                bar.update(task, completed=count)
                words = result.message if broke else f"{result.seconds:.1f} s"
                line = f"{count} of {total}: {name}, {'kept from before' if earlier else words}"
                bar.console.print(line, markup=False, soft_wrap=True, style="dim")

            yield done
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {len(names[False])} of {total} {noun} are kept in {folder}, and the same command goes on"
        ) from None
    if names[True]:
        remark(f"{len(names[True])} of {total} {noun} broke; the same command tries them again")


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM, by which machines and schedulers end a program, do what Ctrl-C does at that moment."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def terminate(_signal: int, frame: FrameType | None) -> None:
        answer = signal.getsignal(signal.SIGINT)
        (answer if callable(answer) else signal.default_int_handler)(signal.SIGINT, frame)

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _Stoppable:
    """A bar on stderr during which Ctrl-C is taken by ``_interrupt``, once: the next one ends the command as usual."""

    _bar: Progress
    _takes = True
    """Whether Ctrl-C is taken here."""
    _before: Any = None

    def __enter__(self) -> Self:
        self._bar.start()
        if self._takes and threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()
        self._bar.stop()

    def _interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        raise NotImplementedError

    def _restore(self) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            self._before = None


class FitProgress(_Stoppable):
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
        self._takes = polite
        self.n_sets, self.max_iterations, self.stopped = n_sets, max_iterations, False
        self.cut = False
        self._bar = bar(
            TextColumn("{task.description}"),
            BarColumn(24),
            TextColumn("{task.fields[left]}"),
            TimeElapsedColumn(),
        )
        self._task = self._bar.add_task("start", total=n_sets, left="")
        self._last = (0, 0.0)
        self.flag: Path | None = None

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

    def watch(self, flag: Path | None) -> None:
        """Take the file that ends the fits of other processes; None when they have ended."""
        self.flag = flag
        self.say("statistics" if flag is None else "fitting in several processes")

    def _interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        self.stopped = True
        self._restore()
        if self.flag is not None:
            self.flag.touch()
            self.cut = True
        remark(
            "stopping after this iteration with the values so far; press Ctrl-C again to leave without results"
        )


class SearchProgress(_Stoppable):
    """Bar on stderr while the catalogue is searched; an instance is what `diagnose` takes as `progress`.

    Once some fits are timed, it says how long a long search will take. Ctrl-C is answered at once, and ends the search.

    Args:
        max_effects: effects that are searched for at most.
        searches: one after the other, of the joints of a robot say.
        clock: tells the time [s].
    """

    def __init__(
        self, max_effects: int, searches: int = 1, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._searches = searches
        self._most, self._clock, self._since, self._said = max_effects, clock, 0.0, False
        self._bar = bar(
            TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn(), TimeRemainingColumn()
        )
        self._task = self._bar.add_task("nominal model", total=None)
        self._stage = ""
        # not by what a shell has put in its background
        self._takes = signal.getsignal(signal.SIGINT) != signal.SIG_IGN

    def _interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        self._restore()
        remark("stopping; what is complete is written next, and Ctrl-C again leaves that out, too")
        raise KeyboardInterrupt

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how many fits of a stage are done."""
        if stage != self._stage:
            self._stage, self._since = stage, self._clock()
            self._bar.reset(self._task, total=total)
        if done == TIMED + 1 and total > TIMED and not self._said:
            self._said = True
            # of a whole search, if its first step's fits took so long when all were short
            seconds = self._searches * total * (self._clock() - self._since) / TIMED
            least, most = ONE * seconds, EACH * self._most * seconds
            if most > LONG:
                of = "" if self._searches == 1 else f" of {self._searches} joints"
                low, high = rough_time(least), rough_time(most)
                words = f"{low} to {high}"
                if self._most > 1:
                    words = f"{low} if one effect explains the gap, and up to about {high} if it goes on to "
                    words += str(self._most)
                self._bar.console.print(
                    f"the search{of} will take about {words}: a guess by its first {TIMED} fits; Ctrl-C keeps what is "
                    "found",
                    style="dim", markup=False, soft_wrap=True,
                )  # fmt: skip
        words = f"{stage}, fit {done} of at most {total}" if total > 1 else stage
        self._bar.update(self._task, description=words, completed=done)


def rough_time(seconds: float) -> str:
    """A time as one says it."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.2g} {unit}" if seconds < 10 * size else f"{seconds / size:.0f} {unit}"
    return f"{max(seconds, 1.0):.0f} s"
