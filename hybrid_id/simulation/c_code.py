"""C code around the recorded statements: loops over samples and sub-steps, condensing; how it is compiled."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from string import Template

from torch import Tensor

from hybrid_id.errors import InputError, MachineError

FLAGS = (
    "-O1", "-ftree-vectorize", "-march=native", "-std=gnu11", "-fPIC", "-fopenmp-simd", "-fno-math-errno",
    "-fno-trapping-math", "-fno-signed-zeros", "-freciprocal-math", "-ffp-contract=fast",
)  # fmt: skip
"""With -O3 the compiler takes twice as long for code that is a tenth faster."""
MOST_KEPT = 8000
"""Compiled steps in the user's cache, about 20 kB each."""
WIDTH = 16
"""Neighbouring samples that a loop of vector instructions takes at once."""


def compiler() -> str | None:
    """Name of the C compiler here, None where there is none."""
    return next((c for c in ("gcc", "clang", "cc") if shutil.which(c)), None)


@functools.cache
def library(source: str, flags: Sequence[str] = FLAGS) -> ctypes.CDLL:
    """The library that a C compiler makes of a source, kept for other processes and later runs.

    Raises:
        InputError: there is no compiler or it fails.
    """
    found = compiler()
    if found is None:
        raise InputError("Compiled steps need a C compiler; install gcc, or leave 'compiled' off.")
    kept = _shelf() / f"{_key(source, found, *flags)}.so"
    if (known := _loaded(kept)) is not None:
        return known
    with tempfile.TemporaryDirectory() as folder:
        code, built = Path(folder) / "steps.c", Path(folder) / "steps.so"
        code.write_text(source)
        vectors = ["-lmvec"] if "gcc" in found else []
        for extra in (vectors, []):
            done = subprocess.run(
                [found, *flags, "-shared", str(code), "-o", str(built), *extra, "-lm"],
                capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode == 0:
                with contextlib.suppress(OSError):  # a shelf that cannot be written to is no shelf
                    _put(built, kept)
                if (made := _loaded(kept) or _loaded(built)) is not None:
                    return made
                raise MachineError(
                    f"Nothing compiled may be run from {folder}; set TMPDIR, or leave 'compiled' off."
                )
        # killed for want of memory, or without room: another model would fail as well
        kind = MachineError if re.search("Killed|No space left", done.stderr) else InputError
        raise kind(f"The C compiler {found} failed, leave 'compiled' off: {done.stderr.strip()[-300:]}")


def _loaded(path: Path) -> ctypes.CDLL | None:
    """A library; None where it is not there, is damaged, or lies where nothing may be run."""
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def _shelf() -> Path:
    """Folder of compiled steps, in the user's cache; one that cannot be for a user without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hybrid_id"
    except RuntimeError:
        return Path(os.devnull) / "hybrid_id"


@functools.cache
def _machine() -> str:
    """What code for this processor depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.lower().startswith(("flags", "features"))), "")
    return f"{platform.platform()} {platform.machine()} {features or platform.node()}"


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join((_machine(), *parts)).encode()).hexdigest()[:32]


def _put(built: Path, kept: Path) -> None:
    """Copy under a name of its own, then rename: other processes see a whole library or none."""
    kept.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = kept.with_suffix(f".{os.getpid()}")
    shutil.copyfile(built, part)
    part.replace(kept)
    if len(os.listdir(kept.parent)) > MOST_KEPT:  # the older half; who has loaded one of them keeps it
        for old in sorted(kept.parent.glob("*.so"), key=os.path.getmtime)[: MOST_KEPT // 2]:
            old.unlink(missing_ok=True)


def call(code: ctypes.CDLL, name: str, *arguments: Tensor | int) -> None:
    """Call a function of a library with arrays (contiguous) and whole numbers."""
    values = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_long(a) for a in arguments]
    getattr(code, name)(*values)


TEMPLATE = Template("""\
#include <math.h>
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#if __GLIBC_PREREQ(2, 35) /* its vector library has them all */
$functions
#endif
#endif
#define W $width
/* said aloud: where a function is inlined, GCC 12 takes such arrays for aligned and leaves them unaligned */
#define ALIGNED __attribute__((aligned(64)))
enum { NX = $n_x, NU = $n_u, HELD = $held, NF = $n_f, NP = $n_p, NC = NX + NF, ALL = NC + 1 };

static void states(double x[NX][W], double u[NU][W], double step[W], const double *p)
{
$parameters
    #pragma omp simd
    for (int l = 0; l < W; l++) {
        const double h = step[l];
$states
    }
}

static void states_of_rows(double x[NX][W], double u[NU][W], double step[W], double p[NP][W])
{
    #pragma omp simd
    for (int l = 0; l < W; l++) {
        const double h = step[l];
$row_parameters
$states
    }
}

static void tangents(double x[NX][W], double c[NX][NC][W], double u[NU][W], double step[W], const double *p)
{
$parameters
    #pragma omp simd
    for (int l = 0; l < W; l++) {
        const double h = step[l];
$tangents
    }
}

static void hold(const double *u, const double *dt, long size, long at, long stride, int lanes,
                 double held[NU][W], double h[W])
{
    for (int l = 0; l < W; l++) {
        const long k = at + (l < lanes ? l : lanes - 1) * stride;
        for (int i = 0; i < HELD; i++) held[i][l] = u[i * size + k];
        h[l] = dt[k];
    }
}

void shoot(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long length,
           long sub_steps)
{
    double x[NX][W] ALIGNED, held[NU][W] ALIGNED, h[W] ALIGNED;
    for (long r = 0; r < rows; r++)
        for (long first = 0; first < samples; first += W * length) {
            const long left = (samples - first + length - 1) / length, at = r * samples + first;
            const int lanes = left < W ? left : W;
            for (int l = 0; l < W; l++)
                for (int i = 0; i < NX; i++)
                    x[i][l] = path[(at + (l < lanes ? l : lanes - 1) * length) * NX + i];
            for (long k = 0; k + 1 < length; k++) {
                int open = lanes;
                while (open > 0 && first + (open - 1) * length + k + 1 >= samples) open--;
                if (open == 0) break;
                hold(u, dt, rows * samples, at + k, length, open, held, h);
                for (long s = 0; s < sub_steps; s++) states(x, held, h, p + r * NP);
                for (int l = 0; l < open; l++)
                    for (int i = 0; i < NX; i++) path[(at + l * length + k + 1) * NX + i] = x[i][l];
            }
        }
}

void walk(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long sub_steps)
{
    double x[NX][W] ALIGNED, held[NU][W] ALIGNED, h[W] ALIGNED, own[NP][W] ALIGNED;
    for (long r = 0; r < rows; r += W) {
        const int lanes = rows - r < W ? rows - r : W;
        for (int l = 0; l < W; l++) {
            const long row = r + (l < lanes ? l : lanes - 1);
            for (int i = 0; i < NX; i++) x[i][l] = path[row * samples * NX + i];
            for (int i = 0; i < NP; i++) own[i][l] = p[row * NP + i];
        }
        for (long k = 0; k + 1 < samples; k++) {
            hold(u, dt, rows * samples, r * samples + k, samples, lanes, held, h);
            for (long s = 0; s < sub_steps; s++) states_of_rows(x, held, h, own);
            for (int l = 0; l < lanes; l++)
                for (int i = 0; i < NX; i++) path[((r + l) * samples + k + 1) * NX + i] = x[i][l];
        }
    }
}

void condensed(double *chain, const double *nodes, const double *u, const double *dt, const double *p, long rows,
               long samples, long sub_steps)
{
    double x[NX][W] ALIGNED, c[NX][NC][W] ALIGNED, held[NU][W] ALIGNED, h[W] ALIGNED;
    for (long r = 0; r < rows; r++) {
        double *now = chain + r * samples * NX * ALL;
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < ALL; j++) now[i * ALL + j] = i == j;
        for (long first = 0; first + 1 < samples; first += W) {
            const long at = r * samples + first;
            const int lanes = samples - 1 - first < W ? samples - 1 - first : W;
            for (int l = 0; l < W; l++)
                for (int i = 0; i < NX; i++) {
                    x[i][l] = nodes[(at + (l < lanes ? l : lanes - 1)) * NX + i];
                    for (int j = 0; j < NC; j++) c[i][j][l] = i == j;
                }
            hold(u, dt, rows * samples, at, 1, lanes, held, h);
            for (long s = 0; s < sub_steps; s++) tangents(x, c, held, h, p + r * NP);
            for (int l = 0; l < lanes; l++) {
                double *next = now + NX * ALL;
                for (int i = 0; i < NX; i++) {
                    for (int j = 0; j < ALL; j++) {
                        double sum = 0.0;
                        for (int m = 0; m < NX; m++) sum += c[i][m][l] * now[m * ALL + j];
                        next[i * ALL + j] = sum;
                    }
                    for (int j = NX; j < NC; j++) next[i * ALL + j] += c[i][j][l];
                    next[i * ALL + NC] += x[i][l] - nodes[(at + l + 1) * NX + i];
                }
                now = next;
            }
        }
    }
}
""")
