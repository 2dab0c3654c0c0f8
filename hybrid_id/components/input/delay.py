"""Dead time between the logged command and the motor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import Component, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Delay(Component):
    """``u'(t) = u(t - T_d)`` of a command that is held between samples, averaged over each sample.

    With ``T_d = (n + f) dt``, ``0 <= f < 1``: ``u'_k = (1 - f) u_{k-n} + f u_{k-n-1}``. What was logged before the
    record began is taken as its first value. T_d [s] is bounded by the history that is kept; a smaller upper bound
    keeps less. Dead time in the measurement looks the same from outside.

    Source: hold equivalent of a fractional delay, e.g. K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd
    ed., 1997, section 2.3, its two parts of a sample joined to their average.
    """

    kind = "delay"
    places = ("input",)
    single = True
    T_d = Parameter(0.002, upper=0.15, unit="s", doc="dead time")
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

    def lags(self, sample_time: float) -> int:
        """Number of past samples that the longest delay reaches back to."""
        return math.ceil(self.specs["T_d"].upper / sample_time - 1e-9) + 1

    def held(self, p: SimpleNamespace, history: Sequence[Tensor], sample_time: Tensor) -> Tensor:
        """Delayed channel, ``(B,)``, from it and its past samples, newest first."""
        samples = p.T_d / sample_time.clamp_min(1e-9)
        whole = samples.detach().floor().clamp(0, len(history) - 2)
        if bool((whole == (one := whole.flatten()[0])).all()):  # as it nearly always is
            newer, older = history[int(one)], history[int(one) + 1]
        else:
            past, pick = torch.stack(list(history)), whole.expand_as(history[0]).long()[None]
            newer, older = past.gather(0, pick)[0], past.gather(0, pick + 1)[0]
        return newer + (samples - whole) * (older - newer)

    @staticmethod
    def starts(site):
        # a long history costs time, and few drives need one
        longest = min(0.06, 15.0 * site.sample_time)
        return [
            {"T_d": free(start * site.sample_time, 0.0, most)}
            for start, most in ((0.5, longest), (3.0, longest), (25.0, 5.0 * longest))
        ]
