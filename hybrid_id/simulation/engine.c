/* One sample of a system and its tangents: what hybrid_id/simulation/step.py does, for any structure of system.

   Lanes go side by side, each by its own values alone, so that it goes the same way whatever lanes lie beside it. A lane
   in which a speed comes to zero or breaks away within a step goes to that moment, and on from there, while the others
   wait. Smooth friction has no dry speeds, and so no events. Sizes are those of the equations that are given: this file
   is compiled once for a machine. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#define STATES for (long i = 0; i < e->states; i++)
#define DRY for (long i = 0; i < e->dry; i++)
#define COLUMNS for (long c = 0; c < e->columns; c++)
#define TANGENTS for (long j = 0; j < e->states * e->columns; j++)
#define EACH_LANE for (int l = 0; l < W; l++)
/* row of a state's tangent c */
#define OF(state) ((state) * e->columns + c)

/* what holds for all steps of a sample */
typedef struct { const Equations *e; Values u, p, fixed; } Sample;

/* room for all rows below: on the heap, for tangents of a large robot overflow a stack */
static Rows room_for(const Equations *e)
{
    const long n = e->states, columns = e->columns;
    const long given = n * (1 + columns) + e->channels + e->fixed + e->parameters;
    const long rows = given + 7 * n * (1 + columns) + 8 * e->dry + 3 * columns;
    return aligned_alloc(64, rows * sizeof(double[W]));
}

/* the next rows of a room */
static Rows some(Rows *room, long number)
{
    *room += number;
    return *room - number;
}

/* x + step k, where the step's tangent is part h_t, or none */
static void along(const Equations *e, Values x, Values x_t, const double *step, double part, Values h_t, Values k,
                  Values k_t, Rows to, Rows to_t)
{
    if (h_t)
        STATES COLUMNS VECTORS
            AT(to_t[OF(i)]) = AT(x_t[OF(i)]) + part * AT(k[i]) * AT(h_t[c]) + AT(step) * AT(k_t[OF(i)]);
    else
        TANGENTS VECTORS AT(to_t[j]) = AT(x_t[j]) + AT(step) * AT(k_t[j]);
    STATES VECTORS AT(to[i]) = AT(x[i]) + AT(step) * AT(k[i]);
}

/* six times the mean of four stages, so many rows each, into the first */
static void mean(Rows k, long n)
{
    for (long i = 0; i < n; i++)
        VECTORS AT(k[i]) = AT(k[i]) + 2.0 * (AT(k[n + i]) + AT(k[2 * n + i])) + AT(k[3 * n + i]);
}

static void rk4(const Sample *at, Rows room, Values x, Values x_t, Values d, const double *h, Values h_t, Rows after,
                Rows after_t)
{
    const Equations *e = at->e;
    const long n = e->states, n_t = n * e->columns;
    Rows k = some(&room, 4 * n), k_t = some(&room, 4 * n_t);
    double step[W] ALIGNED;
    e->rates(x, x_t, at->u, at->p, at->fixed, d, k, k_t);
    for (long stage = 1; stage < 4; stage++) {
        const double part = stage < 3 ? 0.5 : 1.0;
        VECTORS AT(step) = part * AT(h);
        along(e, x, x_t, step, part, h_t, k + (stage - 1) * n, k_t + (stage - 1) * n_t, after, after_t);
        e->rates(after, after_t, at->u, at->p, at->fixed, d, k + stage * n, k_t + stage * n_t);
    }
    mean(k, n), mean(k_t, n_t);
    VECTORS AT(step) = AT(h) / 6.0;
    along(e, x, x_t, step, 1.0 / 6.0, h_t, k, k_t, after, after_t);
}

/* a speed at rest goes where it is pushed beyond its level; coupled ones change their directions one at a time, the
   lowest number first, until none contradicts its balance */
static void stick_slip(const Sample *at, Rows room, Values x, const double *active, Rows d)
{
    const Equations *e = at->e;
    Rows s = some(&room, e->dry), side = some(&room, e->dry);
    Rows margin = some(&room, e->dry), against = some(&room, e->dry);
    double wrong[W] ALIGNED;
    memcpy(s, d, e->dry * sizeof *s);
    if (e->coupled < e->dry) {
        e->margins(x, at->u, at->p, at->fixed, s, d, side, margin, against);
        DRY if (!e->is_coupled[i])
            VECTORS AT(d[i]) = v_pick(AT(s[i]) != 0.0, AT(d[i]), v_pick(AT(margin[i]) > 0.0, AT(side[i]), 0.0));
    }
    for (long pivot = 0; pivot < e->pivots; pivot++) {
        double any = 0.0;
        e->margins(x, at->u, at->p, at->fixed, s, d, side, margin, against);
        VECTORS AT(wrong) = ALL(-1.0);
        for (long i = e->dry - 1; i >= 0; i--)
            if (e->is_coupled[i]) VECTORS {
                const V excess = v_pick(AT(d[i]) == 0.0, AT(margin[i]), AT(against[i]));
                AT(wrong) = v_pick((AT(active) != 0.0) & (AT(s[i]) == 0.0) & (excess > 0.0), (double)i, AT(wrong));
            }
        EACH_LANE any += wrong[l] >= 0.0;
        if (!any) return;
        DRY VECTORS
            AT(d[i]) = v_pick(AT(wrong) != (double)i, AT(d[i]), v_pick(AT(d[i]) == 0.0, AT(side[i]), 0.0));
    }
}

/* direction in which held speeds break away within the step, else 0, and after which share of it, else 1 */
static void breakaways(const Sample *at, Rows room, Values x, Values after, Values d, const double *active, Rows leaves,
                       Rows when)
{
    const Equations *e = at->e;
    Rows side = some(&room, e->dry), before_it = some(&room, e->dry);
    Rows margin = some(&room, e->dry), against = some(&room, e->dry);
    double rests = 0.0, any = 0.0;
    DRY EACH_LANE {
        leaves[i][l] = 0.0, when[i][l] = 1.0;
        rests += active[l] != 0.0 && d[i][l] == 0.0;
    }
    if (e->speeds == 1 || !rests) return;
    e->margins(after, at->u, at->p, at->fixed, d, d, side, margin, against);
    DRY EACH_LANE {
        leaves[i][l] = d[i][l] == 0.0 && margin[i][l] > 0.0 ? side[i][l] : 0.0;
        any += active[l] * leaves[i][l] * leaves[i][l];
    }
    if (!any) return;
    e->margins(x, at->u, at->p, at->fixed, d, d, side, before_it, against);
    DRY VECTORS {
        const V share = AT(before_it[i]) / (AT(before_it[i]) - AT(margin[i]));
        const V within = v_pick(share < 0.0, 0.0, v_pick(share > 1.0, 1.0, share));
        AT(when[i]) = v_pick(AT(leaves[i]) == 0.0, 1.0, within);
    }
}

/* which speed reaches zero or breaks away first within a lane's step, and after which share of it */
typedef struct { long event, first, passes; double share; } Event;

static Event next_event(const Equations *e, Values x, Values after, Values d, Values leaves, Values when, int l)
{
    Event found = { 0, -1, 0, INFINITY };
    DRY {
        const double v = x[e->row[i]][l], to = after[e->row[i]][l];
        const long crossed = d[i][l] * to < 0.0;
        const double share = crossed ? v / (v - to) : when[i][l];
        found.event |= crossed || leaves[i][l] != 0.0;
        if (found.first < 0 || share < found.share) {
            found.share = share;
            found.first = i;
            found.passes = crossed;
        }
    }
    return found;
}

/* one step of all lanes: each to the moment at which one of its speeds reaches zero or breaks away, and on from there */
static void step_lanes(const Sample *at, Rows room, Rows x, Rows x_t, const double *step)
{
    const Equations *e = at->e;
    const int *row = e->row;
    const long n = e->states, n_t = n * e->columns;
    Rows after = some(&room, n), after_t = some(&room, n_t), k = some(&room, n), k_t = some(&room, n_t);
    Rows d = some(&room, e->dry), released = some(&room, e->dry);
    Rows leaves = some(&room, e->dry), when = some(&room, e->dry);
    Rows h_t = some(&room, e->columns), moment_t = some(&room, e->columns), late_t = some(&room, e->columns);
    double h[W] ALIGNED, active[W] ALIGNED, moment[W] ALIGNED, back[W] ALIGNED;
    EACH_LANE {
        h[l] = step[l];
        active[l] = e->columns || step[l] != 0.0 ? 1.0 : 0.0;
    }
    DRY VECTORS AT(released[i]) = ALL(0.0);
    for (long events = 2 * e->speeds;; events--) {
        const int fresh = events == 2 * e->speeds;
        double rests = 0.0, any = 0.0, left = 0.0;
        DRY EACH_LANE {
            const double v = x[row[i]][l];
            d[i][l] = v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : v;
            rests += active[l] != 0.0 && d[i][l] == 0.0;
        }
        if (rests) stick_slip(at, room, x, active, d);
        DRY {
            double stays[W] ALIGNED; /* a held speed has forgotten its value */
            VECTORS {
                AT(d[i]) = v_pick(AT(released[i]) != 0.0, AT(released[i]), AT(d[i]));
                AT(stays) = v_pick(AT(active) != 0.0, v_fabs(AT(d[i])), 1.0);
                AT(x[row[i]]) *= AT(stays);
            }
            COLUMNS VECTORS AT(x_t[OF(row[i])]) *= AT(stays);
        }
        rk4(at, room, x, x_t, d, h, fresh ? NULL : h_t, after, after_t);
        breakaways(at, room, x, after, d, active, leaves, when);
        DRY EACH_LANE any += active[l] != 0.0 && (d[i][l] * after[row[i]][l] < 0.0 || leaves[i][l] != 0.0);
        if (!any) {
            STATES VECTORS AT(x[i]) = v_pick(AT(active) != 0.0, AT(after[i]), AT(x[i]));
            TANGENTS VECTORS AT(x_t[j]) = v_pick(AT(active) != 0.0, AT(after_t[j]), AT(x_t[j]));
            return;
        }
        Event found[W];
        if (fresh) memset(h_t, 0, e->columns * sizeof *h_t);
        EACH_LANE {
            found[l] = next_event(e, x, after, d, leaves, when, l);
            moment[l] = 0.0;
            COLUMNS moment_t[c][l] = 0.0;
            if (active[l] != 0.0 && (!found[l].event || events == 0)) {
                STATES {
                    x[i][l] = after[i][l];
                    COLUMNS x_t[OF(i)][l] = after_t[OF(i)][l];
                }
                DRY if (d[i][l] * after[row[i]][l] < 0.0) { /* one event too many: it stops there */
                    x[row[i]][l] = 0.0;
                    COLUMNS x_t[OF(row[i])][l] = 0.0;
                }
                active[l] = 0.0;
            }
            if (active[l] == 0.0) continue;
            left += 1.0;
            /* the chord's estimate of that moment, then one Newton step on the speed that reaches zero there */
            const long f = row[found[l].first];
            const double before = x[f][l], drop = before - after[f][l];
            moment[l] = found[l].share * h[l];
            COLUMNS moment_t[c][l] = found[l].share * h_t[c][l] + (found[l].passes
                ? h[l] * (before * after_t[OF(f)][l] - after[f][l] * x_t[OF(f)][l]) / (drop * drop) : 0.0);
        }
        if (!left) return;
        rk4(at, room, x, x_t, d, moment, moment_t, after, after_t);
        e->rates(after, after_t, at->u, at->p, at->fixed, d, k, k_t);
        EACH_LANE {
            const long f = row[found[l].first];
            const int slows = k[f][l] * x[f][l] < 0.0;
            const double at_zero = slows ? after[f][l] / k[f][l] : 0.0, low = moment[l] - h[l];
            /* no later than the step's end, no earlier than its start; where both are equal they share the tangent */
            const double above = at_zero > low ? 1.0 : at_zero < low ? 0.0 : 0.5;
            double late = at_zero < low ? low : at_zero;
            const double below = late < moment[l] ? 1.0 : late > moment[l] ? 0.0 : 0.5;
            late = late > moment[l] ? moment[l] : late;
            COLUMNS {
                double slope = slows ? (after_t[OF(f)][l] - at_zero * k_t[OF(f)][l]) / k[f][l] : 0.0;
                slope = above * slope + (1.0 - above) * (moment_t[c][l] - h_t[c][l]);
                late_t[c][l] = below * slope + (1.0 - below) * moment_t[c][l];
            }
            back[l] = -late;
        }
        along(e, after, after_t, back, -1.0, late_t, k, k_t, after, after_t);
        EACH_LANE {
            if (active[l] == 0.0) continue;
            const long f = row[found[l].first];
            STATES {
                x[i][l] = i == f ? 0.0 : after[i][l];
                COLUMNS x_t[OF(i)][l] = i == f ? 0.0 : after_t[OF(i)][l];
            }
            DRY released[i][l] = i == found[l].first ? leaves[i][l] : 0.0;
            h[l] -= moment[l] + back[l];
            COLUMNS h_t[c][l] -= moment_t[c][l] - late_t[c][l];
        }
    }
}

/* a sample of all lanes; those whose step is zero stay as they are */
static void sample_lanes(const Sample *at, Rows room, Rows x, Rows x_t, const double *h, long sub_steps)
{
    const Equations *e = at->e;
    Rows before = some(&room, e->states);
    memcpy(before, x, e->states * sizeof *before);
    for (long s = 0; s < sub_steps; s++) {
        if (e->internal) e->internal(x, x_t, at->u, at->p, at->fixed, h);
        step_lanes(at, room, x, x_t, h);
        if (e->internal) e->internal(x, x_t, at->u, at->p, at->fixed, h);
    }
    STATES VECTORS AT(x[i]) = v_pick(AT(h) == 0.0, AT(before[i]), AT(x[i]));
}

/* nodes inside each chunk of a length become a rollout of its first; every chunk is a lane, and lanes that end alike,
   where the padding of a record begins, go side by side; channels and sample times of fewer rows repeat */
void shoot(const Equations *e, double *path, const double *const *u, const long *u_rows, const double *dt,
           const double *p, long rows, long dt_rows, long samples, long length, long sub_steps)
{
    Rows all = room_for(e), room = all, x = some(&room, e->states), x_t = some(&room, e->states * e->columns);
    Rows held = some(&room, e->channels), fixed = some(&room, e->fixed), values = some(&room, e->parameters);
    double known[e->fixed + 1], h[W] ALIGNED;
    const double *own[W], *step[W], *channel[W][e->channels + 1];
    long start[W], steps[W], end[W];
    const long n = e->states, chunks = (samples + length - 1) / length, lanes = rows * chunks;
    const Sample at = { e, held, values, fixed };
    long *moves = malloc(lanes * sizeof *moves), *order = malloc(lanes * sizeof *order);
    long *place = calloc(length, sizeof *place);
    for (long lane = 0; lane < lanes; lane++) {
        const long begin = lane % chunks * length, left = samples - begin < length ? samples - begin : length;
        const double *own_step = dt + lane / chunks % dt_rows * samples + begin;
        long last = left - 1;
        while (last > 0 && own_step[last - 1] == 0.0) last--;
        moves[lane] = last;
        place[last]++;
    }
    for (long last = length - 1, before = 0; last >= 0; last--) {
        const long count = place[last];
        place[last] = before;
        before += count;
    }
    for (long lane = 0; lane < lanes; lane++) order[place[moves[lane]]++] = lane;
    for (long first = 0; first < lanes; first += W) {
        const long most = moves[order[first]];
        EACH_LANE {
            const int here = first + l < lanes;
            const long lane = order[here ? first + l : lanes - 1], begin = lane % chunks * length, r = lane / chunks;
            own[l] = p + r * e->parameters;
            start[l] = r * samples + begin;
            step[l] = dt + r % dt_rows * samples + begin;
            for (long i = 0; i < e->channels; i++) channel[l][i] = u[i] + r % u_rows[i] * samples + begin;
            steps[l] = here ? moves[lane] : 0;
            end[l] = here ? (samples - begin < length ? samples - begin : length) - 1 : 0;
            e->prepare(own[l], known);
            for (long i = 0; i < e->fixed; i++) fixed[i][l] = known[i];
            for (long i = 0; i < e->parameters; i++) values[i][l] = own[l][i];
            STATES x[i][l] = path[start[l] * n + i];
        }
        for (long t = 0; t < most; t++) {
            EACH_LANE {
                const long now = t < steps[l] ? t : 0;
                h[l] = t < steps[l] ? step[l][now] : 0.0;
                for (long i = 0; i < e->channels; i++) held[i][l] = channel[l][i][now];
            }
            e->hold(held, values, fixed);
            sample_lanes(&at, room, x, x_t, h, sub_steps);
            EACH_LANE if (t < steps[l])
                STATES path[(start[l] + t + 1) * n + i] = x[i][l];
        }
        EACH_LANE for (long t = steps[l]; t < end[l]; t++)
            STATES path[(start[l] + t + 1) * n + i] = x[i][l];
    }
    free(place), free(order), free(moves), free(all);
}

/* the sample after every node, and its tangents; neighbouring samples are lanes */
void linearise(const Equations *e, double *next, double *tangents, const double *nodes, const double *u,
               const double *dt, const double *p, long rows, long samples, long sub_steps)
{
    Rows all = room_for(e), room = all, x = some(&room, e->states), x_t = some(&room, e->states * e->columns);
    Rows held = some(&room, e->channels), fixed = some(&room, e->fixed), values = some(&room, e->parameters);
    double known[e->fixed + 1], h[W] ALIGNED;
    const long n = e->states;
    const Sample at = { e, held, values, fixed };
    for (long r = 0; r < rows; r++) {
        e->prepare(p + r * e->parameters, known);
        EACH_LANE {
            for (long i = 0; i < e->fixed; i++) fixed[i][l] = known[i];
            for (long i = 0; i < e->parameters; i++) values[i][l] = p[r * e->parameters + i];
        }
        for (long first = r * samples; first < (r + 1) * samples; first += W) {
            const long left = (r + 1) * samples - first, lanes = left < W ? left : W;
            int moves = 0;
            EACH_LANE {
                const long here = first + (l < lanes ? l : lanes - 1);
                h[l] = dt[here];
                moves |= h[l] != 0.0;
                for (long i = 0; i < e->channels; i++) held[i][l] = u[i * rows * samples + here];
                STATES x[i][l] = nodes[here * n + i];
            }
            STATES COLUMNS VECTORS AT(x_t[OF(i)]) = ALL((double)(c == i));
            if (moves) {
                e->hold(held, values, fixed);
                sample_lanes(&at, room, x, x_t, h, sub_steps);
            }
            for (int l = 0; l < lanes; l++)
                STATES {
                    next[(first + l) * n + i] = x[i][l];
                    COLUMNS tangents[((first + l) * n + i) * e->columns + c] = x_t[OF(i)][l];
                }
        }
    }
    free(all);
}
