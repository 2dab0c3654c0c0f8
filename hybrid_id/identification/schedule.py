"""The plan of a hybrid training: its settings, its stages, and where it stands, as a checkpoint holds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from hybrid_id.identification.checkpoint import as_content
from hybrid_id.identification.first_order import Descent
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.quasi_newton import State


@dataclass(frozen=True)
class HybridOptions:
    """Settings of a hybrid training.

    Attributes:
        prices: of the networks' mean square output, falling (see :func:`.network_data.with_price`).
        windows: stages in which the networks alone train, before the whole records: (length [s], one in this many).
        max_iterations: gradients in a stage.
        tolerance: a stage has converged when the next step is shorter than this many standard errors.
        patience: looks at the validation records without a gain after which a stage ends.
        validate_every: gradients between two looks.
        worth: share by which a rung further down must lower the validation loss, see :func:`choose`.
        loss: loss of the weighted residuals.
        starts: start points of the fit of physics alone.
        seed: of these.
        augmentation: what has the price: the networks' mean square output (``norm``), or only the part of what they
            cause that the parameters cause, too (``projection``, see :mod:`.network_projection`).
        optimizer: ``gauss_newton``, or ``adam`` for networks of more than some hundred weights.
        rate, clip: of Adam: largest step of an unknown in its unit, and length to which a gradient of the loss per
            measurement is clipped (see :mod:`.first_order`).
        precision: of the training; physics alone is fitted in float64.
    """

    prices: tuple[float, ...] = (10.0, 1.0, 0.1, 0.01)
    windows: tuple[tuple[float, int], ...] = ((0.1, 4), (0.4, 2), (1.6, 1))
    max_iterations: int = 40
    tolerance: float = 0.1
    patience: int = 10
    validate_every: int = 2
    worth: float = 0.02
    loss: Loss = field(default_factory=Loss)
    starts: int = 1
    seed: int = 0
    augmentation: Literal["norm", "projection"] = "norm"
    optimizer: Literal["gauss_newton", "adam"] = "gauss_newton"
    rate: float = 0.01
    clip: float = 1.0
    precision: Literal["float64", "float32"] = "float64"

    @property
    def dtype(self) -> torch.dtype:
        """Number type of the precision."""
        return torch.float32 if self.precision == "float32" else torch.float64

    @property
    def stages(self) -> list[Stage]:
        """The networks alone, on windows of growing length and whole records; then all together, price by price."""
        alone = [Stage(0, self.prices[0], window, True) for window in (*self.windows, None)]
        return alone + [Stage(k, price, None, False) for k, price in enumerate(self.prices)]


class Stage(NamedTuple):
    """A part of the training.

    Attributes:
        rung: number of its price on the ladder.
        price: of the networks' output.
        window: length [s] of windows and use of one in so many; None for whole records.
        hold: whether the physics is held.
    """

    rung: int
    price: float
    window: tuple[float, int] | None
    hold: bool

    @property
    def label(self) -> str:
        """Its name for a progress line."""
        what = "networks" if self.hold else f"physics and networks, price {self.price:g}"
        return f"{what}, {'records' if self.window is None else f'windows of {self.window[0]:g} s'}"


def typical(losses: Tensor) -> float:
    """Geometric mean of the losses in the parts of the validation records.

    A free run that has lost its record (a rotor that rests one tooth further on) says little from there on: the mean
    would be of these parts alone.
    """
    return float(losses.clamp_min(1e-300).log().mean().exp())


def excess(losses: Tensor, reference: Tensor) -> tuple[float, float]:
    """Mean logarithm of the ratio of losses to a reference in the same parts, and its standard error.

    The parts of one record share its run of the machine (friction that drifts from run to run), so that the larger of
    two standard errors counts: that of independent parts, and that of independent records, where there are several.

    Args:
        losses: in each part of each record, ``(n_parts, R)``.
        reference: the same of what they are compared with.
    """
    # both may be infinite where a run is lost
    ratio = torch.where(losses == reference, 1.0, losses / reference).clamp_min(1e-300).log()
    ways = [ratio.flatten()] + ([ratio.mean(0)] if ratio.shape[1] > 1 else [])
    return float(ratio.mean()), max(float(way.std()) / len(way) ** 0.5 for way in ways)


class Found(NamedTuple):
    """What a rung of the ladder came to.

    Attributes:
        theta, weights: ``(n_p, 1)`` and ``(n_w,)``.
        train: loss per measurement.
        validation: the same in each part of the validation records, ``(n_parts, R)``; see :func:`typical`.
        iterations, status: gradients up to here, and how the rung ended.
    """

    theta: Tensor
    weights: Tensor
    train: float
    validation: Tensor
    iterations: int
    status: str


@dataclass
class Course:
    """Where a training stands; all of it is in the checkpoint.

    Attributes:
        stage: number of the stage.
        theta, weights: what it started from, ``(n_p, 1)`` and ``(n_w,)``.
        state: the optimiser's; None where the stage has not begun.
        best, waited: validation losses of the stage where they were least, and looks since then.
        kept: unknowns at the last look whose losses were not above those by more than chance: what the train records
            say counts until the validation records object.
        done: gradients before this stage.
        found: finished rungs.
    """

    stage: int
    theta: Tensor
    weights: Tensor
    state: State | Descent | None = None
    best: Tensor | None = None
    kept: Tensor | None = None
    waited: int = 0
    done: int = 0
    found: list[Found] = field(default_factory=list)

    def content(self) -> dict[str, Any]:
        """The course as tensors, numbers and text."""
        state = None if self.state is None else as_content(self.state)
        return vars(self) | {"state": state, "found": [tuple(f) for f in self.found]}

    @classmethod
    def of(cls, content: dict[str, Any]) -> Course:
        """The course of a checkpoint."""
        state = content["state"]
        found, kind = [Found(*f) for f in content["found"]], State if state and "metric" in state else Descent
        return cls(**content | {"state": None if state is None else kind(**state), "found": found})
