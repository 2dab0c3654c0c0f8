"""Residual tests in words and numbers: one sentence an output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.reporting.tables import capital, count
from hybrid_id.reporting.units import title
from hybrid_id.statistics.residuals import LEVEL, ResidualTest

Residuals = Mapping[str, Sequence[ResidualTest]]
"""Tests of every output by what they are of: models, or roles of records."""
FAINT = 0.5
"""RMS over the noise up to which colour is sooner that of an encoder's counts than of something missing."""
LABELS = {
    "train": "records it was fitted to",
    "test": "test records",
    "re-fitted": "re-fitted model",
    "corrected": "corrected model",
    "physics": "physics alone",
    "hybrid": "physics with networks",
}
_COLOURS = {"white": "green", "nearly white": "green", "not white": "yellow", "diverged": "red"}
_HOW = (
    "Residuals of free runs, measured minus simulated. Those of a right model are noise: no sample predicts the next "
    f"one, no input what comes after it. White says that both tests pass at {100 * LEVEL:.0f} %; nearly white, that "
    "neighbours correlate surely, but by no more than 0.1 (1 is a smooth curve). All numbers are in the results' JSON."
)
_DIFFER = (
    "The residuals of the records that it was fitted to are noise, those of the test records are not: parameters that "
    "differ from record to record, or a motion that these records do not have."
)


def sound(tests: Sequence[ResidualTest]) -> bool:
    """Whether the residual is noise, or next to it, at every output."""
    return all(one.verdict in ("white", "nearly white") for one in tests)


def residual_blocks(
    residuals: Residuals, dataset: Dataset | None = None, channels: Sequence[Channel] = ()
) -> list[RenderableType]:
    """What is said of residuals: a sentence each, and how to read it.

    Args:
        residuals: the tests.
        dataset: whose test records, or else train records, were simulated, where the names of the tests do not say it.
        channels: outputs and inputs, which may know the names of their joints.
    """
    words: list[RenderableType] = []
    if dataset is not None:
        role = "test" if dataset.test else "train"
        words.append(Text(f"On {count(len(dataset.test or dataset.train), f'{role} record')}:"))
    words += [
        Text(
            f"{capital(LABELS.get(name, name))}, {title(test.output, channels)}: {sentence(test, channels)}",
            style=_COLOURS[test.verdict],
        )
        for name, tests in residuals.items()
        for test in tests
    ]
    if "test" in residuals and sound(residuals["train"]) and not sound(residuals["test"]):
        words.append(_DIFFER)
    return [*words, _HOW]


def sentence(test: ResidualTest, channels: Sequence[Channel] = ()) -> str:
    """The verdict on the residuals of one output."""
    if test.verdict == "diverged":
        return "the simulation has diverged, so there is no residual to test."
    size = f"{test.rms:.3g} times the noise (RMS)" if np.isfinite(test.rms) else "of an output without noise"
    if test.verdict == "white":
        return f"white: nothing left to model. The residual is {size}."
    if test.verdict == "nearly white":
        return (
            f"nearly white: next to nothing left to model. The residual is {size}, and neighbours correlate by "
            f"{test.shared:.2f} only."
        )
    if test.followed:
        first = test.followed[0]
        after, name = count(first.lag, "sample"), title(first.input, channels)
        return (
            f"not white: the residual follows {name} (correlation {first.correlation:.2f}, {after} later), so "
            f"the model lacks a part of what {name} does, or when. It is {size}."
        )
    if test.rms < FAINT:
        return f"not white, but only {size}: the counts of an encoder, which dwell, look alike."
    return (
        f"not white: neighbours correlate by {test.shared:.2f}, as where an effect is missing or values differ from "
        f"record to record; the residual follows no input surely. It is {size}."
    )


def residual_result(residuals: Residuals) -> dict[str, list[dict[str, object]]]:
    """The tests as plain data, by what they are of."""
    return {
        name: [
            {
                "output": one.output,
                "verdict": one.verdict,
                "samples": one.samples,
                "rms_over_noise": one.rms,
                "lags": one.lags,
                "lags_outside": one.outside,
                "chance_of_white": one.chance,
                "neighbours": one.shared,
                "inputs": {
                    f.input: {"correlation": f.correlation, "lag": f.lag, "by_chance": f.band}
                    for f in one.follows
                },
            }
            for one in tests
        ]
        for name, tests in residuals.items()
    }
