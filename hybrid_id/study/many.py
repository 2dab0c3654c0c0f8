"""One function on many pieces, by joblib: in turn, in processes of this machine, or on a Dask cluster.

A piece that breaks, or that kills its process, is a :class:`Failure` and loses no other. Results are kept in files, so
that a command which was stopped goes on where it was.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import BrokenProcessPool
from pydantic import TypeAdapter

from hybrid_id import __version__
from hybrid_id.errors import InputError, MachineError
from hybrid_id.identification.keep import digest_of
from hybrid_id.reading import read_object
from hybrid_id.records.files import plain, write_json

TIMEOUT = 20.0
"""Time [s] within which a Dask scheduler has to answer."""
Result = TypeVar("Result")


@dataclass(frozen=True)
class Failure:
    """What is left of a piece of work that broke: the reason in one line."""

    message: str

    @classmethod
    def of(cls, error: BaseException) -> Failure:
        """Its kind and first line; for a fault of the program also where to look."""
        words = f"{type(error).__name__}: {error}".splitlines()[0]
        frames = traceback.extract_tb(error.__traceback__)
        if frames and not isinstance(error, InputError):
            last = Path(frames[-1].filename)
            words += f" ({last.parent.name}/{last.name}, line {frames[-1].lineno})"
        return cls(words)


def each(
    work: Callable[[Any, Any], Any],
    shared: Any,
    pieces: Sequence[Any],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
) -> Iterator[tuple[int, Any]]:
    """Yield the number of each piece and its result, or a :class:`Failure`, as soon as it is done.

    Args:
        work: takes what all pieces share and one piece; a function of a module, which other processes can import.
        shared: what all pieces share.
        pieces: the second argument of each call.
        jobs: processes on this machine.
        scheduler: address of an existing Dask cluster, which is taken instead.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    left = dict(enumerate(pieces))
    with _cluster(scheduler) as backend:

        def begun(numbers: Iterable[int], jobs: int) -> Any:
            calls = [delayed(_attempt)(work, shared, number, left[number]) for number in numbers]
            settings: dict[str, Any] = {"backend": backend, "pre_dispatch": "n_jobs", "batch_size": 1}
            return Parallel(jobs, return_as="generator_unordered", **settings)(calls)

        while left:
            try:
                for number, result in begun(left, jobs):
                    del left[number]
                    yield number, result
            except BrokenProcessPool:
                # a process was killed: what was at work gets pools of its own, which shows the guilty piece
                for number in list(left)[:jobs]:
                    try:
                        ((_, result),) = begun([number], 2)
                    except BrokenProcessPool as error:
                        result = Failure.of(error)
                    del left[number]
                    yield number, result


def _attempt(work: Callable[[Any, Any], Any], shared: Any, number: int, piece: Any) -> tuple[int, Any]:
    torch.set_num_threads(1)
    leave_ctrl_c_to_the_first()
    try:
        with parallel_config(backend="sequential"):  # else its own loops would go to the cluster, too
            return number, work(shared, piece)
    except Exception as error:  # whatever breaks one piece must not take the others along
        return number, Failure.of(error)


def leave_ctrl_c_to_the_first() -> None:
    """In a process of a pool, let the first one answer Ctrl-C and SIGTERM, which often go to all of them."""
    first = threading.main_thread()  # a worker of Dask, or of a pool in a pool, works in another thread
    if multiprocessing.parent_process() is not None and threading.current_thread() is first:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


@contextmanager
def whole_pool(advice: str = "give fewer --jobs") -> Iterator[None]:
    """Say that a process of a pool was lost in one sentence, with what to do (a :class:`MachineError`)."""
    try:
        yield
    except BrokenProcessPool:
        raise MachineError(f"a process was lost, for want of memory, say; {advice}") from None


@contextmanager
def _cluster(address: str | None) -> Iterator[Any]:
    """Joblib's back end on a Dask cluster; None without an address."""
    if address is None:
        yield None
        return
    try:
        from dask import config
        from distributed import Client
        from joblib._dask import DaskDistributedBackend
    except ImportError:
        raise InputError(
            "The backend dask needs the package distributed; install hybrid-id[dask], or use --jobs."
        ) from None
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"No Dask scheduler answers at {address} ({reason}); start one there.") from None

    class Backend(DaskDistributedBackend):
        """Joblib's, which waits for ever for a piece that has killed its workers: that one is a failure here."""

        def submit(self, func: Any, callback: Any = None) -> Any:
            future = super().submit(func, callback)

            def lost(done: Any) -> None:
                if (error := done.exception()) is not None:
                    ((_, (_, _, number, _), _),) = func.items
                    callback([(number, Failure.of(error))])

            future.add_done_callback(lost)
            return future

    # what all pieces share goes along with each: scattered, it would be lost with the workers that hold it
    with client, config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"The Dask scheduler at {address} has no worker; start some with 'dask worker {address}'."
            )
        try:
            yield Backend(client=client)
        except CancelledError:
            raise MachineError(
                f"The Dask scheduler at {address} was lost; once it is there again, the same command goes on."
            ) from None


def each_kept(
    work: Callable[[Any, Any], Result],
    shared: Any,
    pieces: Mapping[str, Any],
    *,
    kind: type[Result],
    files: Callable[[str], Path],
    key: Callable[[Any], object],
    jobs: int = 1,
    scheduler: str | None = None,
    done: Callable[[str, Result | Failure, bool], object] | None = None,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Compute what no earlier run has kept, and keep each result as soon as it is there, whole or not at all.

    Args:
        work: as in :func:`each`.
        shared: as there.
        pieces: by name.
        kind: dataclass of plain data, which all results are.
        files: where the result of a name is kept.
        key: all that decides a piece.
        jobs: as in :func:`each`.
        scheduler: as there.
        done: called with name and result of each piece, and whether it is one of an earlier run.

    Returns:
        The results by name, in the order of the pieces, and why others broke.
    """
    found: dict[str, Result] = {}
    failed: dict[str, str] = {}
    keys = {name: digest_of(key(piece)) for name, piece in pieces.items()}
    for name in pieces:
        if (result := kept(files(name), kind, keys[name])) is not None:
            found[name] = result
            if done is not None:
                done(name, result, True)
    left = [name for name in pieces if name not in found]
    for number, result in each(work, shared, [pieces[n] for n in left], jobs=jobs, scheduler=scheduler):
        name = left[number]
        if done is not None:
            done(name, result, False)
        if isinstance(result, Failure):
            failed[name] = result.message
            continue
        found[name] = result
        keep(files(name), result, keys[name])
    return {name: found[name] for name in pieces if name in found}, failed


def keep(file: Path, result: Any, key: str) -> None:
    """Write a dataclass of plain data or arrays for :func:`kept`, under the digest of all that decides it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    # the digest tells what somebody has edited from what was computed
    content = plain(asdict(result))
    seal = digest_of((key, content))
    write_json(file, {"program": f"hybrid_id {__version__}", "seal": seal, "result": content})


def kept(file: Path, kind: type[Result], key: str) -> Result | None:
    """A result that :func:`keep` has written; None where there is none, or one of another key or edited."""
    try:
        content = read_object(file, "kept result")
        if content["seal"] != digest_of((key, content["result"])):
            return None
        return TypeAdapter(kind).validate_python(content["result"])
    except (OSError, InputError, KeyError, ValueError):
        return None
