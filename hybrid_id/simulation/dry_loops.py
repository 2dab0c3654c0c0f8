"""C code of the loops of the dry engine: over rows and samples, around the steps of ``dry_code``."""

LOOPS = """\
/* nodes inside each chunk of a length become a rollout of its first */
void shoot(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long length,
           long sub_steps)
{
    double x[NX], x_t[NX][MC] ALIGNED, held[HELD + 1], fixed[FIXED + 1];
    for (long r = 0; r < rows; r++) {
        prepare(p + r * NP, fixed);
        for (long t = 0; t + 1 < samples; t++) {
            const long at = r * samples + t;
            if (t % length == 0) memcpy(x, path + at * NX, sizeof x);
            if ((t + 1) % length == 0) continue;
            for (int i = 0; i < HELD; i++) held[i] = u[i * rows * samples + at];
            hold(held, p + r * NP, fixed);
            if (dt[at] != 0.0) sample(x, x_t, held, p + r * NP, fixed, dt[at], sub_steps);
            memcpy(path + (at + 1) * NX, x, sizeof x);
        }
    }
}

/* the sample after every node, and its tangents */
void linearise(double *next, double *tangents, const double *nodes, const double *u, const double *dt,
               const double *p, long rows, long samples, long sub_steps)
{
    double x_t[NX][MC] ALIGNED, held[HELD + 1], fixed[FIXED + 1];
    for (long r = 0; r < rows; r++) {
        prepare(p + r * NP, fixed);
        for (long at = r * samples; at < (r + 1) * samples; at++) {
            double *x = next + at * NX;
            for (int i = 0; i < NX; i++) {
                x[i] = nodes[at * NX + i];
                COLUMNS x_t[i][c] = c == i;
            }
            for (int i = 0; i < HELD; i++) held[i] = u[i * rows * samples + at];
            hold(held, p + r * NP, fixed);
            sample(x, x_t, held, p + r * NP, fixed, dt[at], sub_steps);
            memcpy(tangents + at * NX * NC, x_t, NX * NC * sizeof(double));
        }
    }
}
"""
"""What Python calls; ``hold`` and ``sample`` stand before it."""
