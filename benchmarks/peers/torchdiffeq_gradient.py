"""torchdiffeq: one gradient of the single-shooting loss of one record, as its examples do it.

A whole fit by Adam needs hundreds to thousands of such gradients, so only one is timed. By default over the first
500 samples, and scaled up to the record's length (cost grows in proportion: a Python call per stage).
"""

from __future__ import annotations

import time

import torch
from torchdiffeq import odeint, odeint_adjoint

from benchmarks.reference import SAMPLE_TIME, SMOOTHING, SUB_STEPS, Problem

torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)


class Drive(torch.nn.Module):
    """dx/dt of x = (q, v) with the voltage held between samples."""

    def __init__(self, theta: torch.Tensor, voltage: torch.Tensor):
        super().__init__()
        self.theta, self.voltage = torch.nn.Parameter(theta), voltage

    def forward(self, t: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        inertia, p_m1, p_m2, f_11, f_12, f_13, f_14, f_21, f_22, f_23, f_24, f_3 = self.theta
        sample = min(int(t.item() / SAMPLE_TIME + 1e-6), len(self.voltage) - 1)
        u, v = self.voltage[sample], x[1]
        forward = v > 0
        base, peak = torch.where(forward, f_11, f_21), torch.where(forward, f_12, f_22)
        speed, width = torch.where(forward, f_13, f_23), torch.where(forward, f_14, f_24)
        level = base + (peak - base) * torch.exp(-(((torch.abs(v) - speed) / width) ** 2))
        a = (p_m1 * (u - p_m2 * v) - level * torch.tanh(v / SMOOTHING) - f_3 * v) / inertia
        return torch.stack([v, a])


def gradient_seconds(problem: Problem, *, n_samples: int = 500, adjoint: bool = False) -> float:
    """Seconds of one gradient, scaled to the whole record."""
    drive = Drive(torch.tensor(problem.starts[0]), torch.tensor(problem.voltage[0, :n_samples]))
    measured = torch.tensor(problem.angle[0, :n_samples])
    time_points = SAMPLE_TIME * torch.arange(n_samples)
    solver = odeint_adjoint if adjoint else odeint
    begin = time.process_time()
    options = {"step_size": SAMPLE_TIME / SUB_STEPS}
    states = solver(drive, torch.zeros(2), time_points, method="rk4", options=options)
    ((states[:, 0] - measured) ** 2).mean().backward()
    seconds = time.process_time() - begin
    if not torch.isfinite(drive.theta.grad).all():
        raise FloatingPointError("the gradient is not finite")
    return seconds * (problem.voltage.shape[1] - 1) / (n_samples - 1)
