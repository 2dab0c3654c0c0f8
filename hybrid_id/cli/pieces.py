"""Progress of a command that keeps its results piece by piece."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hybrid_id.cli.console import counting, remark


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
