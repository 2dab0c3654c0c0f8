"""A small network for what the named laws miss, in any place of the chain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import torch
from torch import Tensor, nn

from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.parameters import MOST_LAYERS, MOST_NEURONS, MOST_STATES, Bounded, Parameter

MEMORY_TIMES = (0.01, 1.0)
"""Shortest and longest time [s] over which the hidden states forget at the start."""


class ResidualNetwork(Component):
    """``r = S g(z, h) + b_0``, ``z_i = (signal_i - m_i) / s_i``, ``T_j dh_j/dt = tanh(A (z, h) + a)_j - h_j``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | r | that of its place | V at ``input``, N m elsewhere, with the sign of what else acts in the place |
    | S | that of r | output scale |
    | b_0 | that of r | constant beside the network; 0 and held by default |
    | g | 1 | layers of tanh, the last one linear and zero at the start, so that r = 0 exactly |
    | m, s | that of the signal | shift and scale of each input, from the data |
    | h, T | 1, s | hidden states (with ``memory``) in (-1, 1), and the times over which they forget |

    An input ``direction`` is tanh(z_i) instead. The weights are torch parameters that no parameter table lists. With
    ``lipschitz`` = c no output changes by more than ``S c`` times the largest change among (z, h): the rows of each of
    g's L matrices are scaled to an absolute sum of at most ``c^(1/L)``.

    Sources: Y. Yin et al., APHYNITY, ICLR 2021 (physics plus network); H.-T. D. Liu et al., Learning Smooth Neural
    Functions via Lipschitz Regularization, SIGGRAPH 2022, eq. (5)-(6) (scaled rows).
    Differs from them: hidden states that relax, so that they never diverge; the bound is chosen, not learnt.

    Args:
        inputs: names of the signals, see :class:`~hybrid_id.systems.networks.Networks`.
        hidden: neurons of each hidden layer.
        memory: hidden states; 0 is a static network.
        lipschitz: the bound c; None for none.
        seed: of the first weights.
        shift, scale: m and s of each input (default: 0 and 1).
        output_scale: S.
        values: b_0.
    """

    kind = "residual_network"
    left_out = "is left out, MuJoCo has no networks: --to torch exports it"
    places = ("input", "motor", "motor_friction", "transmission", "link_friction", "load")
    b_0 = Parameter(
        0.0, lower=-1e6, upper=1e6, unit="place", doc="constant beside the network", estimate=False
    )
    shift: Tensor
    scale: Tensor
    output_scale: Tensor

    def __init__(
        self,
        *,
        inputs: Sequence[str] = ("speed",),
        hidden: Sequence[int] = (8, 8),
        memory: int = 0,
        lipschitz: float | None = None,
        seed: int = 0,
        shift: Sequence[float] | None = None,
        scale: Sequence[float] | None = None,
        output_scale: float = 1.0,
        **values: float | Bounded,
    ) -> None:
        super().__init__(**values)
        self.inputs, self.hidden, self.memory = tuple(inputs), tuple(hidden), memory
        self.lipschitz, self.seed = lipschitz, seed
        self._check(shift, scale, output_scale)
        self.states = tuple(f"h{k + 1}" for k in range(memory))
        count = len(self.inputs)
        for name, value in (("shift", shift or [0.0] * count), ("scale", scale or [1.0] * count)):
            self.register_buffer(name, torch.tensor(value, dtype=torch.float64))
        self.register_buffer("output_scale", torch.tensor(output_scale, dtype=torch.float64))
        widths = [count + memory, *self.hidden, 1]
        with torch.random.fork_rng(devices=[]):  # what is drawn here is drawn again below
            pairs = pairwise(widths)
            self.layers = nn.ModuleList(nn.Linear(a, b, dtype=torch.float64) for a, b in pairs)
            self.cell = nn.Linear(widths[0], memory, dtype=torch.float64) if memory else None
        if memory:
            self.log_time = nn.Parameter(torch.zeros(memory, dtype=torch.float64))
        self.forget()

    def _check(self, shift: Sequence[float] | None, scale: Sequence[float] | None, output: float) -> None:
        """Raise InputError where the options do not describe a network."""
        if not self.inputs or len(set(self.inputs)) < len(self.inputs):
            raise InputError(
                f"{self.kind} has inputs {list(self.inputs)}; name each signal once, at least one."
            )
        if not all(type(width) is int and 1 <= width <= MOST_NEURONS for width in self.hidden):
            raise InputError(
                f"{self.kind} has hidden {str(list(self.hidden))[:60]}; give whole numbers from 1 to {MOST_NEURONS}."
            )
        if len(self.hidden) > MOST_LAYERS:
            raise InputError(f"{self.kind} has {len(self.hidden)} hidden layers; give {MOST_LAYERS} at most.")
        if not (type(self.memory) is int and 0 <= self.memory <= MOST_STATES):
            raise InputError(
                f"{self.kind} has memory {str(self.memory)[:60]}; give a whole number from 0 to {MOST_STATES}."
            )
        numbers = [*(shift or []), *(scale or []), output, 1.0 if self.lipschitz is None else self.lipschitz]
        lengths = {len(part) for part in (shift, scale) if part is not None} | {len(self.inputs)}
        positive = [*(scale or []), *numbers[-2:]]
        if len(lengths) > 1 or not all(map(math.isfinite, numbers)) or not all(v > 0 for v in positive):
            raise InputError(
                f"{self.kind} needs one shift and one positive scale for each of its {len(self.inputs)} inputs, and "
                "a positive output_scale and lipschitz; correct its options."
            )

    def forget(self) -> None:
        """Draw all weights anew from the seed, the last layer's zero, and with them the output.

        They are drawn on the CPU, since a GPU's generator gives other numbers.
        """
        with torch.random.fork_rng(devices=[]), torch.no_grad():
            torch.default_generator.manual_seed(self.seed)
            for layer in (*self.layers, *([] if self.cell is None else [self.cell])):
                linear = cast(nn.Linear, layer)
                sizes = linear.in_features, linear.out_features
                linear.load_state_dict(nn.Linear(*sizes, device="cpu", dtype=torch.float64).state_dict())
            if self.memory:
                first, last = map(math.log, MEMORY_TIMES)
                self.log_time.copy_(
                    torch.linspace(first, last, self.memory, dtype=torch.float64, device=self.log_time.device)
                )
            for weight in self.last_weights().values():
                nn.init.zeros_(weight)

    def last_weights(self) -> dict[str, nn.Parameter]:
        """Those of the weights that the output is proportional to, by name."""
        last = f"layers.{len(self.layers) - 1}."
        return {name: w for name, w in self.weights().items() if name.startswith(last)}

    def weights(self) -> dict[str, nn.Parameter]:
        """The weights by name."""
        return {name: w for name, w in self.named_parameters() if name not in self.declared}

    def output(self, p: SimpleNamespace, signals: Sequence[Tensor], states: Sequence[Tensor]) -> Tensor:
        """What the network adds in its place, ``(B,)``, in the place's unit.

        Args:
            p: parameter view; weights of each lane's own, ``(*shape, B)`` by name, take the stored ones' place.
            signals: inputs in their units, ``(B,)`` each.
            states: hidden states, ``(B,)`` each.
        """
        z = self._scaled(signals, states)
        bound = None if self.lipschitz is None else self.lipschitz ** (1.0 / len(self.layers))
        for k in range(len(self.layers)):
            weight = self._weight(p, f"layers.{k}.weight")
            if bound is not None:
                weight = weight * (bound / weight.abs().sum(1, keepdim=True).clamp_min(bound))
            z = _affine(weight, self._weight(p, f"layers.{k}.bias"), torch.tanh(z) if k else z)
        return self.output_scale * z[0] + p.b_0

    def state_updates(
        self, p: SimpleNamespace, signals: Sequence[Tensor], states: Sequence[Tensor]
    ) -> list[tuple[Tensor, Tensor]]:
        """Drive and rate [1/s] of each hidden state, ``dh/dt = drive - rate h``; arguments as for ``output``."""
        if not self.memory:
            return []
        weight, bias = self._weight(p, "cell.weight"), self._weight(p, "cell.bias")
        target = torch.tanh(_affine(weight, bias, self._scaled(signals, states)))
        rates = torch.exp(-self._weight(p, "log_time"))
        rates = rates if rates.dim() == 2 else rates[:, None].expand_as(target)
        return list(zip((rates * target).unbind(0), rates.unbind(0), strict=True))

    def _scaled(self, signals: Sequence[Tensor], states: Sequence[Tensor]) -> Tensor:
        """Scaled inputs and hidden states, ``(n, B)``."""
        z = torch.stack(torch.broadcast_tensors(*signals, *states))
        count = len(self.inputs)
        scaled = (z[:count] - self.shift[:, None]) / self.scale[:, None]
        if "direction" in self.inputs:  # bounded, so that a neuron may weigh it against other inputs
            signs = torch.tensor([name == "direction" for name in self.inputs], device=z.device)
            scaled = torch.where(signs[:, None], torch.tanh(scaled), scaled)
        return torch.cat([scaled, z[count:]]) if self.memory else scaled

    def _weight(self, p: SimpleNamespace, name: str) -> Tensor:
        own = getattr(p, name, None)
        return self.get_parameter(name) if own is None else own

    def options(self) -> dict[str, Any]:
        """Options of a new network of the same structure and scales; those of a model file."""
        found: dict[str, Any] = {"inputs": list(self.inputs), "hidden": list(self.hidden)}
        found |= {"memory": self.memory} if self.memory else {}
        found |= {} if self.lipschitz is None else {"lipschitz": self.lipschitz}
        found |= {"seed": self.seed, "shift": self.shift.tolist(), "scale": self.scale.tolist()}
        return found | {"output_scale": self.output_scale.item()}

    @classmethod
    def restored(
        cls, values: Mapping[str, Bounded], options: Mapping[str, Any], weights: Mapping[str, Any]
    ) -> ResidualNetwork:
        """The network of a model file; InputError names a fault in its options or weights."""
        known = {"inputs", "hidden", "memory", "lipschitz", "seed", "shift", "scale", "output_scale"}
        if unknown := set(options) - known:
            raise InputError(f"{cls.kind} has no option '{min(unknown)}'; it has {', '.join(sorted(known))}.")
        try:
            part = cls(**options, **cast("Mapping[str, Any]", values))
        except (TypeError, ValueError, RuntimeError):
            raise InputError(
                f"{cls.kind} has an option of the wrong type; compare with a saved model."
            ) from None
        own = part.weights() if weights else {}
        if set(weights) != set(own):
            raise InputError(
                f"{cls.kind} has the weights {', '.join(own)}, but {', '.join(weights)} are given; "
                "give all of them, or none for a fresh network."
            )
        for name, target in own.items():
            try:
                value = torch.tensor(weights[name], dtype=target.dtype)
            except (TypeError, ValueError):
                value = target.new_empty(0)
            if value.shape != target.shape or not bool(torch.isfinite(value).all()):
                shape = " x ".join(map(str, target.shape))
                raise InputError(
                    f"{cls.kind}: weights {name} must hold {shape} finite numbers; correct them."
                )
            with torch.no_grad():
                target.copy_(value)
        return part


def _affine(weight: Tensor, bias: Tensor, z: Tensor) -> Tensor:
    """``W z + b`` for inputs ``(n, B)``; weights ``(m, n)``, or ``(m, n, B)`` where each lane has its own."""
    if weight.dim() == 2:
        return weight @ z + bias[:, None]
    return (weight * z).sum(1) + bias
