"""Who answers Ctrl-C, and what a process that is lost takes with it."""

import multiprocessing
import os
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from hybrid_id.study.fan_out import Failure, fan_out, leave_ctrl_c_to_the_first


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
    found = dict(fan_out(halved, 3, range(6), jobs=2))
    assert isinstance(found.pop(3), Failure)
    assert found == {k: k / 2 for k in (0, 1, 2, 4, 5)}
