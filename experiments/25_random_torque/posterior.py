"""Which sets of causes the records tell of: the evidence of each set by Gram matrices, base parameters out.

Source: the evidence of linear Gaussian models with a spike-and-slab prior, as in E. I. George, R. E. McCulloch,
"Approaches for Bayesian variable selection", Statistica Sinica 7, 1997.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from causes import Cause
from random_torque import RandomTorque
from torch import Tensor

from hybrid_id.simulation.lifted import Linearisation

SLAB = 2.0
"""Standard deviation of a cause's size, in its usual sizes."""
STRENGTHS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.05)
"""Shares of the random torque's strength beside the base model, of which each set has the likeliest."""
MOST, BEAM = 4, 60
"""Causes of a set at most; sets of each size that are extended."""


@dataclass(frozen=True)
class Sets:
    """Sets of one size.

    Attributes:
        members: numbers of the causes, ``(N, k)``.
        evidence: logarithm of each one's marginal likelihood, ``(N,)``.
        prior: logarithm of its prior, ``(N,)``.
        sizes: of the causes in their usual sizes, ``(N, k)``.
        errors: their standard errors, ``(N, k)``.
        strength: share of the random torque that is left, ``(N,)``.
    """

    members: Tensor
    evidence: Tensor
    prior: Tensor
    sizes: Tensor
    errors: Tensor
    strength: Tensor


class Posterior:
    """The causes of one linearisation.

    Args:
        likelihood: of the records, with the base model's noise.
        lin: the base model about the smoothed states.
        found: candidates.
        precision: of the base parameters' prior, ``(n_f,)``.
        pull: its gradient there, ``(n_f,)``.
    """

    def __init__(
        self,
        likelihood: RandomTorque,
        lin: Linearisation,
        found: Sequence[Cause],
        precision: Tensor,
        pull: Tensor,
    ) -> None:
        self.causes = list(found)
        self.kinds = list(dict.fromkeys(cause.kind for cause in found))
        self.kind = torch.tensor([self.kinds.index(cause.kind) for cause in found])
        self.starts = torch.bincount(self.kind, minlength=len(self.kinds)).double()
        self.one_sided = torch.tensor([cause.one_sided for cause in found])
        state = torch.stack([cause.state for cause in found], -1)
        seen = torch.stack([cause.seen for cause in found], -1)
        known, noise = len(likelihood.free), likelihood.noise
        self.told: list[tuple[Tensor, Tensor, float]] = []
        for share in STRENGTHS:
            likelihood.noise = noise.with_strength(share)
            predictions = likelihood.columns(lin, state, seen)
            flat = predictions.errors.flatten(0, 2)
            gram = flat.T @ flat
            hessian = gram[1 : known + 1, 1 : known + 1] + torch.diag(precision)
            cross, gradient = gram[known + 1 :, 1 : known + 1], gram[1 : known + 1, 0] + pull
            back = torch.linalg.solve(hessian, torch.cat([cross.T, gradient[:, None]], 1))
            constant = -0.5 * float(gram[0, 0] - gradient @ back[:, -1] + predictions.log_variance.sum())
            constant -= 0.5 * float(torch.logdet(hessian) - precision.clamp_min(1e-300).log().sum())
            self.told.append(
                (
                    gram[known + 1 :, known + 1 :] - cross @ back[:, :-1],
                    gram[known + 1 :, 0] - cross @ back[:, -1],
                    constant,
                )
            )
        likelihood.noise = noise

    def evaluate(self, members: Tensor) -> Sets:
        """Evidence and sizes of sets ``(N, k)``."""
        k = members.shape[1]
        tried: list[Tensor] = []
        for number, (gram, gradient, constant) in enumerate(self.told):
            h = gram[members[:, :, None], members[:, None, :]] + torch.eye(k).to(gram) / SLAB**2
            g = gradient[members]
            sizes = -torch.linalg.solve(h, g[..., None])[..., 0]
            errors = torch.linalg.inv(h).diagonal(dim1=1, dim2=2).sqrt()
            value = constant - 0.5 * (g * sizes).sum(1) - 0.5 * torch.logdet(h) - k * math.log(SLAB)
            sided = torch.special.log_ndtr(sizes / errors) + math.log(2.0)
            value = value + torch.where(self.one_sided[members], sided, torch.zeros_like(sided)).sum(1)
            # beyond a bound it holds the others where they would not be without it
            value = value.masked_fill((self.one_sided[members] & (sizes < -errors)).any(1), -torch.inf)
            strength = torch.full_like(value[:, None], STRENGTHS[number])
            tried.append(torch.cat([value[:, None], sizes, errors, strength], 1))
        each = torch.stack(tried)
        part = each[each[..., 0].argmax(0), torch.arange(len(members))]
        classes = len(self.kinds)
        prior = (
            -k * math.log(2.0)
            - math.log(math.comb(classes, k))
            - self.starts[self.kind[members]].log().sum(1)
        )
        return Sets(members, part[:, 0], prior, part[:, 1 : k + 1], part[:, k + 1 : -1], part[:, -1])

    def search(self) -> list[Sets]:
        """Sets of each size from none on, the likeliest first: all that extend the best of the size before."""
        found = [self.evaluate(torch.zeros(1, 0, dtype=torch.long))]
        for _ in range(MOST):
            heads = found[-1].members[:BEAM]
            each = torch.arange(len(self.causes))
            members = torch.cat([heads.repeat_interleave(len(each), 0), each.repeat(len(heads))[:, None]], 1)
            kinds = self.kind[members].sort(1).values
            members = members[(kinds[:, 1:] != kinds[:, :-1]).all(1)]
            if len(members) == 0:
                break
            members = torch.unique(members.sort(1).values, dim=0)
            sets = self.evaluate(members)
            order = (sets.evidence + sets.prior).argsort(descending=True)
            found.append(Sets(*(getattr(sets, name)[order] for name in vars(sets))))
        return found

    def probabilities(self, found: Sequence[Sets]) -> dict[tuple[str, str], float]:
        """Probability of each kind of cause."""
        total = torch.logsumexp(torch.cat([sets.evidence + sets.prior for sets in found]), 0)
        chance = torch.zeros(len(self.kinds)).to(total)
        for sets in found[1:]:
            weight = (sets.evidence + sets.prior - total).exp()
            chance.index_add_(
                0, self.kind[sets.members].flatten(), weight.repeat_interleave(sets.members.shape[1])
            )
        return dict(zip(self.kinds, chance.tolist(), strict=True))
