"""C code of the dry engine for lanes side by side: they go together through steps in which nothing happens.

A lane in which a speed comes to zero or breaks away within a step takes this step alone, by ``slide`` of ``dry_code``;
so a lane goes the same way whatever lanes lie beside it.
"""

LANES = """\
#define W $width
#define LANES _Pragma("omp simd") for (int l = 0; l < W; l++)
#define TANGENTS for (int c = 0; c < NC; c++) LANES

static void hold_lanes(const double (*u)[W], const double (*p)[W], double (*fixed)[W])
{
    LANES {
$hold_lanes
    }
}

static void rates_lanes(const double (*x)[W], const double (*x_t)[MC][W], const double (*u)[W], const double (*p)[W],
                        const double (*fixed)[W], const double (*d)[W], double (*k)[W], double (*k_t)[MC][W])
{
    double g[NX][MC][W] ALIGNED; /* gradients by states and free parameters */
    LANES {
$rates_lanes
    }
$rates_tangents
}

static void pushes_lanes(const double (*x)[W], const double (*u)[W], const double (*p)[W], const double (*fixed)[W],
                         const double (*s)[W], const double (*d)[W], double (*side)[W], double (*over)[W])
{
    double against[MANY][W] ALIGNED;
    LANES {
$pushes_lanes
    }
}

static void remember_lanes(double (*x)[W], double (*x_t)[MC][W], const double (*u)[W], const double (*p)[W],
                           const double (*fixed)[W], const double *step)
{
    double g[NX][MC][W] ALIGNED, k_t[NX][MC][W] ALIGNED;
    LANES {
        const double h = 0.5 * step[l];
$remember_lanes
    }
$remember_tangents
}

/* as rk4 */
static void rk4_lanes(const double (*x)[W], const double (*x_t)[MC][W], const double (*u)[W], const double (*p)[W],
                      const double (*fixed)[W], const double (*d)[W], const double *h, double (*after)[W],
                      double (*after_t)[MC][W])
{
    double k[4][NX][W] ALIGNED, k_t[4][NX][MC][W] ALIGNED;
    rates_lanes(x, x_t, u, p, fixed, d, k[0], k_t[0]);
    for (int stage = 1; stage < 4; stage++) {
        const double part = stage < 3 ? 0.5 : 1.0;
        for (int i = 0; i < NX; i++) {
            LANES after[i][l] = x[i][l] + part * h[l] * k[stage - 1][i][l];
            TANGENTS after_t[i][c][l] = x_t[i][c][l] + part * h[l] * k_t[stage - 1][i][c][l];
        }
        rates_lanes(after, after_t, u, p, fixed, d, k[stage], k_t[stage]);
    }
    for (int i = 0; i < NX; i++) {
        LANES after[i][l] = x[i][l] + h[l] / 6.0 * (k[0][i][l] + 2.0 * (k[1][i][l] + k[2][i][l]) + k[3][i][l]);
        TANGENTS after_t[i][c][l] = x_t[i][c][l] + h[l] / 6.0
            * (k_t[0][i][c][l] + 2.0 * (k_t[1][i][c][l] + k_t[2][i][c][l]) + k_t[3][i][c][l]);
    }
}

/* one step of one lane */
static void slide_alone(double (*x)[W], double (*x_t)[MC][W], const double (*u)[W], const double (*fixed)[W],
                        const double *p, double h, int l)
{
    double own[NX], own_t[NX][MC] ALIGNED, held[HELD + 1], known[FIXED + 1];
    for (int i = 0; i < NX; i++) {
        own[i] = x[i][l];
        for (int c = 0; c < MC; c++) own_t[i][c] = c < NC ? x_t[i][c][l] : 0.0;
    }
    for (int i = 0; i < HELD; i++) held[i] = u[i][l];
    for (int i = 0; i < FIXED; i++) known[i] = fixed[i][l];
    slide(own, own_t, held, p, known, h);
    for (int i = 0; i < NX; i++) {
        x[i][l] = own[i];
        for (int c = 0; c < NC; c++) x_t[i][c][l] = own_t[i][c];
    }
}

/* a sample of all lanes; those whose step is zero stay as they are */
static void sample_lanes(double (*x)[W], double (*x_t)[MC][W], const double (*u)[W], const double (*p)[W],
                         const double (*fixed)[W], const double *const *own, const double *h, long sub_steps)
{
    double before[NX][W] ALIGNED, after[NX][W] ALIGNED, after_t[NX][MC][W] ALIGNED, alone[W] ALIGNED;
    double d[MANY][W] ALIGNED, side[MANY][W] ALIGNED, over[MANY][W] ALIGNED, away[MANY][W] ALIGNED;
    memcpy(before, x, sizeof before);
    for (long s = 0; s < sub_steps; s++) {
        double rests = 0.0;
        if ($remembers) remember_lanes(x, x_t, u, p, fixed, h);
        for (int i = 0; i < ND; i++)
            for (int l = 0; l < W; l++) {
                const double v = x[row[i]][l];
                d[i][l] = v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : v;
                rests += d[i][l] == 0.0;
            }
        for (int l = 0; l < W; l++) alone[l] = 0.0;
        if (rests) {
            pushes_lanes(x, u, p, fixed, d, d, side, over);
            for (int i = 0; i < ND; i++) LANES {
                /* of two links that are coupled none goes by itself */
                const double leaves = d[i][l] == 0.0 && over[i][l] > 0.0 ? 1.0 : 0.0;
                alone[l] = FIRST != NONE ? fmax(alone[l], leaves) : alone[l];
                away[i][l] = leaves;
            }
            for (int i = 0; i < ND; i++) LANES d[i][l] = away[i][l] != 0.0 ? side[i][l] : d[i][l];
            for (int i = 0; i < ND; i++) TANGENTS x_t[row[i]][c][l] *= alone[l] != 0.0 ? 1.0 : fabs(d[i][l]);
        }
        rk4_lanes(x, x_t, u, p, fixed, d, h, after, after_t);
        if (rests && SPEEDS > 1) {
            pushes_lanes(after, u, p, fixed, d, d, side, over);
            for (int i = 0; i < ND; i++) LANES alone[l] = d[i][l] == 0.0 && over[i][l] > 0.0 ? 1.0 : alone[l];
        }
        for (int i = 0; i < ND; i++) LANES alone[l] = d[i][l] * after[row[i]][l] < 0.0 ? 1.0 : alone[l];
        for (int l = 0; l < W; l++)
            if (alone[l] != 0.0 && (NC || h[l] != 0.0)) slide_alone(x, x_t, u, fixed, own[l], h[l], l);
        for (int i = 0; i < NX; i++) {
            LANES x[i][l] = alone[l] != 0.0 ? x[i][l] : after[i][l];
            TANGENTS x_t[i][c][l] = alone[l] != 0.0 ? x_t[i][c][l] : after_t[i][c][l];
        }
        if ($remembers) remember_lanes(x, x_t, u, p, fixed, h);
    }
    for (int i = 0; i < NX; i++) LANES x[i][l] = h[l] == 0.0 ? before[i][l] : x[i][l];
}

"""
"""Steps of a sample, with tangents where they are asked for."""

SHOOT = """\
/* nodes inside each chunk of a length become a rollout of its first; every chunk is a lane */
void shoot(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long length,
           long sub_steps)
{
    double x[NX][W] ALIGNED, held[HELD + 1][W] ALIGNED, fixed[FIXED + 1][W] ALIGNED, values[NP + 1][W] ALIGNED;
    double known[FIXED + 1], x_t[NX][MC][W] ALIGNED, h[W] ALIGNED;
    const double *own[W];
    long start[W], steps[W];
    const long chunks = (samples + length - 1) / length, lanes = rows * chunks;
    for (long first = 0; first < lanes; first += W) {
        long most = 0;
        for (int l = 0; l < W; l++) {
            const long lane = first + l < lanes ? first + l : lanes - 1, at = lane % chunks * length;
            const long left = samples - at < length ? samples - at : length;
            own[l] = p + lane / chunks * NP;
            start[l] = lane / chunks * samples + at;
            steps[l] = first + l < lanes ? left - 1 : 0;
            most = steps[l] > most ? steps[l] : most;
            prepare(own[l], known);
            for (int i = 0; i < FIXED; i++) fixed[i][l] = known[i];
            for (int i = 0; i < NP; i++) values[i][l] = own[l][i];
            for (int i = 0; i < NX; i++) x[i][l] = path[start[l] * NX + i];
        }
        for (long t = 0; t < most; t++) {
            int moves = 0;
            for (int l = 0; l < W; l++) {
                const long at = start[l] + (t < steps[l] ? t : 0);
                h[l] = t < steps[l] ? dt[at] : 0.0;
                moves |= h[l] != 0.0;
                for (int i = 0; i < HELD; i++) held[i][l] = u[i * rows * samples + at];
            }
            if (moves) {
                hold_lanes(held, values, fixed);
                sample_lanes(x, x_t, held, values, fixed, own, h, sub_steps);
            }
            for (int l = 0; l < W; l++)
                if (t < steps[l])
                    for (int i = 0; i < NX; i++) path[(start[l] + t + 1) * NX + i] = x[i][l];
        }
    }
}
"""
"""Rollouts: what Python calls without tangents."""

LINEARISE = """\
/* the sample after every node, and its tangents; neighbouring samples are lanes */
void linearise(double *next, double *tangents, const double *nodes, const double *u, const double *dt,
               const double *p, long rows, long samples, long sub_steps)
{
    double x[NX][W] ALIGNED, x_t[NX][MC][W] ALIGNED, held[HELD + 1][W] ALIGNED, fixed[FIXED + 1][W] ALIGNED;
    double values[NP + 1][W] ALIGNED, known[FIXED + 1], h[W] ALIGNED;
    const double *own[W];
    for (long r = 0; r < rows; r++) {
        prepare(p + r * NP, known);
        for (int l = 0; l < W; l++) {
            own[l] = p + r * NP;
            for (int i = 0; i < FIXED; i++) fixed[i][l] = known[i];
            for (int i = 0; i < NP; i++) values[i][l] = own[l][i];
        }
        for (long first = r * samples; first < (r + 1) * samples; first += W) {
            const long left = (r + 1) * samples - first, lanes = left < W ? left : W;
            for (int l = 0; l < W; l++) {
                const long at = first + (l < lanes ? l : lanes - 1);
                h[l] = dt[at];
                for (int i = 0; i < HELD; i++) held[i][l] = u[i * rows * samples + at];
                for (int i = 0; i < NX; i++) x[i][l] = nodes[at * NX + i];
            }
            for (int i = 0; i < NX; i++) TANGENTS x_t[i][c][l] = c == i;
            hold_lanes(held, values, fixed);
            sample_lanes(x, x_t, held, values, fixed, own, h, sub_steps);
            for (int l = 0; l < lanes; l++)
                for (int i = 0; i < NX; i++) {
                    next[(first + l) * NX + i] = x[i][l];
                    for (int c = 0; c < NC; c++) tangents[((first + l) * NX + i) * NC + c] = x_t[i][c][l];
                }
        }
    }
}
"""
"""Tangents: what Python calls with them."""
