"""C code of the dry engine's tangents: over rows and samples, around the steps of ``dry_code``."""

LINEARISE = """\
/* what depends on the held input as well: the same over a whole sample */
static void hold(const double *u, const double *p, double *fixed)
{
$hold
}

/* the states that remember, h seconds later at constant motion */
static void remember(double *x, double (*x_t)[MC], const double *u, const double *p, const double *fixed, double h)
{
    double k_t[NX][MC] ALIGNED;
$remember
}

static void sample(double *x, double (*x_t)[MC], const double *u, const double *p, const double *fixed, double h,
                   long sub_steps)
{
    for (long s = 0; s < sub_steps; s++) {
        remember(x, x_t, u, p, fixed, 0.5 * h);
        slide(x, x_t, u, p, fixed, h);
        remember(x, x_t, u, p, fixed, 0.5 * h);
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
            for (int i = 0; i < NX; i++) memcpy(tangents + (at * NX + i) * NC, x_t[i], NC * sizeof(double));
        }
    }
}
"""
"""Steps of a sample, tangents included, and what Python calls."""
