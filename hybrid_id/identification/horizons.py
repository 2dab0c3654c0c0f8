"""How long a model runs free before it starts again from a measured state, how records choose that, and fits of pieces.

A piece begins in states that nobody has measured (the twist of a gear, a bristle, heat) as a free run of the model has
them there, and is held to them. A free run with the start values holds the estimates to these: so records are cut anew
with the fitted values, and fitted again, until the estimates stay or err more than those before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit, kept_fit
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.windows import (
    SHORTEST,
    holds_enough,
    measured_spread,
    measured_windows,
    window_samples,
)
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import Simulation, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

Kind = Literal["whole", "strokes", "windows"]
"""Whole records, strokes (from rest to rest), or windows of one length."""
STILL, REST = 0.02, 0.1
"""A joint rests while its speed stays below this share of its largest one, for so long [s] at least."""
FOLLOWED, LOST = 0.1, 0.5
"""Normalised RMSE beyond noise up to which free runs follow their records, and from which they have lost them."""
SECONDS = (0.25, 0.5, 1.0, 2.0)
"""Lengths of windows [s] that are compared."""
NEARER, ROUNDING = (0.3, 0.1, 0.0), 1e-6
"""Shares of a step of the first state where the whole of it makes a run err more, of which the first is taken by which
it does not; and by what share of its cost it may, which is rounding."""
BRIEF = 12
"""Iterations of the fit over each horizon."""
BLOCKS = 16
"""Blocks of the records whose scatter gives a standard error; it is known to 1 / sqrt(2 * 15) = 18 % then."""
SURELY = 1.5
"""Ratio of two such standard errors that is no accident: 1 + 2 * sqrt(2) * 18 %."""
ROUNDS = 12
"""Times that records are cut anew at most: each takes about half of what is left of the way."""
SETTLED = 0.02
"""Share of what a fit leaves (RMS) by which its outputs move in a round, below which its estimates have settled."""


@dataclass(frozen=True)
class Horizon:
    """How long a free run is.

    Attributes:
        kind: "whole" records, "strokes" (from rest to rest), or "windows" of one length.
        seconds: length of the windows; 0 for the other kinds.
        reason: why it was chosen, in words; empty where the user chose it.
    """

    kind: Kind = "whole"
    seconds: float = 0.0
    reason: str = ""

    def __post_init__(self) -> None:
        if (self.kind == "windows") != (0.0 < self.seconds < np.inf):
            raise InputError(
                f"A horizon of {self.kind} has {self.seconds:g} s; give windows a positive length, others none."
            )

    @staticmethod
    def of(wish: str | float) -> Horizon | None:
        """The horizon of a user's word: a length [s], "whole", "strokes", or "auto" (None: the records choose).

        Raises:
            InputError: no such horizon.
        """
        if wish == "auto":
            return None
        if wish in ("whole", "strokes"):
            return Horizon(wish)  # type: ignore[arg-type]
        with suppress(ValueError):
            if 0.0 < float(wish) < np.inf:
                return Horizon("windows", float(wish))
        raise InputError(f"window '{wish}' is none; give a length in seconds above 0, whole, strokes or auto")

    @property
    def length(self) -> str:
        """How long free runs are, in words."""
        names = {"whole": "free runs over whole records", "strokes": "free runs from rest to rest"}
        return names.get(self.kind, f"free runs of {self.seconds:g} s from measured states")

    @property
    def wish(self) -> str:
        """The user's word for it, see :meth:`of`."""
        return f"{self.seconds:g}" if self.kind == "windows" else self.kind

    def __str__(self) -> str:
        return f"{self.length}, for {self.reason}" if self.reason else self.length

    def as_dict(self) -> dict[str, object]:
        """What JSON files say of it: ``kind``, ``seconds``, and ``words``."""
        return {"kind": self.kind, "seconds": self.seconds, "words": str(self)}

    def check(self, samples: int, step: float) -> None:
        """Refuse windows of too few samples, and windows of which no record has four.

        Args:
            samples: of the longest record.
            step: sample time [s].

        Raises:
            InputError: they do not fit; the sentence gives the range that does.
        """
        least, most = SHORTEST * step, samples * step / 4
        if self.kind == "windows" and not (holds_enough(self.seconds, step) and self.seconds <= most):
            raise InputError(
                f"windows of {self.seconds:g} s do not fit: a window holds {SHORTEST} samples or more, and the longest "
                f"record four windows; give {least:.3g} to {most:.3g} s, or whole, strokes or auto"
            )

    def simulates(self, system: System, batch: Batch) -> bool:
        """Whether pieces of these records begin in states that nobody has measured, as the model has them."""
        return self.kind != "whole" and bool(system.memory_rows or _unseen_sides(system, batch))

    def cut(self, system: System, engine: Engine, batch: Batch) -> Batch:
        """The pieces of a batch over which a model runs free; the batch itself where there is only one a record.

        Every piece keeps the name of its record, and the pieces of a record follow each other without overlap. Its
        first state is as measured, free within its uncertainty. What nobody has measured (heat, bristles, the twist of
        a gear without encoders on both of its sides) begins as in a free run of the model and is held there: free to
        move, it would explain whatever happens in so short a time.

        Args:
            system: model with the values that its hidden states are simulated with.
            engine: how.
            batch: whole records, prepared for it.
        """
        if self.kind == "windows":
            if window_samples(batch.x.shape[1], batch.sample_time, self.seconds, least=1) is None:
                return batch  # none of the records holds one
            batch, hidden = _simulated_hidden(system, engine, batch)
            short = measured_windows(system, batch, self.seconds, least=1)
            assert short is not None
            short[0].x0_std[:, hidden] = 0.0
            return short[0]
        if self.kind == "whole":
            return batch
        cuts = [_stroke_starts(system, batch, row) for row in range(batch.rows)]
        if all(len(starts) == 2 for starts in cuts):
            return batch
        batch, hidden = _simulated_hidden(system, engine, batch)
        device = batch.x.device
        row = torch.tensor([r for r, starts in enumerate(cuts) for _ in starts[1:]], device=device)
        start = torch.tensor([s for starts in cuts for s in starts[:-1]], device=device)
        length = torch.tensor([int(n) for starts in cuts for n in np.diff(starts)], device=device)
        x0_std = measured_spread(system, batch)
        x0_std[:, hidden] = 0.0
        x0_std = torch.where((start == 0)[:, None], batch.x0_std[row], x0_std[row])
        return batch.pieces(row, start, length, x0_std)


WHOLE = Horizon()


def shortest(horizons: Sequence[Horizon]) -> Horizon:
    """The shortest of several horizons: windows before strokes before whole records."""
    order = ("windows", "strokes", "whole")
    return min(horizons, key=lambda one: (order.index(one.kind), one.seconds))


def _stroke_starts(system: System, batch: Batch, row: int) -> list[int]:
    """First samples of a record's strokes, each amid a rest between two motions, and the number of its samples."""
    samples = int((batch.weight[row] > 0).any(1).sum())
    # the rotor's, which every model of a joint has from the same output: all are cut at the same samples
    rows = [joint.positions[0] + 1 for joint in system.joints]
    speed = batch.x[row, :samples, rows].abs().cpu().numpy()
    still = (speed <= STILL * speed.max(0)).all(1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    step = float(batch.dt[row][batch.dt[row] > 0].median()) if samples > 1 else np.inf
    starts = [0]
    for first, last in edges.reshape(-1, 2).tolist():
        middle, inside = (first + last) // 2, first > 0 and last < samples
        if inside and (last - first) * step >= REST and middle - starts[-1] >= SHORTEST:
            starts.append(middle)
    if len(starts) > 1 and samples - starts[-1] < SHORTEST:
        starts.pop()
    return [*starts, samples]


def _unseen_sides(system: System, batch: Batch) -> list[tuple[Joint, list[int]]]:
    """Joints whose gear gives way where no encoder sees it, with the rows of what is not seen."""
    sides = ((joint, joint.hidden_rows(batch.outputs)) for joint in system.joints)
    return [(joint, rows) for joint, rows in sides if rows]


def _simulated_hidden(system: System, engine: Engine, batch: Batch) -> tuple[Batch, list[int]]:
    """The batch with its hidden states as in a free run, and their rows."""
    hidden, unseen = list(system.memory_rows), _unseen_sides(system, batch)
    if not hidden and not unseen:
        return batch, hidden
    run = simulate(system, with_substeps(system, engine, batch), batch).x.nan_to_num(0.0, 0.0, 0.0)
    x = batch.x.clone()
    x[..., hidden] = run[..., hidden]
    for joint, rows in unseen:
        motor, link = joint.positions
        for row in range(len(rows)):  # angle and speed
            twist = run[..., link + row] - run[..., motor + row] / joint.gear_ratio
            if rows[0] == link:
                x[..., link + row] = batch.x[..., motor + row] / joint.gear_ratio + twist
            else:
                x[..., motor + row] = joint.gear_ratio * (batch.x[..., link + row] - twist)
        hidden += rows
    return replace(batch, x=x), hidden


def free_runs(system: System, engine: Engine, batch: Batch) -> Simulation:
    """Free runs of pieces, the first state of each moved by one Gauss-Newton step within its uncertainty.

    What the encoders' noise does to a measured speed is no error of the model. A step is taken as far as the run then
    errs less: where a joint sticks, its slopes say nothing of what happens beyond.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: pieces, see :meth:`Horizon.cut`.
    """
    theta = system.theta().detach().to(batch.x.device)[:, None].expand(-1, batch.rows)
    # compiled steps are made for what they are differentiated by: those of a fit of the model are there already
    free = system.estimated if engine.compiled else []
    at = evaluate(system, engine, batch, batch.x, theta, free, loss=Loss(), chunk=batch.x.shape[1])
    x, n_x = batch.x.clone(), batch.x.shape[-1]
    try:
        step = torch.linalg.solve(at.hessian[:, :n_x, :n_x], at.gradient[:, :n_x]).nan_to_num(0.0, 0.0, 0.0)
    except RuntimeError:  # states that nothing identifies stay as they were measured
        return simulate(system, engine, batch, theta)
    known = batch.x0_std.square().reciprocal().where(batch.x0_std > 0, 0.0)

    def moved_by(share: Tensor) -> tuple[Simulation, Tensor]:
        """Runs after a share of each step, and which of them err more than before."""
        moved = share[:, None] * step
        x[:, 0] = batch.x[:, 0] - moved
        run = simulate(system, engine, replace(batch, x=x), theta)
        errors = ((run.y - batch.y) * batch.weight).square().sum((1, 2)) + (known * moved.square()).sum(1)
        return run, ~(0.5 * errors <= (1.0 + ROUNDING) * at.cost)

    share = torch.ones_like(at.cost)
    run, worse = moved_by(share)
    for nearer in NEARER:
        if not worse.any():
            break
        share = torch.where(worse, nearer, share)
        run, worse = moved_by(share)
    return run


def window_errors(system: System, engine: Engine, batch: Batch, seconds: float) -> list[np.ndarray]:
    """Weighted errors of a model over windows, ``(T, n_y)`` each; none where the records are too short for them.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        seconds: length of a window.
    """
    short = Horizon("windows", seconds).cut(system, engine, batch)
    if short.rows == batch.rows:
        return []
    run = free_runs(system, with_substeps(system, engine, short), short)
    found = ((run.y - short.y) * short.weight).numpy()
    return [row[(weight > 0).any(1)] for row, weight in zip(found, short.weight.numpy(), strict=True)]


def choose_horizon(
    system: System,
    engine: Engine,
    batch: Batch,
    whole: Sequence[FitResult] = (),
    *,
    options: Options | None = None,
    say: Callable[[int, int], object] = lambda done, total: None,
) -> Horizon:
    """The longest of whole records, strokes and windows beyond which error grows faster than information.

    Whole records are taken where the free runs of the fit follow them. Otherwise the model is fitted over each horizon,
    from the shortest on. The standard errors of its parameters are taken from the scatter of the score over blocks of
    the records, the same for every horizon (sandwich estimate; H. White, Econometrica 50, 1982): a longer free run
    says more about the parameters, but what the model lacks accumulates in it, too. The longest horizon is chosen
    whose standard errors are not surely larger than the least, in the geometric mean over the identified directions.

    Args:
        system: model with start values.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        whole: fits of the records as a whole, one or one a record; fitted here where there is none.
        options: settings of these fits.
        say: called before each of them with how many are done, and how many there are at most.
    """
    options = options or Options()
    if not system.estimated:
        return WHOLE
    lengths = [s for s in SECONDS if holds_enough(s, batch.sample_time)]
    horizons = (*(Horizon("windows", s) for s in lengths), Horizon("strokes"), WHOLE)
    before = 0 if whole else 1
    if not whole:
        say(0, len(horizons) + before)
    whole = whole or fit(system, batch, pooled=True, engine=engine, options=options)
    if astray(whole, batch) <= FOLLOWED:
        return Horizon(reason="they follow the records")
    brief, found = replace(options, max_iterations=BRIEF), []
    for done, horizon in enumerate(horizons, before):
        say(done, len(horizons) + before)
        part = horizon.cut(system, engine, batch)
        if horizon.kind != "whole" and part.rows == batch.rows:
            continue
        with suppress(RuntimeError, InputError):  # it diverges over so long a time
            one = fit(system, part, pooled=True, engine=engine, options=brief, warm=False)[0]
            if one.status != "diverged":
                system = one.system
                if astray([one], batch) < LOST:
                    found.append((float(part.dt.sum(1).median()), horizon, one))
    if not found:
        return Horizon(reason="no horizon is followed")
    inside = [
        k for k in range(len(system.estimated)) if all(one.names[k] not in one.at_bound for *_, one in found)
    ]
    size, count = np.array([covariance_size(one, inside) for *_, one in found]).T
    size = size / max(float(count.max()), 1.0)
    able = [k for k in range(len(found)) if size[k] <= size.min() + np.log(SURELY)]
    _, horizon, one = found[max(able, key=lambda k: found[k][0])]
    if horizon.kind == "whole":
        return replace(horizon, reason="no shorter ones say more about the parameters")
    # the time after which the model's free runs over whole records have an error that lost them
    run = simulate(one.system, one.engine, batch)
    residual = ((run.y - batch.y) * batch.weight).cpu().numpy()
    samples = np.arange(1, residual.shape[1] + 1)[:, None]
    errors = [_relative(np.cumsum(r**2, 0) / samples, batch, k).mean(1) for k, r in enumerate(residual)]
    lost = ~(np.mean(errors, 0) <= FOLLOWED)
    after = f" after {np.argmax(lost) * batch.sample_time:.2g} s" if lost.any() else ""
    return replace(horizon, reason=f"whole runs lose the records{after}")


def astray(fits: Sequence[FitResult], batch: Batch) -> float:
    """Normalised RMSE beyond noise of the free runs of fits, outputs and records averaged.

    Noise leads no free run astray, however little an output moves.

    Args:
        fits: of whole records or of their pieces.
        batch: the whole records.
    """
    found = []
    for one in fits:
        for record, residual in zip(dict.fromkeys(one.records), one.joined(one.residual), strict=True):
            square = np.square(residual).mean(0)
            found.append(_relative(square, batch, batch.names.index(record)).mean())
    return float(np.mean(found))


def _relative(square: np.ndarray, batch: Batch, row: int) -> np.ndarray:
    """Error beyond noise as a share of what a record's outputs move; mean squares of weighted residuals (..., n_y)."""
    scale = batch.motion()[row].cpu().numpy()
    return np.sqrt(np.maximum(square - 1.0, 0.0) / np.maximum(np.square(scale), 1.0))


def covariance_size(result: FitResult, inside: Sequence[int]) -> tuple[float, float]:
    """Log volume of the ellipsoid of standard errors of some parameters, and in how many directions records tell it.

    The scatter of the score over blocks gives it. Nobody knows less of a parameter than its own size.
    """
    found, inside = result.of_records(), list(inside)
    noise = max(result.noise_scale, 1e-12) ** 2
    prior = np.diag(result.prior_precision[inside])
    weak = noise * np.diag(1.0 / np.maximum(np.abs(result.values[inside]), 1e-12) ** 2)
    information, scatter = prior + weak, prior + noise * weak
    known = information
    for sensitivities, residual in zip(*found, strict=True):
        jacobian = sensitivities[..., inside]
        score = np.einsum("tyi,ty->ti", jacobian, residual)
        information = information + np.einsum("tyi,tyj->ij", jacobian, jacobian)
        blocks = np.array([b.sum(0) for b in np.array_split(score, -(-BLOCKS // len(found[1])))])
        scatter = scatter + blocks.T @ blocks
    size = 0.5 * np.linalg.slogdet(scatter)[1] - np.linalg.slogdet(information)[1]
    return float(size), len(inside) - float(np.trace(np.linalg.solve(information, known)))


def settled(
    sets: list[FitResult],
    horizon: Horizon,
    batch: Batch,
    *,
    engine: Engine,
    kept: Kept | None = None,
    **settings: Any,
) -> list[FitResult]:
    """The sets, fitted again to pieces that begin as their own values say; as they are where no first state is hidden.

    Args:
        sets: fits to pieces that begin as the start values say, one of all records or one of each.
        horizon: of the pieces.
        batch: the whole records.
        engine: how a sample is integrated.
        kept: fits that are kept from before.
        settings: further arguments of :func:`hybrid_id.identification.fit.fit`, its options among them.
    """
    if not sets or not horizon.simulates(sets[0].system, batch):
        return sets
    options: Options = settings.get("options") or Options()
    as_it_is: dict[str, Any] = {**settings, "options": replace(options, max_iterations=0)}
    as_it_is |= {"warm": False, "starts": 1}

    def cut_anew(result: FitResult) -> tuple[Batch, Tensor, float]:
        """Pieces that begin as a set's values say, the first states of free runs over them, and what these cost."""
        part = horizon.cut(result.system, result.engine, own)
        run = free_runs(result.system, with_substeps(result.system, result.engine, part), part)
        errors = ((run.y - part.y) * part.weight)[part.weight > 0]
        return part, run.x[:, 0], float(options.loss.value(errors).sum())

    found = []
    for result in sets:
        if result.status in ("diverged", "interrupted"):
            found.append(result)
            continue
        rows = [row for row, name in enumerate(batch.names) if name in result.records]
        own = batch.take(torch.tensor(rows, device=batch.x.device))
        part, first, least = cut_anew(result)
        for _ in range(ROUNDS):
            (again,) = kept_fit(kept, result.system, part, pooled=True, engine=engine, **settings)
            if again.status == "diverged":
                break
            there, began, errs = cut_anew(again)
            if not errs < least:
                break
            # RMS by which the weighted outputs move, to first order
            step = again.values - result.values
            squares = sum(float(np.square(j.reshape(-1, len(step)) @ step).sum()) for j in again.jacobian)
            moved = float(np.sqrt(squares / max(again.n_samples, 1)))
            enough = moved <= SETTLED * again.noise_scale or again.status == "interrupted"
            result, part, first, least = again, there, began, errs
            if enough:
                break
        (end,) = fit(result.system, part, pooled=True, engine=result.engine, x0=first, **as_it_is)
        found.append(replace(end, status=result.status, iterations=result.iterations, history=result.history))
    return found
