"""Pieces in turn, in processes and on a real Dask cluster; lost ones; what is kept; who answers Ctrl-C."""

import json
import math
import multiprocessing
import os
import re
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest
from joblib import Parallel, delayed

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.study.many import Failure, each, each_kept, leave_ctrl_c_to_the_first


def test_only_the_main_thread_of_another_process_leaves_ctrl_c_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.getsignal(signal.SIGINT)
    leave_ctrl_c_to_the_first()
    assert signal.getsignal(signal.SIGINT) is before, "this is the first process"
    monkeypatch.setattr(multiprocessing, "parent_process", object)
    with ThreadPoolExecutor(1) as pool:  # as Dask's workers do; Python would refuse the signal there
        pool.submit(leave_ctrl_c_to_the_first).result()
    assert signal.getsignal(signal.SIGINT) is before
    try:
        leave_ctrl_c_to_the_first()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def halved(dies_at: int, number: int) -> float:
    if number == dies_at:
        os.kill(os.getpid(), signal.SIGKILL)
    return number / 2


def test_a_piece_that_kills_its_process_loses_no_other() -> None:
    found = dict(each(halved, 3, range(6), jobs=2))
    assert isinstance(found.pop(3), Failure)
    assert found == {k: k / 2 for k in (0, 1, 2, 4, 5)}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    distributed = pytest.importorskip("distributed", reason="needs distributed (hybrid-id[dask])")
    dask = pytest.importorskip("dask")
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    once = {
        "distributed.scheduler.allowed-failures": 0
    }  # workers that a piece may kill before it is given up
    with dask.config.set(once), distributed.LocalCluster(**settings) as cluster:
        yield cluster.scheduler_address


def nested(_: None, number: int) -> list[float]:
    """With a loop of its own, which must not wait for workers that are all taken."""
    return Parallel(n_jobs=1)(delayed(math.sqrt)(number) for _ in range(3))


def test_a_dask_cluster_comes_to_the_same(address: str) -> None:
    in_turn = dict(each(nested, None, range(6)))
    assert (
        dict(each(nested, None, range(6), scheduler=address))
        == in_turn
        == dict(each(nested, None, range(6), jobs=2))
    )


def test_a_piece_that_kills_its_workers_on_a_cluster_loses_no_other(address: str) -> None:
    found = dict(each(halved, 3, range(6), scheduler=address))
    assert found.pop(3).message.startswith("KilledWorker: ")
    assert found == {k: k / 2 for k in (0, 1, 2, 4, 5)}


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs distributed (hybrid-id[dask])")
    monkeypatch.setattr("hybrid_id.study.many.TIMEOUT", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://"):
        with pytest.raises(InputError, match="No Dask scheduler answers"):
            list(each(halved, 3, range(2), scheduler=address))


@dataclass
class Half:
    value: float
    seconds: float = 0.0


def half(breaks_at: int, number: int) -> Half:
    if number == breaks_at:
        raise ValueError("no luck\nat all")
    return Half(number / 2)


def test_what_is_kept_is_found_again_and_nothing_else(tmp_path: Path) -> None:
    """Of the same key, whole, and not edited; a broken piece is tried again."""

    def run(breaks_at: int, version: int = 1) -> tuple[dict, dict, list[str]]:
        new = []
        results, failed = each_kept(
            half, breaks_at, {f"n{k}": k for k in (1, 2, 3, 4)}, kind=Half,
            files=lambda name: tmp_path / name / "half.json", key=lambda piece: (version, piece),
            done=lambda name, _, earlier: None if earlier else new.append(name),
        )  # fmt: skip
        return results, failed, new

    results, failed, new = run(3)
    assert list(results) == ["n1", "n2", "n4"] and new == ["n1", "n2", "n3", "n4"]
    assert re.fullmatch(r"ValueError: no luck \(study/test_many\.py, line \d+\)", failed["n3"])
    assert run(0)[1:] == ({}, ["n3"]) and run(0)[2] == []
    kept = tmp_path / "n2" / "half.json"
    content = json.loads(kept.read_text())
    assert content["program"] == f"hybrid_id {__version__}"
    for text in (json.dumps(content | {"result": {"value": 7.0, "seconds": 0.0}}), "{half a "):
        kept.write_text(text)
        assert run(0)[::2] == ({f"n{k}": Half(k / 2) for k in (1, 2, 3, 4)}, ["n2"])
    assert run(0, version=2)[2] == ["n1", "n2", "n3", "n4"]
