"""How far the gap shrinks on unseen records once the effects are added."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_id.diagnosis.measure import Errors

DRAWS = 500


@dataclass(frozen=True)
class Shrink:
    """Share of the closable gap that is closed.

    Attributes:
        share: ``(refit - with_effect) / (refit - floor)``; 0 where nothing is left to close, with an interval from 0 to
            1 where the one record that showed the gap is among those of the fit.
        interval: 95 % interval from blocks drawn with replacement; its lower end takes the floor for the measurements'
            noise alone, its upper end for ``floor``, either with the scatter of the error itself: more is not known of
            it. A model may do better on these records than the right one would, so that it may reach beyond 1.
        refit, with_effect, floor: normalised RMSE.
    """

    share: float
    interval: tuple[float, float]
    refit: float
    with_effect: float
    floor: float


def shrink(refit: Errors, with_effect: Errors, floor: float, *, seed: int = 0) -> Shrink:
    """Compare two models on the same records.

    Args:
        refit: errors of today's model, re-fitted.
        with_effect: errors with the effects added.
        floor: normalised RMSE that the right model would leave.
        seed: of the draws.
    """
    generator = np.random.default_rng(seed)
    pairs = []
    for _ in range(DRAWS):
        draw = [[generator.integers(0, len(b), len(b)) for b in row] for row in refit.blocks]
        pairs.append((refit.resampled(draw), with_effect.resampled(draw)))
    scale = max(with_effect.nrmse, 1e-300)
    scatter = min(1.96 * float(np.std([after for _, after in pairs])) / scale, 0.5)
    least, most = min(with_effect.noise, floor) / scale * (1.0 - scatter), floor / scale * (1.0 + scatter)
    # the floor moves with the error that is drawn: the same blocks hold the same noise
    lows = [_share(before, after, least * after) for before, after in pairs]
    highs = [_share(before, after, min(most * after, 0.5 * (before + after))) for before, after in pairs]
    low, high = float(np.quantile(lows, 0.025)), float(np.quantile(highs, 0.975))
    return Shrink(
        _share(refit.nrmse, with_effect.nrmse, floor), (low, high), refit.nrmse, with_effect.nrmse, floor
    )


def _share(before: float, after: float, floor: float) -> float:
    closable = before - floor
    return float((before - after) / closable) if closable > 1e-3 * before else 0.0
