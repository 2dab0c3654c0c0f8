/* Prediction errors of rows of records by a sigma-point Kalman filter; this file goes behind engine.c.

   A row is a record under parameters of its own; W rows are lanes, those of one record side by side, for friction holds
   and breaks in them at about the same time. What is filtered are the states and, behind them, a random torque at each
   of some speeds, which goes into the equations through a channel. Points lie at the mean and sqrt(z) columns of the
   covariance's Cholesky factor to either side (I. Arasaratnam, S. Haykin, IEEE Trans. Automatic Control 54, 2009): the
   moments of outputs and of what comes after a sample are theirs, whatever friction does at them. */
#define Z for (long i = 0; i < z; i++)
#define OUTPUTS for (long o = 0; o < outputs; o++)
#define TORQUES for (long k = 0; k < torques; k++)
#define POINTS for (long s = 0; s < 2 * z; s++)

/* Cholesky factor of a matrix of n rows, each of its squares increased by `tiny` and no less */
static void factor(long n, Values matrix, const double *tiny, Rows L)
{
    for (long i = 0; i < n; i++) for (long j = 0; j <= i; j++) {
        VECTORS {
            V left = AT(matrix[i * n + j]);
            for (long k = 0; k < j; k++) left -= AT(L[i * n + k]) * AT(L[j * n + k]);
            AT(L[i * n + j]) = i == j ? v_pick(left > 0.0, left + tiny[i], tiny[i]) : left / AT(L[j * n + j]);
        }
        if (i == j) _Pragma("omp simd") EACH_LANE L[i * n + i][l] = sqrt(L[i * n + i][l]);
    }
}

static void spread(long z, Values m, Values P, const double *tiny, Rows L, Rows X)
{
    const double far = sqrt((double)z);
    factor(z, P, tiny, L);
    Z for (long s = 0; s < z; s++) VECTORS {
        const V aside = far * AT(L[i * z + s]);
        AT(X[s * z + i]) = AT(m[i]) + aside;
        AT(X[(s + z) * z + i]) = AT(m[i]) - aside;
    }
}

/* covariance of what was spread, by its factor L, with n rows Y that were found at its points */
static void across(long z, Values L, long n, Values Y, Rows to)
{
    const double part = 0.5 / sqrt((double)z);
    Z for (long j = 0; j < n; j++) VECTORS {
        V sum = ALL(0.0);
        for (long s = 0; s <= i; s++) sum += AT(L[i * z + s]) * (AT(Y[s * n + j]) - AT(Y[(s + z) * n + j]));
        AT(to[i * n + j]) = part * sum;
    }
}

/* mean and covariance of n rows at the points, which become what they differ from the mean */
static void moments(long z, long n, Rows Y, Rows m, Rows P)
{
    const double part = 0.5 / z;
    for (long i = 0; i < n; i++) VECTORS {
        V sum = ALL(0.0);
        POINTS sum += AT(Y[s * n + i]);
        AT(m[i]) = part * sum;
        POINTS AT(Y[s * n + i]) -= AT(m[i]);
        for (long j = 0; j <= i; j++) {
            sum = ALL(0.0);
            POINTS sum += AT(Y[s * n + i]) * AT(Y[s * n + j]);
            AT(P[i * n + j]) = AT(P[j * n + i]) = part * sum;
        }
    }
}

/* Where they are given, `ahead` gets errors of the model that runs by itself from the mean at every so many samples,
   and `path` of each sample mean and covariance, those of the next one before it is seen, and theirs with it. */
void predict(const Equations *e, double *white, double *logs, double *ahead, double *path, const double *const *u,
             const long *u_rows, const double *dt, const double *p, const double *y, const double *variance,
             const double *rate, const double *noise, const double *first_mean, const double *first_variance,
             const double *torque, const double *tiny, const long *push, const long *speed, long rows, long records,
             long samples, long sub_steps, long outputs, long torques, long every)
{
    const long guesses = rows / records, n = e->states, z = n + torques, now = z + z * z, next = now + z * z;
    Rows all = room_for(e), room = all, x = some(&room, n), x_t = some(&room, n * e->columns);
    Rows held = some(&room, e->channels), fixed = some(&room, e->fixed), values = some(&room, e->parameters);
    Rows own = aligned_alloc(64, (z + 5 * z * z + outputs * (2 + 3 * z + outputs)) * sizeof(double[W]));
    Rows m = own, P = m + z, D = P + z * z, L = D + z * z, X = L + z * z, Y = X + 2 * z * z; /* path reads m, P, D */
    Rows expected = Y + 2 * z * outputs, error = expected + outputs, C = error + outputs, S = C + z * outputs;
    double known[e->fixed + 1], none[outputs + 1], h[W] ALIGNED;
    const Sample at = { e, held, values, fixed };
    long row[W], record[W];
    memset(L, 0, z * z * sizeof *L);
    OUTPUTS none[o] = 0.0;
    for (long first = 0; first < rows; first += W) {
        EACH_LANE {
            const long lane = first + l < rows ? first + l : rows - 1;
            record[l] = lane / guesses;
            row[l] = lane % guesses * records + record[l];
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
                P[k * z + k][l] = torque[(row[l] * torques + k - n) * 3];
            }
        }
        for (long t = 0; t < samples; t++) {
            int moves = 0, sees = 0;
            EACH_LANE {
                const long here = record[l] * samples + t;
                h[l] = dt[here];
                moves |= h[l] != 0.0;
                OUTPUTS sees |= variance[here * outputs + o] > 0.0;
            }
            if (!moves && !sees && !path) continue; /* behind the ends of these lanes' records */
            for (long i = 0; i < e->channels; i++)
                EACH_LANE held[i][l] = u[i][row[l] % u_rows[i] * samples + t];
            e->hold(held, values, fixed);
            if (sees) {
                spread(z, m, P, tiny, L, X);
                POINTS {
                    TORQUES VECTORS AT(held[push[k]]) = AT(X[s * z + n + k]);
                    e->outputs(X + s * z, held, values, fixed, Y + s * outputs);
                }
                moments(z, outputs, Y, expected, S);
                across(z, L, outputs, Y, C);
                OUTPUTS EACH_LANE {
                    const long here = (record[l] * samples + t) * outputs + o, there = (row[l] * outputs + o) * 2;
                    const int seen = variance[here] > 0.0;
                    for (long q = 0; q < outputs && !seen; q++) S[o * outputs + q][l] = S[q * outputs + o][l] = 0.0;
                    Z if (!seen) C[i * outputs + o][l] = 0.0;
                    error[o][l] = seen ? y[here] - expected[o][l] : 0.0;
                    S[o * outputs + o][l] += seen ? variance[here] * noise[there] + rate[here] * noise[there + 1] : 1.0;
                }
                factor(outputs, S, none, S);
                OUTPUTS {
                    for (long q = 0; q < o; q++) {
                        VECTORS AT(error[o]) -= AT(S[o * outputs + q]) * AT(error[q]);
                        Z VECTORS AT(C[i * outputs + o]) -= AT(S[o * outputs + q]) * AT(C[i * outputs + q]);
                    }
                    VECTORS AT(error[o]) /= AT(S[o * outputs + o]);
                    Z VECTORS AT(C[i * outputs + o]) /= AT(S[o * outputs + o]);
                    EACH_LANE {
                        const long to = (row[l] * samples + t) * outputs + o;
                        white[to] = error[o][l];
                        logs[to] = 2.0 * log(S[o * outputs + o][l]);
                    }
                    Z VECTORS AT(m[i]) += AT(C[i * outputs + o]) * AT(error[o]);
                    Z for (long j = 0; j < z; j++)
                        VECTORS AT(P[i * z + j]) -= AT(C[i * outputs + o]) * AT(C[j * outputs + o]);
                }
            }
            if (ahead) {
                TORQUES VECTORS AT(held[push[k]]) = ALL(0.0);
                e->outputs(x, held, values, fixed, expected);
                OUTPUTS EACH_LANE {
                    const long here = (record[l] * samples + t) * outputs + o;
                    const int runs = t % every && variance[here] > 0.0;
                    ahead[(row[l] * samples + t) * outputs + o] = runs ? y[here] - expected[o][l] : 0.0;
                }
                STATES if (t % every == 0) VECTORS AT(x[i]) = AT(m[i]);
                sample_lanes(&at, room, x, x_t, h, sub_steps);
            }
            if (!moves && !path) continue;
            if (path) EACH_LANE for (long i = 0; i < now; i++)
                path[(row[l] * samples + t) * (now + next) + i] = own[i][l];
            spread(z, m, P, tiny, L, X);
            POINTS {
                TORQUES VECTORS AT(held[push[k]]) = AT(X[s * z + n + k]);
                sample_lanes(&at, room, X + s * z, x_t, h, sub_steps);
            }
            double grows[torques + 1][W], creeps[torques + 1][W];
            EACH_LANE TORQUES {
                const double *its = torque + (row[l] * torques + k) * 3, keeps = exp(-h[l] * sub_steps / its[1]);
                POINTS X[s * z + n + k][l] *= keeps;
                grows[k][l] = its[0] * (1.0 - keeps * keeps);
                creeps[k][l] = its[2] * h[l] * sub_steps;
            }
            moments(z, z, X, m, P);
            TORQUES {
                VECTORS AT(P[(n + k) * (z + 1)]) += AT(grows[k]);
                VECTORS AT(P[(speed[k] - 1) * (z + 1)]) += AT(creeps[k]);
            }
            if (!path) continue;
            across(z, L, z, X, D);
            EACH_LANE for (long i = 0; i < next; i++)
                path[(row[l] * samples + t) * (now + next) + now + i] = own[i][l];
        }
    }
    free(own), free(all);
}
