/* strides of a, b and next by row, sample, state and column; block has room for BLOCK samples */
void condense(double *chain, double *restrict block, const double *x, const double *a, const double *b,
              const double *next, const long *strides, long rows, long samples, long n_x, long n_f, long BLOCK)
{
    const long *of_a = strides, *of_b = strides + 4, *of_next = strides + 8;
    const long through = n_x + n_f, columns = through + 1, size = n_x * columns;
    for (long r = 0; r < rows; r++) {
        double *now = chain + r * samples * size;
        for (long i = 0; i < n_x; i++)
            for (long j = 0; j < columns; j++) now[i * columns + j] = i == j;
        for (long first = 0; first + 1 < samples; first += BLOCK) {
            const long count = samples - 1 - first < BLOCK ? samples - 1 - first : BLOCK;
            for (long i = 0; i < n_x; i++) {
                for (long j = 0; j < through; j++) {
                    const int state = j < n_x;
                    const long *of = state ? of_a : of_b, stride = of[1];
                    const double *from = (state ? a : b) + r * of[0] + first * stride + i * of[2];
                    from += (state ? j : j - n_x) * of[3];
                    for (long t = 0; t < count; t++) block[t * size + i * columns + j] = from[t * stride];
                }
                const double *from = next + r * of_next[0] + first * of_next[1] + i * of_next[2];
                const double *node = x + (r * samples + first + 1) * n_x + i;
                for (long t = 0; t < count; t++)
                    block[t * size + i * columns + through] = from[t * of_next[1]] - node[t * n_x];
            }
            for (long t = 0; t < count; t++) {
                const double *of = block + t * size;
                double *restrict then = now + size;
                for (long i = 0; i < n_x; i++, of += columns) {
                    double *restrict row = then + i * columns;
                    for (long j = 0; j < columns; j++) row[j] = j < n_x ? 0.0 : of[j];
                    for (long m = 0; m < n_x; m++) {
                        const double share = of[m], *start = now + m * columns;
                        for (long j = 0; j < columns; j++) row[j] += share * start[j];
                    }
                }
                now = then;
            }
        }
    }
}

/* outputs of rows of linear maps under inputs that begin at rest; state and next have room for n_x rows of n_w columns */
void forced(double *outputs, double *state, double *next, const double *through, const double *a, const double *b,
            const double *inputs, long rows, long samples, long n_x, long n_y, long n_w)
{
    for (long r = 0; r < rows; r++) {
        for (long i = 0; i < n_x * n_w; i++) state[i] = 0.0;
        for (long k = 0; k < samples; k++) {
            for (long i = 0; i < n_y; i++, outputs += n_w) {
                for (long j = 0; j < n_w; j++) outputs[j] = 0.0;
                for (long m = 0; m < n_x; m++, through++)
                    for (long j = 0; j < n_w; j++) outputs[j] += *through * state[m * n_w + j];
            }
            for (long i = 0; i < n_x; i++, b++) {
                double *restrict row = next + i * n_w;
                for (long j = 0; j < n_w; j++) row[j] = *b * inputs[j];
                for (long m = 0; m < n_x; m++, a++)
                    for (long j = 0; j < n_w; j++) row[j] += *a * state[m * n_w + j];
            }
            double *swap = state;
            state = next, next = swap, inputs += n_w;
        }
    }
}
