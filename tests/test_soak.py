"""A short version of `make soak`: what is killed and run again ends as if nobody had touched it."""

import pytest
import soak

from hybrid_id.machines import experiments as plans

ELSEWHERE = "diagnose", "ablate"  # which tests/diagnosis/test_keep.py and tests/cli/test_ablate.py stop
SHORT = [name for name in soak.JOBS if name not in ELSEWHERE]


@pytest.mark.parametrize("name", SHORT)
def test_killed_and_run_again_ends_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "CASES", 2)
    monkeypatch.setattr(soak, "REPEATS", 1)
    monkeypatch.setattr(soak, "SETS", 3)
    monkeypatch.setattr(soak, "LONG", 1)
    monkeypatch.setattr(soak, "SAMPLES", 150)
    monkeypatch.setattr(plans, "LENGTHS", (700, 900))
    kills = 0
    for seed in (
        0,
        3,
    ):  # the second kills sooner: a computer that has become faster may have ended before the first
        failures, met = soak.soak(name, trials=1, seed=seed, most=1)
        kills += met
        assert failures == 0
        if kills:
            break
    assert kills == 1
