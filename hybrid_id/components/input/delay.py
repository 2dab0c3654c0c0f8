"""Dead time between the logged command and the motor, of one joint or of all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import ClassVar

import torch
from torch import Tensor

from hybrid_id.components.base import Component, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class DeadTime(Component):
    """Base of what holds a command back: how far its past reaches, and what arrives."""

    places = ("input",)
    single = True
    order: ClassVar[int] = 1
    """Samples on either side of the moment, between which the command is taken."""
    T_d = Parameter(0.002, upper=0.15, unit="s", doc="dead time")

    def lags(self, sample_time: float) -> int:
        """Number of past samples that the longest delay reaches back to."""
        return math.ceil(self.specs["T_d"].upper / sample_time - 1e-9) + self.order

    def held(self, p: SimpleNamespace, history: Sequence[Tensor], sample_time: Tensor) -> Tensor:
        """Delayed channel, ``(B,)``, from it and its past samples, newest first."""
        samples = p.T_d / sample_time.clamp_min(1e-9)
        whole = samples.detach().floor().clamp(0, len(history) - 1 - self.order)
        first = 1 - self.order
        if bool((whole == (one := whole.flatten()[0])).all()):  # as it nearly always is
            taps = [history[max(int(one) + k, 0)] for k in range(first, self.order + 1)]
        else:
            past, pick = torch.stack(list(history)), whole.expand_as(history[0]).long()[None]
            taps = [past.gather(0, (pick + k).clamp_min(0))[0] for k in range(first, self.order + 1)]
        return self.between(taps, samples - whole, whole)

    def between(self, taps: Sequence[Tensor], share: Tensor, whole: Tensor) -> Tensor:
        """What arrives when a share of a sample has passed beyond a whole number of them, ``(B,)``."""
        raise NotImplementedError


class Delay(DeadTime):
    """``u'(t) = u(t - T_d)`` of a command that is held between samples, averaged over each sample.

    With ``T_d = (n + f) dt``, ``0 <= f < 1``: ``u'_k = (1 - f) u_{k-n} + f u_{k-n-1}``. What was logged before the
    record began is taken as its first value. T_d [s] is bounded by the history that is kept; a smaller upper bound
    keeps less. Dead time in the measurement looks the same from outside.

    Source: hold equivalent of a fractional delay, e.g. K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd
    ed., 1997, section 2.3, its two parts of a sample joined to their average.
    """

    kind = "delay"
    effect = Effect(
        "delay",
        "dead time between the command and the motor, of a bus or a sampled controller; usually one to three samples",
        "K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed., Prentice Hall, 1997",
        {
            "electrical_lag": "a fast sweep: a delay turns the phase on and on and weakens nothing, a lag turns it by "
            "a quarter at most and weakens the response",
            "joint_flexibility": "a slow sweep through the resonance: a spring raises the response there and weakens "
            "it above, a delay only turns its phase",
            "voltage_deadband": "the same sweep at two amplitudes: a dead band counts for less the larger the command, "
            "a delay stays",
            "backlash": "the same sweep at two amplitudes: play counts for less the larger the move, a delay stays",
        },
    )

    def between(self, taps, share, whole):
        newer, older = taps
        return newer + share * (older - newer)

    @staticmethod
    def starts(site):
        # a long history costs time, and few drives need one
        longest = min(0.06, 15.0 * site.sample_time)
        return [
            {"T_d": free(start * site.sample_time, 0.0, most)}
            for start, most in ((0.5, longest), (3.0, longest), (25.0, 5.0 * longest))
        ]


class CommonDelay(DeadTime):
    """``u_j'(t) = u_j(t - T_d)`` of the commands of all joints, by one T_d, at whatever joint it is listed.

    A bus or a sampled controller holds all commands back alike. A joint with a ``delay`` of its own has that instead.

    With ``T_d = (n + f) dt`` the sample takes the value that a cubic through the samples n - 1 .. n + 2 back has
    there, with central differences as its slopes. Unlike ``delay``'s average, which spreads a command over
    ``f (1 - f) dt^2``, it only shifts it, and its slope by T_d has no kinks. It is meant for goals that are smooth
    from sample to sample; at a step it overshoots by up to 7 % for a sample.

    Source: E. Catmull, R. Rom, A Class of Local Interpolating Splines, Computer Aided Geometric Design, 1974.
    """

    kind = "common_delay"
    order = 2

    def between(self, taps, share, whole):
        newest, newer, older, oldest = taps
        # nothing is known beyond the newest sample: a parabola goes on there
        newest = torch.where(whole < 1, 3.0 * (newer - older) + oldest, newest)
        slope, end = 0.5 * (older - newest), 0.5 * (oldest - newer)
        rise = older - newer
        bend = slope + end - 2.0 * rise
        return newer + share * (slope + share * (rise - slope - bend + share * bend))
