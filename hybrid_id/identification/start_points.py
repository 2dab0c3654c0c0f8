"""Where the starts of a fit begin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from hybrid_id.identification.lm_step import Bounds
from hybrid_id.systems.chain import System


def start_points(
    system: System,
    free: Sequence[int],
    bounds: Bounds,
    numbers: Sequence[int],
    starts: int,
    spread: float,
    seed: int,
    given: Tensor | None = None,
) -> Tensor:
    """Start values of all parameters, ``(n_p, starts * G)``: the given point, then points spread around it.

    Args:
        system: model with start values.
        free: indices of the parameters to move.
        bounds: their box and scales.
        numbers: of the sets, G of them; each draws points of its own, whatever other sets are beside it.
        starts: number of points.
        spread: half-width of the factors, 0.5 for +-50 %.
        seed: of the draws.
        given: the first point, ``(n_p, G)``; the system's values by default.
    """
    base = system.theta().detach()[:, None].expand(-1, len(numbers)) if given is None else given
    generators = [np.random.default_rng([seed, number]) for number in numbers]
    points = [base.clone()]
    limits = [limit.to(base.device)[:, None] for limit in (bounds.lower, bounds.upper)]
    reach = 10.0 * bounds.scale.to(base.device)[:, None]
    for _ in range(starts - 1):
        point = base.clone()
        drawn = np.stack([generator.uniform(-1.0, 1.0, len(free)) for generator in generators], 1)
        part = torch.tensor(drawn, device=base.device)
        here = point[list(free)]
        # no factor moves a zero: such a parameter is drawn from the range that its steps are measured by
        moved = torch.where(here == 0, part * reach, here * (1.0 + spread * part))
        point[list(free)] = torch.maximum(torch.minimum(moved, limits[1]), limits[0])
        points.append(point)
    return torch.cat(points, 1)
