/* Lanes (records, or samples of one) that go side by side, and a system's equations of motion for them: what engine.c
   and the equations of each structure (equations.c.in) agree on. compiled.py puts this file before either. */
enum { W = 8 }; /* lanes */
#define ALIGNED __attribute__((aligned(64))) /* GCC 12 takes arrays for aligned where it inlines, but does not align */
/* as many lanes at once as a register holds: V numbers, M truths */
#if defined(__AVX512F__)
enum { WIDE = 8 };
#elif defined(__AVX__)
enum { WIDE = 4 };
#else
enum { WIDE = 2 };
#endif
typedef double V __attribute__((vector_size(8 * WIDE)));
typedef long long M __attribute__((vector_size(8 * WIDE)));
typedef double InArray __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));
#define VECTORS for (int l = 0; l < W; l += WIDE)
#define AT(array) (*(InArray *)((array) + l))
#define ALL(number) ((number) - (V){}) /* a vector of one number; nothing is added to a vector, not even to -0 */
#define pick(truth, one, other) ((truth) ? (one) : (other))
#define v_pick(truth, one, other) v_picked(truth, ALL(one), ALL(other))
static inline V v_picked(M truth, V one, V other) { return (V)((truth & (M)one) | (~truth & (M)other)); }
static inline V v_fabs(V x) { return (V)((M)x & 0x7fffffffffffffffLL); }

typedef const double (*Values)[W]; /* rows of all lanes, which a function reads */
typedef double (*Rows)[W];         /* rows that it writes */

/* The equations of one structure of system. Tangents are rows, `columns` of them for each state: by the state before
   and by free parameters; none where they are not asked for. */
typedef struct {
    long states, channels, parameters, fixed, columns;
    long dry, coupled, speeds, pivots; /* dry speeds, those that share an inertia with another one, all speeds */
    const int *row, *is_coupled;       /* of each dry speed: its row of the state, whether it shares its inertia */
    /* fill `fixed`: with what depends on parameters alone, then with what depends on held inputs as well */
    void (*prepare)(const double *p, double *fixed);
    void (*hold)(Values u, Values p, Rows fixed);
    /* time derivative k of the state for directions d of dry friction, with tangents x_t, k_t */
    void (*rates)(Values x, Values x_t, Values u, Values p, Values fixed, Values d, Rows k, Rows k_t);
    /* for each dry speed at rest: where it is pushed, how far beyond what friction holds, and the torque by which its
       acceleration contradicts its trial direction d; s are the directions now */
    void (*margins)(Values x, Values u, Values p, Values fixed, Values s, Values d, Rows side, Rows margin,
                    Rows against);
    /* states that remember, half a step further; none where a system has none */
    void (*internal)(Rows x, Rows x_t, Values u, Values p, Values fixed, const double *step);
    void (*outputs)(Values x, Values u, Values p, Values fixed, Rows k); /* those that are asked for */
} Equations;
