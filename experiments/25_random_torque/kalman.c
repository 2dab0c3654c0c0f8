#include <math.h>

/* The Kalman filter of rows of linear maps; all columns follow the same gains. State and covariance are carried from
   call to call. One output after the other: their noise is independent. work has room for nz * (nz + nc + 2). */
void filter(double *white, double *log_det, double *before_p, double *before_m, double *carried_p, double *carried_m,
            const double *a, const double *b, const double *q, const double *c, const double *e, const double *noise,
            double *work, long rows, long samples, long nz, long nc, long ny, long keep)
{
    double *t = work, *n = t + nz * nz, *k = n + nz * nc;
    for (long r = 0; r < rows; r++) {
        double *p = carried_p + r * nz * nz, *m = carried_m + r * nz * nc, total = 0.0;
        for (long s = 0; s < samples; s++) {
            const long at = r * samples + s;
            if (keep) {
                for (long i = 0; i < nz * nz; i++) before_p[at * nz * nz + i] = p[i];
                for (long i = 0; i < nz * nc; i++) before_m[at * nz * nc + i] = m[i];
            }
            for (long o = 0; o < ny; o++) {
                const double *row = c + (at * ny + o) * nz, *given = e + (at * ny + o) * nc;
                double *restrict out = white + (at * ny + o) * nc, variance = noise[at * ny + o];
                for (long j = 0; j < nc; j++) out[j] = 0.0;
                if (variance <= 0.0) continue;
                for (long i = 0; i < nz; i++) {
                    k[i] = 0.0;
                    for (long j = 0; j < nz; j++) k[i] += p[i * nz + j] * row[j];
                }
                for (long i = 0; i < nz; i++) variance += row[i] * k[i];
                total += log(variance);
                for (long j = 0; j < nc; j++) out[j] = given[j];
                for (long i = 0; i < nz; i++)
                    if (row[i] != 0.0)
                        for (long j = 0; j < nc; j++) out[j] -= row[i] * m[i * nc + j];
                for (long i = 0; i < nz; i++) {
                    const double gain = k[i] / variance;
                    for (long j = 0; j < nc; j++) m[i * nc + j] += gain * out[j];
                    for (long j = 0; j < nz; j++) p[i * nz + j] -= gain * k[j];
                }
                const double scale = 1.0 / sqrt(variance);
                for (long j = 0; j < nc; j++) out[j] *= scale;
            }
            const double *f = a + at * nz * nz, *g = b + at * nz * nc, *added = q + at * nz;
            for (long i = 0; i < nz; i++) {
                double *restrict row = t + i * nz, *restrict next = n + i * nc;
                for (long j = 0; j < nz; j++) row[j] = 0.0;
                for (long j = 0; j < nc; j++) next[j] = g[i * nc + j];
                for (long l = 0; l < nz; l++) {
                    const double share = f[i * nz + l];
                    if (share == 0.0) continue;
                    for (long j = 0; j < nz; j++) row[j] += share * p[l * nz + j];
                    for (long j = 0; j < nc; j++) next[j] += share * m[l * nc + j];
                }
            }
            for (long i = 0; i < nz; i++)
                for (long j = 0; j <= i; j++) {
                    double sum = i == j ? added[i] : 0.0;
                    for (long l = 0; l < nz; l++) sum += t[i * nz + l] * f[j * nz + l];
                    p[i * nz + j] = p[j * nz + i] = sum;
                }
            for (long i = 0; i < nz * nc; i++) m[i] = n[i];
        }
        log_det[r] += total;
    }
}

/* The states that all samples together tell, and their variances, of one column: the recursion of de Jong (1989).
   work has room for nz * (4 * nz + ny + 3) + 2 * ny. */
void smooth(double *states, double *variances, const double *before_p, const double *before_m, const double *a,
            const double *c, const double *e, const double *noise, double *work, long rows, long samples, long nz, long ny)
{
    double *n = work, *p = n + nz * nz, *t = p + nz * nz, *u = t + nz * nz, *gains = u + nz * nz, *l = gains + nz * ny;
    double *m = l + nz, *w = m + nz, *told = w + nz;
    for (long r = 0; r < rows; r++) {
        for (long i = 0; i < nz; i++) l[i] = 0.0;
        for (long i = 0; i < nz * nz; i++) n[i] = 0.0;
        for (long s = samples - 1; s >= 0; s--) {
            const long at = r * samples + s;
            const double *f = a + at * nz * nz, *ahead_p = before_p + at * nz * nz, *ahead_m = before_m + at * nz;
            for (long i = 0; i < nz; i++) {
                w[i] = 0.0;
                for (long j = 0; j < nz; j++) w[i] += f[j * nz + i] * l[j];
                for (long j = 0; j < nz; j++) {
                    t[i * nz + j] = 0.0;
                    for (long k = 0; k < nz; k++) t[i * nz + j] += n[i * nz + k] * f[k * nz + j];
                }
            }
            for (long i = 0; i < nz; i++) {
                l[i] = w[i], m[i] = ahead_m[i];
                for (long j = 0; j < nz; j++) {
                    n[i * nz + j] = 0.0, p[i * nz + j] = ahead_p[i * nz + j];
                    for (long k = 0; k < nz; k++) n[i * nz + j] += f[k * nz + i] * t[k * nz + j];
                }
            }
            for (long o = 0; o < ny; o++) {
                const double *row = c + (at * ny + o) * nz;
                double variance = noise[at * ny + o], left = e[at * ny + o], *k = gains + o * nz;
                told[2 * o + 1] = 0.0;
                if (variance <= 0.0) continue;
                for (long i = 0; i < nz; i++) {
                    k[i] = 0.0;
                    for (long j = 0; j < nz; j++) k[i] += p[i * nz + j] * row[j];
                }
                for (long i = 0; i < nz; i++) variance += row[i] * k[i], left -= row[i] * m[i];
                for (long i = 0; i < nz; i++) {
                    for (long j = 0; j < nz; j++) p[i * nz + j] -= k[i] / variance * k[j];
                }
                for (long i = 0; i < nz; i++) k[i] /= variance, m[i] += k[i] * left;
                told[2 * o] = left, told[2 * o + 1] = variance;
            }
            for (long o = ny - 1; o >= 0; o--) {
                const double *row = c + (at * ny + o) * nz, *k = gains + o * nz, variance = told[2 * o + 1];
                if (variance <= 0.0) continue;
                double along = 0.0, across = 0.0;
                for (long i = 0; i < nz; i++) {
                    along += k[i] * l[i], w[i] = 0.0;
                    for (long j = 0; j < nz; j++) w[i] += n[i * nz + j] * k[j];
                }
                for (long i = 0; i < nz; i++) across += k[i] * w[i];
                for (long i = 0; i < nz; i++) {
                    for (long j = 0; j < nz; j++)
                        n[i * nz + j] += row[i] * row[j] * (1.0 / variance + across) - w[i] * row[j] - row[i] * w[j];
                    l[i] += row[i] * (told[2 * o] / variance - along);
                }
            }
            for (long i = 0; i < nz; i++) {
                double state = ahead_m[i];
                for (long j = 0; j < nz; j++) {
                    state += ahead_p[i * nz + j] * l[j], u[i * nz + j] = 0.0;
                    for (long k = 0; k < nz; k++) u[i * nz + j] += ahead_p[i * nz + k] * n[k * nz + j];
                }
                states[at * nz + i] = state;
            }
            for (long i = 0; i < nz; i++) {
                double variance = ahead_p[i * nz + i];
                for (long j = 0; j < nz; j++) variance -= u[i * nz + j] * ahead_p[j * nz + i];
                variances[at * nz + i] = variance;
            }
        }
    }
}
