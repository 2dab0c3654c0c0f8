"""Condensing in C: one pass over the samples of each row, for any number of states and parameters."""

from __future__ import annotations

import ctypes
import functools

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import call, library

FLAGS = ("-O2", "-ftree-vectorize", "-march=native", "-std=gnu11", "-fPIC")
BLOCK = 16
"""Samples whose Jacobians are gathered at once: two lines of cache of each element."""
SOURCE = """\
/* strides of a, b and next by row, sample, state and column; block has room for BLOCK samples */
void condense(double *chain, double *restrict block, const double *x, const double *a, const double *b,
              const double *next, const long *strides, long rows, long samples, long n_x, long n_f, long BLOCK)
{
    const long *of_a = strides, *of_b = strides + 4, *of_next = strides + 8;
    const long through = n_x + n_f, columns = through + 1, size = n_x * columns;
    for (long r = 0; r < rows; r++) {
        double *now = chain + r * samples * size;
        for (long i = 0; i < n_x; i++)
            for (long j = 0; j < columns; j++) now[i * columns + j] = i == j;
        for (long first = 0; first + 1 < samples; first += BLOCK) {
            const long count = samples - 1 - first < BLOCK ? samples - 1 - first : BLOCK;
            for (long i = 0; i < n_x; i++) {
                for (long j = 0; j < through; j++) {
                    const int state = j < n_x;
                    const long *of = state ? of_a : of_b, stride = of[1];
                    const double *from = (state ? a : b) + r * of[0] + first * stride + i * of[2];
                    from += (state ? j : j - n_x) * of[3];
                    for (long t = 0; t < count; t++) block[t * size + i * columns + j] = from[t * stride];
                }
                const double *from = next + r * of_next[0] + first * of_next[1] + i * of_next[2];
                const double *node = x + (r * samples + first + 1) * n_x + i;
                for (long t = 0; t < count; t++)
                    block[t * size + i * columns + through] = from[t * of_next[1]] - node[t * n_x];
            }
            for (long t = 0; t < count; t++) {
                const double *of = block + t * size;
                double *restrict then = now + size;
                for (long i = 0; i < n_x; i++, of += columns) {
                    double *restrict row = then + i * columns;
                    for (long j = 0; j < columns; j++) row[j] = j < n_x ? 0.0 : of[j];
                    for (long m = 0; m < n_x; m++) {
                        const double share = of[m], *start = now + m * columns;
                        for (long j = 0; j < columns; j++) row[j] += share * start[j];
                    }
                }
                now = then;
            }
        }
    }
}
"""


def condense_rows(x: Tensor, a: Tensor, b: Tensor, x_next: Tensor) -> Tensor | None:
    """What :func:`hybrid_id.simulation.lifted.condense` returns; None where there is no C compiler or it is a GPU's.

    Args:
        x: nodes, ``(R, T, n_x)``.
        a: d x_next / d x, ``(R, T, n_x, n_x)``.
        b: d x_next / d theta, ``(R, T, n_x, n_f)``.
        x_next: Phi of each node, ``(R, T, n_x)``.
    """
    parts = (x, a, b, x_next)
    if any(part.device.type != "cpu" or part.dtype != torch.float64 for part in parts):
        return None
    if (code := _code()) is None:
        return None
    (rows, samples, n_x), n_f = x.shape, b.shape[-1]
    chain = x.new_empty(rows, samples, n_x, n_x + n_f + 1)
    block = x.new_empty(BLOCK, n_x, n_x + n_f + 1)
    strides = torch.tensor([*a.stride(), *b.stride(), *x_next.stride()])
    call(
        code, "condense", chain, block, x.contiguous(), a, b, x_next, strides, rows, samples, n_x, n_f, BLOCK
    )
    return chain


@functools.cache
def _code() -> ctypes.CDLL | None:
    try:
        return library(SOURCE, FLAGS)
    except InputError:
        return None
