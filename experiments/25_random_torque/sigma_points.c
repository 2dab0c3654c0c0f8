/* Prediction errors of rows of records by a sigma-point Kalman filter; this file goes behind engine.c.

   A row is a record under parameters of its own; W rows are lanes. What is filtered are the states and, behind them, a
   random torque at each of some speeds, which goes into the equations through a channel. Points lie at the mean and
   sqrt(z) columns of the covariance's Cholesky factor to either side (I. Arasaratnam, S. Haykin, IEEE Trans. Automatic
   Control 54, 2009): the moments after a sample are theirs, whatever friction does at them. */
#define Z for (long i = 0; i < z; i++)
void predict(const Equations *e, double *white, double *logs, const double *const *u, const long *u_rows,
             const double *dt, const double *p, const double *y, const double *variance, const double *rate,
             const double *noise, const double *first_mean, const double *first_variance, const double *torque,
             const double *tiny, const long *output, const long *push, long rows, long records, long samples,
             long sub_steps, long outputs, long torques)
{
    const long n = e->states, z = n + torques, points = 2 * z;
    Rows all = room_for(e), room = all, x = some(&room, e->states), x_t = some(&room, e->states * e->columns);
    Rows held = some(&room, e->channels), fixed = some(&room, e->fixed), values = some(&room, e->parameters);
    Rows own = aligned_alloc(64, (2 * z + 2 * z * z + points * z + 1) * sizeof(double[W]));
    Rows m = own, gain = m + z, P = gain + z, L = P + z * z, X = L + z * z, given = X + points * z;
    double known[e->fixed + 1], h[W] ALIGNED, inside[W] ALIGNED, error[W] ALIGNED;
    const Sample at = { e, held, values, fixed };
    const double spread = sqrt((double)z);
    long row[W], record[W];
    for (long first = 0; first < rows; first += W) {
        EACH_LANE {
            row[l] = first + l < rows ? first + l : rows - 1;
            record[l] = row[l] % records;
            const double *mine = p + row[l] * e->parameters;
            e->prepare(mine, known);
            for (long i = 0; i < e->fixed; i++) fixed[i][l] = known[i];
            for (long i = 0; i < e->parameters; i++) values[i][l] = mine[i];
            Z for (long j = 0; j < z; j++) P[i * z + j][l] = 0.0;
            STATES {
                m[i][l] = first_mean[record[l] * n + i];
                P[i * z + i][l] = first_variance[record[l] * n + i];
            }
            for (long k = n; k < z; k++) {
                m[k][l] = 0.0;
                P[k * z + k][l] = torque[(row[l] * torques + k - n) * 2];
            }
        }
        for (long t = 0; t < samples; t++) {
            for (long o = 0; o < outputs; o++) {
                const long state = output[o];
                EACH_LANE {
                    const long here = (record[l] * samples + t) * outputs + o, there = row[l] * outputs + o;
                    const int seen = variance[here] > 0.0;
                    const double own_noise = variance[here] * noise[there * 2] + rate[here] * noise[there * 2 + 1];
                    const double total = seen ? P[state * z + state][l] + own_noise : 1.0;
                    error[l] = seen ? y[here] - m[state][l] : 0.0;
                    inside[l] = seen ? 1.0 / total : 0.0;
                    const long to = (row[l] * samples + t) * outputs + o;
                    white[to] = error[l] * sqrt(inside[l]);
                    logs[to] = log(total);
                }
                Z VECTORS AT(gain[i]) = AT(P[i * z + state]);
                Z VECTORS AT(m[i]) = AT(m[i]) + AT(gain[i]) * AT(inside) * AT(error);
                Z for (long j = 0; j < z; j++)
                    VECTORS AT(P[i * z + j]) = AT(P[i * z + j]) - AT(gain[i]) * AT(inside) * AT(gain[j]);
            }
            if (t == samples - 1) break;
            Z for (long j = 0; j <= i; j++) {
                EACH_LANE given[0][l] = P[i * z + j][l];
                for (long k = 0; k < j; k++) VECTORS AT(given[0]) = AT(given[0]) - AT(L[i * z + k]) * AT(L[j * z + k]);
                EACH_LANE {
                    const double left = given[0][l] + (i == j ? tiny[i] : 0.0);
                    L[i * z + j][l] = i == j ? sqrt(left > tiny[i] ? left : tiny[i]) : left / L[j * z + j][l];
                }
            }
            int moves = 0;
            EACH_LANE {
                h[l] = dt[record[l] * samples + t];
                moves |= h[l] != 0.0;
            }
            if (!moves) continue;
            for (long i = 0; i < e->channels; i++)
                EACH_LANE held[i][l] = u[i][row[l] % u_rows[i] * samples + t];
            e->hold(held, values, fixed);
            for (long s = 0; s < points; s++) {
                const long side = s < z ? s : s - z;
                const double sign = s < z ? spread : -spread;
                Rows point = X + s * z;
                Z VECTORS AT(point[i]) = AT(m[i]);
                for (long i = side; i < z; i++) VECTORS AT(point[i]) = AT(point[i]) + sign * AT(L[i * z + side]);
                STATES VECTORS AT(x[i]) = AT(point[i]);
                for (long k = 0; k < torques; k++) VECTORS AT(held[push[k]]) = AT(point[n + k]);
                sample_lanes(&at, room, x, x_t, h, sub_steps);
                STATES VECTORS AT(point[i]) = AT(x[i]);
            }
            EACH_LANE for (long k = 0; k < torques; k++) {
                const double keeps = exp(-h[l] * sub_steps / torque[(row[l] * torques + k) * 2 + 1]);
                for (long s = 0; s < points; s++) X[s * z + n + k][l] *= keeps;
                gain[k][l] = torque[(row[l] * torques + k) * 2] * (1.0 - keeps * keeps);
            }
            Z {
                VECTORS AT(m[i]) = ALL(0.0);
                for (long s = 0; s < points; s++) VECTORS AT(m[i]) = AT(m[i]) + AT(X[s * z + i]);
                VECTORS AT(m[i]) = AT(m[i]) / (double)points;
            }
            for (long s = 0; s < points; s++) Z VECTORS AT(X[s * z + i]) = AT(X[s * z + i]) - AT(m[i]);
            Z for (long j = 0; j <= i; j++) {
                VECTORS AT(given[0]) = ALL(0.0);
                for (long s = 0; s < points; s++) VECTORS AT(given[0]) = AT(given[0]) + AT(X[s * z + i]) * AT(X[s * z + j]);
                VECTORS AT(P[i * z + j]) = AT(P[j * z + i]) = AT(given[0]) / (double)points;
            }
            for (long k = 0; k < torques; k++) VECTORS AT(P[(n + k) * z + n + k]) = AT(P[(n + k) * z + n + k]) + AT(gain[k]);
        }
    }
    free(own), free(all);
}
