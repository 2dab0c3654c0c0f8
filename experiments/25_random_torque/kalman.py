"""Prediction errors of linear maps that noise pushes, and their states as all samples tell them.

A row's states follow ``z_{k+1} = a_k z_k + b_k (1, eta) + noise of variance q_k`` and are seen through noise as
``c_k z_k = e_k (1, eta)``; eta are whatever the first column is to be linear in. One pass gives the prediction errors
of all columns divided by their standard deviation: those of the first column are white where the map is right, and
their squares with the logarithms of the variances are its likelihood.

Source: L. Ljung, System Identification, 2nd ed., 1999, 7.4 (prediction errors as a likelihood); P. de Jong, "Smoothing
and interpolation with the state-space model", Journal of the American Statistical Association 84, 1989.
"""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import call, library


@dataclass(frozen=True)
class Maps:
    """Linear maps of R rows over T samples, n_z states, n_y outputs, n_c columns.

    Attributes:
        a: the next state by the state, ``(R, T, n_z, n_z)``.
        b: what is added to it in each column, ``(R, T, n_z, n_c)``.
        q: variance of its noise, ``(R, T, n_z)``.
        c: outputs by states, ``(R, T, n_y, n_z)``.
        e: what is seen in each column, ``(R, T, n_y, n_c)``.
        noise: variance of each measurement, ``(R, T, n_y)``; 0 where there is none.
        mean: of the first state in each column, ``(R, n_z, n_c)``.
        covariance: of the first state, ``(R, n_z, n_z)``.
    """

    a: Tensor
    b: Tensor
    q: Tensor
    c: Tensor
    e: Tensor
    noise: Tensor
    mean: Tensor
    covariance: Tensor


@dataclass(frozen=True)
class Predictions:
    """What :func:`predict` returns.

    Attributes:
        errors: of each column, in standard deviations, ``(R, T, n_y, n_c)``; 0 where nothing was measured.
        log_variance: sum of the logarithms of their variances, ``(R,)``.
        covariance, mean: of the states before each sample's outputs, ``(R, T, n_z, n_z)`` and ``(R, T, n_z, n_c)``;
            empty where they were not to be kept.
    """

    errors: Tensor
    log_variance: Tensor
    covariance: Tensor
    mean: Tensor


def predict(maps: Maps, *, keep: bool = False) -> Predictions:
    """Prediction errors of all columns, by the Kalman filter: in C where that can be.

    Args:
        maps: what is filtered.
        keep: whether :func:`smooth` is to follow.
    """
    (rows, samples, n_z, n_c), n_y = maps.b.shape, maps.c.shape[2]
    errors, log_variance = maps.b.new_zeros(rows, samples, n_y, n_c), maps.b.new_zeros(rows)
    kept = (rows, samples) if keep else (0, 0)
    before_p, before_m = maps.b.new_empty(*kept, n_z, n_z), maps.b.new_empty(*kept, n_z, n_c)
    p, m = maps.covariance.clone().contiguous(), maps.mean.clone().contiguous()
    if (code := _code(maps.b)) is not None:
        parts = [part.contiguous() for part in (maps.a, maps.b, maps.q, maps.c, maps.e, maps.noise)]
        work = maps.b.new_empty(n_z * (n_z + n_c + 2))
        call(
            code,
            "filter",
            errors,
            log_variance,
            before_p,
            before_m,
            p,
            m,
            *parts,
            work,
            rows,
            samples,
            n_z,
            n_c,
            n_y,
            int(keep),
        )
        return Predictions(errors, log_variance, before_p, before_m)
    for k in range(samples):
        if keep:
            before_p[:, k], before_m[:, k] = p, m
        for o in range(n_y):
            row, seen = maps.c[:, k, o], maps.noise[:, k, o] > 0
            gain = (p @ row[..., None])[..., 0]
            variance = torch.where(seen, maps.noise[:, k, o] + (row * gain).sum(1), 1.0)
            left = maps.e[:, k, o] - (row[:, None] @ m)[:, 0]
            scale = seen / variance.sqrt()
            errors[:, k, o], log_variance = left * scale[:, None], log_variance + variance.log()
            scaled = gain * scale[:, None]
            m = m + scaled[..., None] * errors[:, k, o, None]
            p = p - scaled[..., None] * scaled[:, None]
        a = maps.a[:, k]
        m = a @ m + maps.b[:, k]
        p = a @ p @ a.transpose(1, 2) + torch.diag_embed(maps.q[:, k])
    return Predictions(errors, log_variance, before_p, before_m)


def smooth(maps: Maps, kept: Predictions, eta: Tensor) -> tuple[Tensor, Tensor]:
    """States ``(R, T, n_z)`` as all samples tell them where the columns have these weights, and their variances.

    Args:
        maps: what was filtered.
        kept: of :func:`predict`, with what it keeps.
        eta: weights of all columns but the first, ``(n_c - 1,)``.
    """
    (rows, samples, n_z, _), n_y = maps.b.shape, maps.c.shape[2]
    weights = torch.cat([eta.new_ones(1), eta])
    mean, e = kept.mean @ weights, maps.e @ weights
    states, variances = mean.new_empty(rows, samples, n_z), mean.new_empty(rows, samples, n_z)
    if (code := _code(maps.b)) is not None:
        parts = [part.contiguous() for part in (kept.covariance, mean, maps.a, maps.c, e, maps.noise)]
        work = mean.new_empty(n_z * (4 * n_z + n_y + 3) + 2 * n_y)
        call(code, "smooth", states, variances, *parts, work, rows, samples, n_z, n_y)
        return states, variances
    told, precision = mean.new_zeros(rows, n_z), mean.new_zeros(rows, n_z, n_z)
    identity = torch.eye(n_z, dtype=mean.dtype, device=mean.device)
    for k in reversed(range(samples)):
        a = maps.a[:, k]
        told, precision = (a.transpose(1, 2) @ told[..., None])[..., 0], a.transpose(1, 2) @ precision @ a
        p, m, steps = kept.covariance[:, k], mean[:, k], []
        for o in range(n_y):
            row, seen = maps.c[:, k, o], (maps.noise[:, k, o] > 0).to(mean.dtype)
            gain = (p @ row[..., None])[..., 0]
            variance = torch.where(seen > 0, maps.noise[:, k, o] + (row * gain).sum(1), 1.0)
            left = seen * (e[:, k, o] - (row * m).sum(1))
            gain = gain * (seen / variance)[:, None]
            steps.append((row * seen[:, None], gain, left, variance))
            p, m = p - gain[..., None] * (gain * variance[:, None])[:, None], m + gain * left[:, None]
        for row, gain, left, variance in reversed(steps):
            through = identity - gain[..., None] * row[:, None]
            told = row * (left / variance)[:, None] + (through.transpose(1, 2) @ told[..., None])[..., 0]
            precision = through.transpose(1, 2) @ precision @ through
            precision = precision + row[..., None] * row[:, None] / variance[:, None, None]
        ahead = kept.covariance[:, k]
        states[:, k] = mean[:, k] + (ahead @ told[..., None])[..., 0]
        variances[:, k] = (ahead - ahead @ precision @ ahead).diagonal(dim1=1, dim2=2)
    return states, variances


def _code(like: Tensor) -> ctypes.CDLL | None:
    return _compiled() if like.device.type == "cpu" and like.dtype == torch.float64 else None


@functools.cache
def _compiled() -> ctypes.CDLL | None:
    try:
        source = Path(__file__).with_name("kalman.c").read_text(encoding="utf-8")
        return library(source, ("filter", "smooth"))
    except InputError:
        return None
