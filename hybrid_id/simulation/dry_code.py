"""C code of the dry engine: what :mod:`hybrid_id.simulation.step` does, lane by lane, around recorded equations."""

from __future__ import annotations

FLAGS = (
    "-O1", "-fexpensive-optimizations", "-ftree-vectorize", "-march=native", "-std=gnu11", "-fPIC", "-fopenmp-simd",
    "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fno-builtin-sin", "-fno-builtin-cos",
)  # fmt: skip
"""As exact as the eager engine: whether a joint sticks may hang on a difference that is zero. With -O1 alone GCC leaves
the upper halves of vector registers dirty, and every pow, exp or sin is ten times slower."""

STEPS = """\
#include <math.h>
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#if __GLIBC_PREREQ(2, 35) /* its vector library has them all */
$functions
#endif
#endif
#include <string.h>
enum { NX = $n_x, HELD = $held, NP = $n_p, FIXED = $n_fixed, ND = $n_dry, SPEEDS = $n_speeds, MANY = ND ? ND : 1 };
/* columns of tangents, by the state before and by free parameters; none where they are not asked for, else some idle
   ones beside them, so that they are whole vectors */
enum { NC = $n_columns, FULL = (NC + 7) / 8 * 8, MC = NC ? FULL : 1 };
#define COLUMNS _Pragma("omp simd") for (int c = 0; c < FULL; c++)
#define ALIGNED __attribute__((aligned(64))) /* GCC 12 takes arrays for aligned where it inlines, but does not align */
/* state row of each dry speed; those that the links of an arm couple, or NONE */
static const int row[MANY] = { $rows };
enum { NONE = MANY, FIRST = $first, SECOND = $second };

/* what depends on parameters alone */
static void prepare(const double *p, double *fixed)
{
$prepare
}

/* time derivative of the state for directions d of dry friction; x_t, k_t ... are tangents */
static void rates(const double *x, double (*x_t)[MC], const double *u, const double *p, const double *fixed,
                  const double *d, double *k, double (*k_t)[MC])
{
$rates
}

/* for each dry speed at rest: where it is pushed, how far beyond what friction holds, and the torque by which its
   acceleration contradicts its trial direction d; s are the directions now */
static void pushes(const double *x, const double *u, const double *p, const double *fixed, const double *s,
                   const double *d, double *side, double *over, double *against)
{
$pushes
}

/* x + step k, where the step's tangent is part h_t */
static void along(const double *x, double (*x_t)[MC], double step, double part, const double *h_t,
                  const double *k, double (*k_t)[MC], double *at, double (*at_t)[MC])
{
    for (int i = 0; i < NX; i++) {
        at[i] = x[i] + step * k[i];
        COLUMNS at_t[i][c] = x_t[i][c] + part * k[i] * h_t[c] + step * k_t[i][c];
    }
}

static void rk4(const double *x, double (*x_t)[MC], const double *u, const double *p, const double *fixed,
                const double *d, double h, const double *h_t, double *after, double (*after_t)[MC])
{
    double k[4][NX], k_t[4][NX][MC] ALIGNED;
    rates(x, x_t, u, p, fixed, d, k[0], k_t[0]);
    for (int stage = 1; stage < 4; stage++) {
        const double part = stage < 3 ? 0.5 : 1.0;
        along(x, x_t, part * h, part, h_t, k[stage - 1], k_t[stage - 1], after, after_t);
        rates(after, after_t, u, p, fixed, d, k[stage], k_t[stage]);
    }
    for (int i = 0; i < NX; i++) {
        k[0][i] = k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i];
        COLUMNS k_t[0][i][c] = k_t[0][i][c] + 2.0 * (k_t[1][i][c] + k_t[2][i][c]) + k_t[3][i][c];
    }
    along(x, x_t, h / 6.0, 1.0 / 6.0, h_t, k[0], k_t[0], after, after_t);
}

/* a speed at rest goes where it is pushed beyond its level; two coupled links find the one pair that agrees */
static void settle(const double *x, const double *u, const double *p, const double *fixed, double *d)
{
    static const double choices[3] = { 0.0, 1.0, -1.0 };
    double s[MANY + 1], side[MANY + 1], over[MANY + 1], against[MANY + 1], trial[MANY + 1], least = INFINITY;
    pushes(x, u, p, fixed, d, d, side, over, against);
    for (int i = 0; i < ND; i++) {
        s[i] = d[i];
        if (s[i] == 0.0) d[i] = over[i] > 0.0 ? side[i] : 0.0;
    }
    const int first = FIRST != NONE && s[FIRST] == 0.0, second = SECOND != NONE && s[SECOND] == 0.0;
    if (!first && !second) return;
    for (int a = 0; a < (first ? 3 : 1); a++)
        for (int b = 0; b < (second ? 3 : 1); b++) {
            double fault = -INFINITY;
            memcpy(trial, s, sizeof trial);
            if (first) trial[FIRST] = choices[a];
            if (second) trial[SECOND] = choices[b];
            pushes(x, u, p, fixed, s, trial, side, over, against);
            if (first) fault = fmax(fault, a ? against[FIRST] : over[FIRST]);
            if (second) fault = fmax(fault, b ? against[SECOND] : over[SECOND]);
            if (fault < least) {
                least = fault;
                if (first) d[FIRST] = choices[a];
                if (second) d[SECOND] = choices[b];
            }
        }
}

static void directions(const double *x, const double *u, const double *p, const double *fixed, double *d)
{
    int rests = 0;
    for (int i = 0; i < ND; i++) {
        d[i] = x[row[i]] > 0.0 ? 1.0 : x[row[i]] < 0.0 ? -1.0 : x[row[i]];
        rests |= d[i] == 0.0;
    }
    if (rests) settle(x, u, p, fixed, d);
}

/* direction in which held speeds break away within the step, else 0, and after which share of it, else 1 */
static void breakaways(const double *x, const double *after, const double *u, const double *p, const double *fixed,
                       const double *d, double *leaves, double *when)
{
    double side[MANY], short_of[MANY], over[MANY], against[MANY];
    int rests = 0;
    for (int i = 0; i < ND; i++) {
        leaves[i] = 0.0, when[i] = 1.0;
        rests |= d[i] == 0.0;
    }
    if (SPEEDS == 1 || !rests) return;
    pushes(x, u, p, fixed, d, d, side, short_of, against);
    pushes(after, u, p, fixed, d, d, side, over, against);
    for (int i = 0; i < ND; i++)
        if (d[i] == 0.0 && over[i] > 0.0) {
            const double share = short_of[i] / (short_of[i] - over[i]);
            leaves[i] = side[i];
            when[i] = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
        }
}

/* one step: to the moment at which a speed reaches zero or breaks away, and on from there */
static void slide(double *x, double (*x_t)[MC], const double *u, const double *p, const double *fixed, double h)
{
    double d[MANY], released[MANY] = { 0.0 }, leaves[MANY], when[MANY], after[NX], k[NX];
    double after_t[NX][MC] ALIGNED, k_t[NX][MC] ALIGNED, h_t[MC] ALIGNED = { 0.0 };
    double moment_t[MC] ALIGNED, late_t[MC] ALIGNED;
    for (int events = 2 * SPEEDS;; events--) {
        int first = -1, event = 0, passes = 0;
        double share = INFINITY;
        directions(x, u, p, fixed, d);
        for (int i = 0; i < ND; i++) {
            if (released[i] != 0.0) d[i] = released[i];
            x[row[i]] *= fabs(d[i]);  /* a speed that is held has forgotten its value */
            COLUMNS x_t[row[i]][c] *= fabs(d[i]);
        }
        rk4(x, x_t, u, p, fixed, d, h, h_t, after, after_t);
        breakaways(x, after, u, p, fixed, d, leaves, when);
        for (int i = 0; i < ND; i++) {
            const double v = x[row[i]], to = after[row[i]];
            const int crossed = d[i] * to < 0.0;
            const double at = crossed ? v / (v - to) : when[i];
            event |= crossed || leaves[i] != 0.0;
            if (crossed && events == 0) {
                after[row[i]] = 0.0;
                COLUMNS after_t[row[i]][c] = 0.0;
            }
            if (first < 0 || at < share) {
                share = at;
                first = i;
                passes = crossed;
            }
        }
        if (!event || events == 0) {
            memcpy(x, after, sizeof after);
            memcpy(x_t, after_t, sizeof after_t);
            return;
        }
        /* the chord's estimate of that moment, then one Newton step on the speed that reaches zero there */
        const int f = row[first];
        const double before = x[f], drop = before - after[f], moment = share * h;
        COLUMNS moment_t[c] = share * h_t[c]
            + (passes ? h * (before * after_t[f][c] - after[f] * x_t[f][c]) / (drop * drop) : 0.0);
        rk4(x, x_t, u, p, fixed, d, moment, moment_t, after, after_t);
        rates(after, after_t, u, p, fixed, d, k, k_t);
        const int slows = k[f] * before < 0.0;
        double late = slows ? after[f] / k[f] : 0.0;
        COLUMNS late_t[c] = slows ? (after_t[f][c] - late * k_t[f][c]) / k[f] : 0.0;
        /* no later than the step's end, no earlier than its start; where both are equal they share the tangent */
        const double low = moment - h, above = late > low ? 1.0 : late < low ? 0.0 : 0.5;
        late = late < low ? low : late;
        COLUMNS late_t[c] = above * late_t[c] + (1.0 - above) * (moment_t[c] - h_t[c]);
        const double below = late < moment ? 1.0 : late > moment ? 0.0 : 0.5;
        late = late > moment ? moment : late;
        COLUMNS late_t[c] = below * late_t[c] + (1.0 - below) * moment_t[c];
        along(after, after_t, -late, -1.0, late_t, k, k_t, x, x_t);
        x[f] = 0.0;
        COLUMNS x_t[f][c] = 0.0;
        for (int i = 0; i < ND; i++) released[i] = i == first ? leaves[i] : 0.0;
        h -= moment - late;
        COLUMNS h_t[c] -= moment_t[c] - late_t[c];
    }
}

"""
