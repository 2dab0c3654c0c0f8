"""A short version of `make soak`: what is killed and run again ends as if nobody had touched it."""

import pytest
import soak


@pytest.mark.parametrize("name", soak.JOBS)
def test_killed_and_run_again_ends_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "CASES", 2)
    assert soak.soak(name, trials=1, seed=0, most=1) == 0
