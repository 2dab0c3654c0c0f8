"""C code of the dry engine: what :mod:`hybrid_id.simulation.step` does, lane by lane, around recorded equations."""

from __future__ import annotations

from string import Template

FLAGS = ("-O1", "-std=gnu11", "-fPIC", "-fno-math-errno", "-ffp-contract=off")
"""As exact as the eager engine: whether a joint sticks may hang on a difference that is zero."""

TEMPLATE = Template("""\
#include <math.h>
enum { NX = $n_x, HELD = $held, NP = $n_p, FIXED = $n_fixed, ND = $n_dry, SPEEDS = $n_speeds, MANY = ND ? ND : 1 };
/* state row of each dry speed; the dry speeds, NONE where there is none, that the links of an arm couple */
static const int row[MANY] = { $rows };
enum { NONE = MANY, FIRST = $first, SECOND = $second };

/* what depends on parameters alone */
static void prepare(const double *p, double *fixed)
{
$prepare
}

/* time derivative of the state for directions d of dry friction */
static void rates(const double *x, const double *u, const double *p, const double *fixed, const double *d, double *k)
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

/* the states that remember, h seconds later at constant motion */
static void remember(double *x, const double *u, const double *p, const double *fixed, double h)
{
$remember
}

static void rk4(const double *x, const double *u, const double *p, const double *fixed, const double *d, double h,
                double *after)
{
    double k[4][NX], at[NX];
    rates(x, u, p, fixed, d, k[0]);
    for (int i = 0; i < NX; i++) at[i] = x[i] + (0.5 * h) * k[0][i];
    rates(at, u, p, fixed, d, k[1]);
    for (int i = 0; i < NX; i++) at[i] = x[i] + (0.5 * h) * k[1][i];
    rates(at, u, p, fixed, d, k[2]);
    for (int i = 0; i < NX; i++) at[i] = x[i] + h * k[2][i];
    rates(at, u, p, fixed, d, k[3]);
    for (int i = 0; i < NX; i++) after[i] = x[i] + h / 6.0 * (k[0][i] + 2.0 * (k[1][i] + k[2][i]) + k[3][i]);
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
            for (int i = 0; i < ND; i++) trial[i] = s[i];
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
        const double v = x[row[i]];
        d[i] = v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : v;
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
        leaves[i] = 0.0;
        when[i] = 1.0;
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
static void slide(double *x, const double *u, const double *p, const double *fixed, double h)
{
    double d[MANY], released[MANY] = { 0.0 }, leaves[MANY], when[MANY], after[NX], k[NX];
    for (int events = 2 * SPEEDS;; events--) {
        int first = -1;
        double share = INFINITY;
        directions(x, u, p, fixed, d);
        for (int i = 0; i < ND; i++) {
            if (released[i] != 0.0) d[i] = released[i];
            x[row[i]] *= fabs(d[i]);  /* a speed that is held has forgotten its value */
        }
        rk4(x, u, p, fixed, d, h, after);
        breakaways(x, after, u, p, fixed, d, leaves, when);
        int event = 0;
        for (int i = 0; i < ND; i++) {
            const double v = x[row[i]], to = after[row[i]];
            const int crossed = d[i] * to < 0.0;
            const double at = crossed ? v / (v - to) : when[i];
            event |= crossed || leaves[i] != 0.0;
            if (crossed && events == 0) after[row[i]] = 0.0;
            if (first < 0 || at < share) {
                share = at;
                first = i;
            }
        }
        if (!event || events == 0) {
            for (int i = 0; i < NX; i++) x[i] = after[i];
            return;
        }
        /* the chord's estimate of that moment, then one Newton step on the speed that reaches zero there */
        const double moment = share * h, before = x[row[first]];
        rk4(x, u, p, fixed, d, moment, after);
        rates(after, u, p, fixed, d, k);
        const double slope = k[row[first]];
        double late = slope * before < 0.0 ? after[row[first]] / slope : 0.0;
        late = late < moment - h ? moment - h : late;
        late = late > moment ? moment : late;
        for (int i = 0; i < NX; i++) x[i] = after[i] - late * k[i];
        x[row[first]] = 0.0;
        for (int i = 0; i < ND; i++) released[i] = i == first ? leaves[i] : 0.0;
        h -= moment - late;
    }
}

void shoot(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long length,
           long sub_steps)
{
    double x[NX], held[HELD + 1], fixed[FIXED + 1];
    for (long r = 0; r < rows; r++) {
        prepare(p + r * NP, fixed);
        for (long t = 0; t + 1 < samples; t++) {
            const long at = r * samples + t;
            if (t % length == 0)
                for (int i = 0; i < NX; i++) x[i] = path[at * NX + i];
            if ((t + 1) % length == 0) continue;
            for (int i = 0; i < HELD; i++) held[i] = u[i * rows * samples + at];
            if (dt[at] != 0.0)
                for (long s = 0; s < sub_steps; s++) {
                    remember(x, held, p + r * NP, fixed, 0.5 * dt[at]);
                    slide(x, held, p + r * NP, fixed, dt[at]);
                    remember(x, held, p + r * NP, fixed, 0.5 * dt[at]);
                }
            for (int i = 0; i < NX; i++) path[(at + 1) * NX + i] = x[i];
        }
    }
}
""")
