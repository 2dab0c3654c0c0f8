"""Baseline: residual networks alone, which say where something is missing and how it looks, but not what it is.

For each joint the acceleration is regressed, as in :mod:`.reconstruct`, on what the nominal model has, plus one small
network that reads what acts in a place: the speed for friction, the rotor's angle for the motor, the link's angle for
the load, the command for the input. The network that predicts a record left out best gives the place and the profile.
As it has no names, it says "unknown" wherever it predicts clearly better than the physics alone.

At the joints of a robot it is one network each with a memory, gated recurrent units (K. Cho et al., EMNLP 2014), that
reads the joint's angle, speed, acceleration and command.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid_id.baselines.answer import answer, named
from hybrid_id.baselines.reconstruct import Torque, reconstructed
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

PLACES = {"motor_friction": "speed", "motor": "rotor angle", "load": "link angle", "input": "command"}
"""What the network of each place reads."""
HIDDEN = 8
ITERATIONS = 60
EPOCHS, RATE = 70, 0.03
"""Steps of Adam's method for a network with a memory, and their size."""
CLEAR = 1.05
"""Ratio of RMS errors on the record left out from which a network has found something."""


def network(dataset: Dataset, system: System) -> dict[str, Any]:
    """Train a network for each place of each joint, and tell where the best one sits."""
    found: list[tuple[float, str, dict[str, Any]]] = []
    for k, name in enumerate(() if system.tree is None else system.tree.names):
        records = [reconstructed(dataset, record, system, k) for record in dataset.train]
        found.append((recurrent(records[:-1] or records, records[-1]), f"{name}/load", {"joint": name}))
    for joint in system.joints if system.tree is None else ():
        records = [reconstructed(dataset, record, system, joint.number - 1) for record in dataset.train]
        for place, signal in PLACES.items():
            ratio, profile = trained(records[:-1] or records, records[-1], place)
            about = {"joint": joint.name, "place": place, "signal": signal, "profile": profile}
            found.append((ratio, f"{joint.name}/{place}", about))
    found.sort(key=lambda one: -one[0])
    share = np.array([max(ratio - 1.0, 0.0) for ratio, _, _ in found])
    share = share / max(float(share.sum()), 1e-12)
    effects = [named("residual_network", where, p) for p, (_, where, _) in zip(share, found, strict=True)]
    content = answer(dataset.name, effects, {}, unknown=found[0][0] >= CLEAR)
    return content | {"location": [about for _, _, about in found[:3]]}


def recurrent(train: Sequence[Torque], held: Torque) -> float:
    """Ratio of RMS errors of a robot's joint on the record left out, physics alone over physics with a network."""
    own, target, signal = (
        np.concatenate([part(one) for one in train])
        for part in (lambda t: t.own, lambda t: t.target, lambda t: t.signals["joint"])
    )
    weights = np.linalg.lstsq(own, target, rcond=None)[0]
    level = float(np.std(target - own @ weights)) or 1.0
    middle, spread = signal.mean(0), np.where((s := signal.std(0)) > 0, s, 1.0)
    torch.manual_seed(0)
    memory, last = nn.GRU(signal.shape[1], HIDDEN).double(), nn.Linear(HIDDEN, 1).double()
    nn.init.zeros_(last.weight)
    optimizer = torch.optim.Adam([*memory.parameters(), *last.parameters()], lr=RATE)

    def rows(records: Sequence[Torque]) -> tuple[Tensor, Tensor]:
        """What the network reads and what physics leaves, as long as the shortest record: (T, R, k) and (T, R)."""
        length = min(len(one.target) for one in records)
        reads = [(one.signals["joint"][:length] - middle) / spread for one in records]
        rest = [(one.target - one.own @ weights)[:length] / level for one in records]
        return torch.tensor(np.stack(reads, 1)), torch.tensor(np.stack(rest, 1))

    def left(reads: Tensor, rest: Tensor) -> Tensor:
        return (rest - last(memory(reads)[0])[..., 0]).square().mean()

    seen, unseen = rows(train), rows([held])
    for _ in range(EPOCHS):
        optimizer.zero_grad()
        loss = left(*seen)
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        alone, both = float(unseen[1].square().mean()), float(left(*unseen))
    return float(np.sqrt(alone / max(both, 1e-12)))


def trained(train: Sequence[Torque], held: Torque, place: str) -> tuple[float, dict[str, list[float]]]:
    """Ratio of RMS errors on the record left out, physics alone over physics with a network; the network's profile."""
    own, signal, target = (
        np.concatenate([getattr(t, name)[place] if name == "signals" else getattr(t, name) for t in train])
        for name in ("own", "signals", "target")
    )
    size = np.where((norm := np.sqrt(np.mean(own**2, 0))) > 0, norm, 1.0)
    level = float(target.std()) or 1.0
    middle, spread = signal.mean(0), np.where((s := signal.std(0)) > 0, s, 1.0)
    torch.manual_seed(0)
    columns, aim = torch.tensor(own / size), torch.tensor(target / level)
    inputs = torch.tensor((signal - middle) / spread)
    weights = torch.linalg.lstsq(columns, aim[:, None]).solution
    last = nn.Linear(HIDDEN, 1)
    nn.init.zeros_(last.weight)
    net = nn.Sequential(nn.Linear(inputs.shape[1], HIDDEN), nn.Tanh(), last).double()
    alone = _rms(held, weights, None, size, level, torch.empty(0))
    linear = weights.clone().requires_grad_()
    unknowns = [linear, *net.parameters()]
    optimizer = torch.optim.LBFGS(unknowns, max_iter=ITERATIONS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        left = (aim - (columns @ linear + net(inputs))[:, 0]).square().mean()
        left.backward()
        return left

    optimizer.step(loss)  # type: ignore[arg-type]
    with torch.no_grad():
        test = torch.tensor((held.signals[place] - middle) / spread)
        both = _rms(held, linear, net, size, level, test)
        grid = np.linspace(signal.min(0), signal.max(0), 41)
        torque = level * net(torch.tensor((grid - middle) / spread))[:, 0].numpy()
    return alone / max(both, 1e-12), {"signal": grid[:, 0].tolist(), "acceleration": torque.tolist()}


def _rms(
    held: Torque, weights: Tensor, net: nn.Module | None, size: np.ndarray, level: float, inputs: Tensor
) -> float:
    """RMS error of the acceleration in a record."""
    predicted = torch.tensor(held.own / size) @ weights
    if net is not None:
        predicted = predicted + net(inputs)
    return float((torch.tensor(held.target / level) - predicted[:, 0]).square().mean().sqrt())
