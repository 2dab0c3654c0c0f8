"""Pieces of work done one by one, in processes of this machine, or on a Dask cluster; a broken one loses no other."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from hybrid_id import __version__
from hybrid_id.errors import InputError, MachineError
from hybrid_id.reading import read_object
from hybrid_id.records.files import plain

TIMEOUT = 20.0
"""Time [s] within which a Dask scheduler has to answer."""

Work = Callable[[Any, Any], Any]
"""Takes what all pieces share and one piece, and returns its result."""


@dataclass(frozen=True)
class Failure:
    """What is left of a piece of work that broke: the reason in one line."""

    message: str


def sealed(result: Any, key: str) -> dict[str, Any]:
    """What is kept of a piece of work as JSON, with the key of all that decides it and a digest of what it holds."""
    result = plain(result)
    return {"program": f"hybrid_id {__version__}", "key": key, "seal": _digest(result), "result": result}


def unsealed(path: Path, key: str) -> Any:
    """The result that :func:`sealed` has kept; None where there is none, or one of other settings or edited."""
    try:
        content = read_object(path, "kept result")
        whole = content["key"] == key and content["seal"] == _digest(content["result"])
        return content["result"] if whole else None
    except (OSError, InputError, KeyError):
        return None


def _digest(result: Any) -> str:
    return hashlib.sha256(json.dumps(result).encode()).hexdigest()


def fan_out(
    work: Work, shared: Any, pieces: Sequence[Any], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, Any]]:
    """Yield the number of each piece and its result, or a :class:`Failure`, as soon as it is done.

    Args:
        work: a function of a module, so that other processes can import it.
        shared: what all pieces share.
        pieces: the second argument of each call.
        jobs: processes on this machine.
        scheduler: address of an existing Dask cluster, which is taken instead.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    if scheduler is not None:
        yield from _on_dask(work, shared, pieces, scheduler)
    elif jobs > 1:
        yield from _in_processes(work, shared, dict(enumerate(pieces)), jobs)
    else:
        yield from (_attempt(work, shared, k, piece) for k, piece in enumerate(pieces))


@contextmanager
def whole_pool(advice: str = "give fewer --jobs") -> Iterator[None]:
    """Say that a process of a pool was lost in one sentence, with what to do (a :class:`MachineError`)."""
    try:
        yield
    except BrokenProcessPool:
        raise MachineError(f"a process was lost, for want of memory, say; {advice}") from None


def leave_ctrl_c_to_the_first() -> None:
    """In a process of a pool, let the first one answer Ctrl-C and SIGTERM, which often go to all of them."""
    first = threading.main_thread()  # a worker of Dask, or of a pool in a pool, works in another thread
    if multiprocessing.parent_process() is not None and threading.current_thread() is first:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _attempt(work: Work, shared: Any, number: int, piece: Any) -> tuple[int, Any]:
    torch.set_num_threads(1)
    leave_ctrl_c_to_the_first()
    try:
        return number, work(shared, piece)
    except Exception as error:  # whatever breaks one piece must not take the others along
        return number, _failure(error)


def _failure(error: BaseException | None) -> Failure:
    if error is None:
        return Failure("its worker was lost")
    words = f"{type(error).__name__}: {error}".splitlines()[0]
    frames = traceback.extract_tb(error.__traceback__)
    if frames and not isinstance(error, InputError):  # a fault of the program: where to look
        last = Path(frames[-1].filename)
        words += f" ({last.parent.name}/{last.name}, line {frames[-1].lineno})"
    return Failure(words)


def _in_processes(work: Work, shared: Any, left: dict[int, Any], jobs: int) -> Iterator[tuple[int, Any]]:
    try:
        calls = [delayed(_attempt)(work, shared, k, piece) for k, piece in left.items()]
        found = Parallel(jobs, return_as="generator_unordered", pre_dispatch="n_jobs")(calls)
        for number, result in cast("Iterator[tuple[int, Any]]", found):
            del left[number]
            yield number, result
    except BrokenProcessPool:
        # a process was killed: what was at work gets pools of its own, which shows the guilty piece
        for number in list(left)[:jobs]:
            piece = left.pop(number)
            try:
                yield from cast(
                    "list[tuple[int, Any]]", Parallel(2)([delayed(_attempt)(work, shared, number, piece)])
                )
            except BrokenProcessPool as error:
                yield number, _failure(error)
        yield from _in_processes(work, shared, left, jobs)


def _on_dask(work: Work, shared: Any, pieces: Sequence[Any], address: str) -> Iterator[tuple[int, Any]]:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "The backend dask needs the package distributed; install hybrid-id[dask], or use --jobs."
        ) from None
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"No Dask scheduler answers at {address} ({reason}); start one there.") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"The Dask scheduler at {address} has no worker; start some with 'dask worker {address}'."
            )
        common = client.scatter(shared, broadcast=True, hash=False)
        futures = {
            client.submit(_attempt, work, common, k, piece, pure=False): k for k, piece in enumerate(pieces)
        }
        try:
            for future in as_completed(list(futures), loop=client.loop, raise_errors=False):
                done = future.status == "finished"
                yield future.result() if done else (futures[future], _failure(future.exception()))  # type: ignore[misc]
        finally:
            client.cancel(list(futures))
