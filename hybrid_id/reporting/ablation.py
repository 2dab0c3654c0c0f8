"""An ablation as plain data and as tables."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.reporting.tables import open_table
from hybrid_id.study.ablation_result import SETS, Ablation, Scores
from hybrid_id.study.ablation_verdict import HYBRID, OPEN, answer, signed, verdict

_STYLE = {HYBRID: "green", OPEN: "yellow"}


def ablation_result(result: Ablation) -> dict[str, Any]:
    """Everything that an ablation tells, as plain data."""
    return {
        "answer": answer(result),
        "verdict": verdict(result),
        "level": result.level,
        "arms": [_scores(scores) for scores in result.scores],
        "ladder": [_scores(scores) for scores in result.ladder],
        "parameters": {
            arm.name: {
                name: {"mean": v.mean[k], "std": v.std[k], "percent": v.percent[k]}
                for k, name in enumerate(v.names)
            }
            for arm, v in result.parameters.items()
        },
        "splits": {str(seed): vars(split) for seed, split in result.splits.items()},
        "failed": {r.cell.name: r.message for r in result.failed},
    }


def _scores(scores: Scores) -> dict[str, Any]:
    return {
        "arm": scores.arm.name,
        "price": "chosen" if scores.price is None else scores.price,
        "seeds": scores.seeds,
        "weighted_error": {name: scores.errors[name] for name in SETS},
        "diverged": {name: scores.diverged(name) for name in SETS},
        "log_ratio_to_physics": {name: vars(scores.change[name]) for name in SETS},
        "share": scores.share,
        "overlap": scores.overlap,
        "drift_sigma": scores.drift,
    }


def ablation_tables(result: Ablation) -> RenderableType:
    """The answer, the arms, what the price does, the parameters, and the cells that broke."""
    parts: list[RenderableType] = [verdict_text(result), arms_table(result)]
    parts += [ladder_table(result)] if result.ladder else []
    parts += [parameters_table(result)]
    return Group(*parts, *failures(result))


def verdict_text(result: Ablation) -> Group:
    """The answer in words, and one paragraph for each thing that goes with it."""
    first, *others = verdict(result)
    return Group(Text(first, style=_STYLE.get(answer(result), "")), *map(Text, others))


def arms_table(result: Ablation) -> Table:
    """One row an arm: errors, and their paired change against physics only."""
    heads = ("validation>", "test>", "change of\ntest [%]>", "short\nhorizon>", "out of\nrange>")
    table = open_table("arm", *heads, "change out of\nrange [%]>", "n>")
    for scores in result.scores:
        table.add_row(
            scores.arm.label, _error(scores, "validation"), _error(scores, "test"), _change(result, scores, "test"),
            _error(scores, "short"), _error(scores, "beyond"), _change(result, scores, "beyond"),
            str(len(scores.seeds)),
        )  # fmt: skip
    return table


def ladder_table(result: Ablation) -> Table:
    """What the price of the network's output buys: error, share, overlap and drift of the parameters."""
    heads = (
        "price>",
        "validation>",
        "test>",
        "change of\ntest [%]>",
        "out of\nrange>",
        "share of\ntorque>",
    )
    table = open_table("arm", *heads, "overlap>", "largest\ndrift [σ]>")
    for scores in result.ladder:
        table.add_row(
            scores.arm.label, f"{scores.price:g}", _error(scores, "validation"), _error(scores, "test"),
            _change(result, scores, "test"), _error(scores, "beyond"), f"{100 * scores.share:.1f} %",
            f"{scores.overlap:.2f}", f"{scores.drift:.1f}",
        )  # fmt: skip
    return table


def parameters_table(result: Ablation) -> Table:
    """Mean and std/mean of the physical parameters over the repeats, physics only beside the best hybrid."""
    arms = list(result.parameters.items())
    table = open_table("parameter", *(f"{words}>" for arm, _ in arms for words in (arm.label, "std/mean")))
    for k, parameter in enumerate(arms[0][1].names if arms else ()):
        cells = [text for _, v in arms for text in (f"{v.mean[k]:.5g}", _spread(v.percent[k]))]
        table.add_row(parameter, *cells)
    return table


def splits_table(result: Ablation) -> Table:
    """Which records each repeat trained, validated and tested on."""
    table = open_table("seed>", "train", "validation", "test", "out of range")
    for seed, split in result.splits.items():
        parts = (", ".join(names) for names in (split.train, split.validation, split.test, split.beyond))
        table.add_row(str(seed), *parts)
    return table


def failures(result: Ablation) -> list[Text]:
    """One line a cell that came to nothing."""
    return [Text(f"{r.cell.name}: {r.message}", style="red") for r in result.failed]


def _error(scores: Scores, records: str) -> str:
    """Geometric mean of the errors over the repeats; how many diverged."""
    errors = scores.errors[records]
    finite, diverged = errors[np.isfinite(errors)], scores.diverged(records)
    words = f"{np.exp(np.log(finite).mean()):.3g}" if finite.size else ""
    return f"{words} ({diverged} diverged)".strip() if diverged else words


def _spread(percent: float) -> str:
    """std/mean; nothing where one repeat has none."""
    return f"{percent:.2f} %" if math.isfinite(percent) else ""


def _change(result: Ablation, scores: Scores, records: str) -> str:
    mid, low, high = scores.percent(records)
    if scores is result.physics or not math.isfinite(mid):
        return ""
    interval = f"\N{NO-BREAK SPACE}({signed(low)} … {signed(high)})" if math.isfinite(high) else ""
    return signed(mid) + interval.replace(" ", "\N{NO-BREAK SPACE}")
