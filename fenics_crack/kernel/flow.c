#include "flow.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "sets.h"

/* ORDER: of the series. BUCKETS: of sets. ANSWERS: of complementarity problems that are kept. TURNS:
 * to a root. BLOCK: numbers that a processor works on together. */
enum { ORDER = 38, TERMS = ORDER + 1, BUCKETS = 4096, ANSWERS = 64, TURNS = 100, BLOCK = 8 };

/* Length of a piece and of a step of the search for events, times the largest frequency; last
 * terms relative to the largest at the end of a piece; what rounding leaves of an answer; when
 * pairs that should have changed with the one before do so, as a part of a piece; largest length,
 * times the set's frequency, of the series of an exponential, and of its last term. */
static const double REACH = 10.0, GRID = 0.5, TAIL = 1e-16, ROUNDING = 1e-14, BEHIND = 1e-12;
static const double SHORT = 1.5, LAST = 1e-14;

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default"))) /* sums keep their order */
#else
#define WIDE
#endif

/* A set of `size` closed pairs. */
typedef struct known {
    struct known *next;
    int size;
    double *answer;      /* (p, p) N_A transposed */
    double *pairs;       /* (m, size) P_A */
    double *pushed;      /* (size, m) S P_A^T */
    double *scale;       /* (p) what turns gaps into answers: S_jj, or 1 */
    signed char *closed; /* (p) */
} known;

struct flow {
    flow_parts of;
    sets *contact;
    known *bucket[BUCKETS];
    long kept;
    double *columns;               /* (m, p) P */
    double *room;
    double *weights;               /* (TERMS, 1 + 2 K) of the load's rows */
    double *series, *gaps, *answers; /* (TERMS, m), (TERMS, p), (TERMS, p) of q, s, i */
    double *allowed;               /* (p) what of a negative answer is rounding */
    double *value, *slope;         /* (2, p) at a step's ends */
    double *near, *force;          /* (p) s of a state, its forces */
    double *seen, *drag;           /* (p), (m) */
    double *matrix;                /* (p, p + m) */
    double *turned;                /* (1 + 2 K, m + p) derivative of the load */
    double *wide;                  /* room of exponentials, or NULL */
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }

/* --- products --------------------------------------------------------------------------------- */

/* sum (n) += weights (count) times rows (count, n). */
WIDE static void add_rows(int count, int n, const double *restrict rows,
                          const double *restrict weights, double *restrict sum)
{
    int k = 0;
    if (n == 1) {
        *sum += dot(count, rows, weights);
        return;
    }
    for (; k + 3 < count; k += 4, rows += 4L * n) {
        const double a = weights[k], b = weights[k + 1], c = weights[k + 2], d = weights[k + 3];
        const double *one = rows + n, *two = one + n, *three = two + n;
        for (int i = 0; i < n; i++)
            sum[i] += (a * rows[i] + b * one[i]) + (c * two[i] + d * three[i]);
    }
    if (k + 2 < count) {
        const double a = weights[k], b = weights[k + 1], c = weights[k + 2];
        for (int i = 0; i < n; i++)
            sum[i] += (a * rows[i] + b * rows[n + i]) + c * rows[2L * n + i];
        return;
    }
    for (; k < count; k++, rows += n)
        for (int i = 0; i < n; i++) sum[i] += weights[k] * rows[i];
}

/* Values (n) of polynomials with coefficients (TERMS, n), and their slopes. */
WIDE static void evaluate(int n, const double *restrict terms, double at, double *restrict value,
                          double *restrict slope)
{
    for (int first = 0; first < n; first += BLOCK) {
        const int count = n - first < BLOCK ? n - first : BLOCK;
        double v[BLOCK] = {0.0}, d[BLOCK] = {0.0};
        const double *row = terms + (long)ORDER * n + first;
        if (count == BLOCK)
            for (int k = ORDER; k >= 0; k--, row -= n)
                for (int i = 0; i < BLOCK; i++) {
                    d[i] = d[i] * at + v[i];
                    v[i] = v[i] * at + row[i];
                }
        else
            for (int k = ORDER; k >= 0; k--, row -= n)
                for (int i = 0; i < count; i++) {
                    d[i] = d[i] * at + v[i];
                    v[i] = v[i] * at + row[i];
                }
        memcpy(value + first, v, bytes(count));
        memcpy(slope + first, d, bytes(count));
    }
}

/* --- sets of closed pairs --------------------------------------------------------------------- */

static void forget(flow *f)
{
    for (int b = 0; b < BUCKETS; b++) {
        known *first = f->bucket[b], *next;
        for (; first; first = next) {
            next = first->next;
            free(first->answer);
            free(first);
        }
        f->bucket[b] = NULL;
    }
    f->kept = 0;
}

/* What a new set is known by: 0, or 1 where D_AA is singular. */
static int fill(flow *f, known *a)
{
    const int m = f->of.modes, p = f->of.pairs, size = a->size;
    double *inverse = f->matrix, *closed = inverse + (long)size * size;
    if (answer_anew(f->contact, a->closed, a->answer)) return 1;
    for (int i = 0, row = 0; i < p; i++) {
        a->scale[i] = a->closed[i] ? a->answer[(long)i * p + i] : 1.0;
        if (!a->closed[i]) continue;
        for (int j = 0, column = 0; j < p; j++)
            if (a->closed[j]) inverse[row * size + column++] = a->answer[(long)i * p + j];
        memcpy(closed + (long)row * m, f->of.rows + (long)i * m, bytes(m));
        for (int j = 0; j < m; j++) a->pairs[(long)j * size + row] = closed[(long)row * m + j];
        row++;
    }
    multiply_matrices(size, size, m, inverse, closed, 0.0, a->pushed);
    for (int i = 0; i < p; i++)
        for (int j = 0; j < i; j++) {
            double *one = a->answer + (long)i * p + j, *two = a->answer + (long)j * p + i;
            const double held = *one;
            *one = *two, *two = held;
        }
    return 0;
}

/* NULL where there is none, or no memory. */
static const known *find(flow *f, const signed char *closed)
{
    const int m = f->of.modes, p = f->of.pairs;
    unsigned hash = 2166136261u; /* of Fowler, Noll and Vo */
    for (int i = 0; i < p; i++) hash = (hash ^ (unsigned)closed[i]) * 16777619u;
    known **bucket = &f->bucket[(hash ^ hash >> 16) % BUCKETS];
    for (known *a = *bucket; a; a = a->next)
        if (!memcmp(a->closed, closed, (size_t)p)) return a;
    int size = 0;
    for (int i = 0; i < p; i++) size += closed[i];
    const long needed = (long)p * p + 2L * m * size + p;
    if (f->kept + needed > f->of.most) forget(f);
    known *made = calloc(1, sizeof(known) + (size_t)p);
    if (!made) return NULL;
    made->size = size;
    made->answer = malloc(bytes(needed + 1));
    made->closed = (signed char *)(made + 1);
    memcpy(made->closed, closed, (size_t)p);
    if (made->answer) {
        made->pairs = made->answer + (long)p * p;
        made->pushed = made->pairs + (long)m * size;
        made->scale = made->pushed + (long)m * size;
    }
    if (!made->answer || fill(f, made)) {
        free(made->answer);
        free(made);
        return NULL;
    }
    made->next = *bucket;
    *bucket = made;
    f->kept += needed;
    return made;
}

/* --- the series ------------------------------------------------------------------------------- */

/* Coefficients of 1, cos and sin of the load's phases from a time on, in parts of a length. */
static void wave(flow *f, double omega, double now, double length, int by_time)
{
    const int width = 1 + 2 * f->of.harmonics;
    double *w = f->weights;
    for (int k = 0; k < width; k++) w[k] = k == 0;
    for (int n = 1; n < TERMS; n++) w[n * width] = 0.0;
    for (int k = 1; k <= f->of.harmonics; k++) {
        const double c = cos(k * omega * now), s = sin(k * omega * now);
        double size = 1.0;
        for (int n = 0; n < TERMS; n++) {
            const double sign = n & 2 ? -size : size;
            w[n * width + 2 * k - 1] = n & 1 ? -sign * s : sign * c;
            w[n * width + 2 * k] = n & 1 ? sign * c : sign * s;
            size *= k * omega * length / (n + 1);
        }
    }
    if (!by_time) return;
    for (int n = ORDER; n >= 0; n--)
        for (int k = 0; k < width; k++)
            w[n * width + k] = now * w[n * width + k]
                               + (n ? length * w[(n - 1) * width + k] : 0.0);
}

/* Series of q of a piece, from a state. */
WIDE static void expand(flow *f, const known *a, const double *force, const double *gap,
                        double length, const double *state)
{
    const int m = f->of.modes, p = f->of.pairs, width = 1 + 2 * f->of.harmonics, size = a->size;
    const double *restrict squares = f->of.squares, *damping = f->of.damping;
    double *restrict seen = f->seen, *restrict drag = f->drag;
    memcpy(f->series, state, bytes(m));
    for (int j = 0; j < m; j++) f->series[m + j] = length * state[m + j];
    for (int n = 0; n + 2 < TERMS; n++) {
        const double *restrict now = f->series + (long)n * m, *restrict rate = now + m;
        double *restrict next = f->series + (long)(n + 2) * m;
        const double *w = f->weights + n * width;
        const double gain = length * length / ((n + 1) * (n + 2)), loss = length / (n + 2);
        for (int j = 0; j < m; j++) next[j] = -squares[j] * now[j];
        add_rows(width, m, force, w, next);
        if (size) {
            for (int i = 0, row = 0; i < p; i++) {
                if (!a->closed[i]) continue;
                double sum = 0.0;
                for (int k = 0; k < width; k++) sum += w[k] * gap[k * p + i];
                seen[row++] = sum;
            }
            add_rows(m, size, a->pairs, now, seen);
            for (int i = 0; i < size; i++) seen[i] = -seen[i];
            add_rows(size, m, a->pushed, seen, next);
        }
        if (f->of.coupled) {
            multiply(m, m, damping, rate, drag);
            for (int j = 0; j < m; j++) next[j] = gain * next[j] - loss * drag[j];
        } else
            for (int j = 0; j < m; j++) next[j] = gain * next[j] - loss * damping[j] * rate[j];
    }
}

/* Largest numbers of the rows of a series (TERMS, n). */
WIDE static void sizes_of(int n, const double *restrict terms, double *restrict sizes)
{
    for (int k = 0; k < TERMS; k++, terms += n) {
        double most[4] = {0.0};
        int i = 0;
        for (; i + 3 < n; i += 4)
            for (int j = 0; j < 4; j++) most[j] = larger(fabs(terms[i + j]), most[j]);
        for (; i < n; i++) most[0] = larger(fabs(terms[i]), most[0]);
        sizes[k] = larger(larger(most[0], most[1]), larger(most[2], most[3]));
    }
}

/* How much of a piece a series with rows of these sizes holds for, at most `within`. */
static double valid(const double *sizes, double within)
{
    double largest = 0.0;
    const double tail = larger(sizes[ORDER - 1], sizes[ORDER]);
    for (int k = 0; k < TERMS; k++) largest = larger(sizes[k], largest);
    if (tail * pow(within, ORDER - 1) <= TAIL * largest) return within;
    return smaller(within, pow(TAIL * largest / tail, 1.0 / (ORDER - 1)));
}

/* Series of the gaps s and of the answers, and what is rounding in these where the series holds. */
static void answer(flow *f, const known *a, const double *gap)
{
    const int m = f->of.modes, p = f->of.pairs, width = 1 + 2 * f->of.harmonics;
    multiply_matrices(TERMS, width, p, f->weights, gap, 0.0, f->gaps);
    multiply_matrices(TERMS, m, p, f->series, f->columns, 1.0, f->gaps);
    multiply_matrices(TERMS, p, p, f->gaps, a->answer, 0.0, f->answers);
}

static void round_off(flow *f, const known *a, const double *sizes, double length)
{
    double largest = 0.0, power = 1.0;
    for (int n = 0; n < TERMS; n++, power *= length) largest = larger(power * sizes[n], largest);
    for (int i = 0; i < f->of.pairs; i++) f->allowed[i] = ROUNDING * largest * a->scale[i];
}

static void state_at(const flow *f, double length, double at, double *state)
{
    const int m = f->of.modes;
    evaluate(m, f->series, at, state, state + m);
    for (int j = m; j < 2 * m; j++) state[j] /= length;
}

/* --- events ----------------------------------------------------------------------------------- */

static double value_at(const flow *f, int pair, int order, double at, double *slope)
{
    const int p = f->of.pairs;
    double v = 0.0, d = 0.0;
    for (int n = ORDER; n >= order; n--) {
        const double term = f->answers[(long)n * p + pair];
        d = d * at + v;
        v = v * at + (order ? n * term : term);
    }
    *slope = d;
    return v;
}

/* Where an answer (order 0) falls through zero, or its slope (1) rises through it: Newton's method,
 * kept between by bisection. */
static double zero_of(const flow *f, int pair, int order, double low, double high)
{
    double slope, root = 0.5 * (low + high);
    for (int turn = 0; turn < TURNS && high - low > 1e-16 * high; turn++) {
        const double now = value_at(f, pair, order, root, &slope), newton = root - now / slope;
        if (now == 0.0) return root;
        if ((now > 0.0) == (order == 0)) low = root;
        else high = root;
        if (fabs(newton - root) <= 1e-15 * high) return root;
        root = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    return root;
}

/* When an answer becomes negative in a step of the search, from its values and slopes at the ends;
 * NAN: it does not. Where several change at one instant, as in mirror images, each of the others is
 * found to fall from zero in a next piece: one is changed after the other, the first of them first,
 * which ends (Murty, Opsearch 11 (1974) 90). */
static double falls(const flow *f, int pair, double low, double high, const double *value,
                    const double *slope)
{
    const int p = f->of.pairs;
    double other, bottom;
    if (value[p] >= -f->allowed[pair]) {
        /* Both ends positive, but a minimum between them may not be. */
        if (!(slope[0] < 0.0 && slope[p] > 0.0 && value[0] + (high - low) * slope[0] < 0.0))
            return NAN;
        high = zero_of(f, pair, 1, low, high);
        bottom = value_at(f, pair, 0, high, &other);
        if (bottom >= -f->allowed[pair]) return NAN;
    }
    if (value[0] <= f->allowed[pair]) low = larger(low, BEHIND);
    if (low >= high || value_at(f, pair, 0, low, &other) <= 0.0) return low;
    return zero_of(f, pair, 0, low, high);
}

/* Values and slopes (BLOCK, p) of answers at as many instants, for fewer pairs than that. */
WIDE static void look_ahead(const flow *f, const double *restrict at, double *restrict value,
                            double *restrict slope)
{
    const int p = f->of.pairs;
    for (int i = 0; i < p; i++) {
        const double *row = f->answers + (long)ORDER * p + i;
        double v[BLOCK] = {0.0}, d[BLOCK] = {0.0};
        for (int n = ORDER; n >= 0; n--, row -= p)
            for (int k = 0; k < BLOCK; k++) {
                d[k] = d[k] * at[k] + v[k];
                v[k] = v[k] * at[k] + *row;
            }
        for (int k = 0; k < BLOCK; k++) value[k * p + i] = v[k], slope[k * p + i] = d[k];
    }
}

/* The first pair that changes its state, and when; -1: none before `end`. */
static int next_event(flow *f, double step, double end, double *when)
{
    const int p = f->of.pairs, many = p < BLOCK ? BLOCK : 1;
    double values[(BLOCK + 1) * BLOCK], slopes[(BLOCK + 1) * BLOCK], at[BLOCK + 1] = {0.0};
    double *value = many > 1 ? values : f->value, *slope = many > 1 ? slopes : f->slope;
    memcpy(value, f->answers, bytes(p));
    memcpy(slope, f->answers + p, bytes(p));
    for (int first = 0; p && first * step < end; first += many) {
        for (int k = 0; k < many; k++) at[k + 1] = smaller((first + k + 1) * step, end);
        if (many > 1) look_ahead(f, at + 1, value + p, slope + p);
        else evaluate(p, f->answers, at[1], value + p, slope + p);
        for (int k = 0; k < many && at[k] < end; k++) {
            int found = -1;
            for (int i = k * p; i < (k + 1) * p; i++) {
                if (value[p + i] >= 0.0 && !(slope[i] < 0.0 && slope[p + i] > 0.0)) continue;
                const double root = falls(f, i - k * p, at[k], at[k + 1], value + i, slope + i);
                if (isnan(root) || (found >= 0 && root >= *when)) continue;
                found = i - k * p;
                *when = root;
            }
            if (found >= 0) return found;
        }
        at[0] = at[many];
        memcpy(value, value + many * p, bytes(p));
        memcpy(slope, slope + many * p, bytes(p));
    }
    return -1;
}

/* The set of closed pairs of a state, and their forces. */
static int contact_at(flow *f, double omega, double time, const double *state, signed char *closed)
{
    const int m = f->of.modes, p = f->of.pairs, width = 1 + 2 * f->of.harmonics;
    wave(f, omega, time, 0.0, 0);
    multiply(p, m, f->of.rows, state, f->near);
    add_rows(width, p, f->of.gap, f->weights, f->near);
    for (int i = 0; i < p; i++) closed[i] = f->near[i] > 0.0;
    return forces_at(f->contact, f->near, 0.0, NULL, closed, f->force);
}

/* The motion at the instants up to the end of a piece. */
static void sample(const flow *f, flow_motion *m, const signed char *closed, double length,
                   double end, int last)
{
    const int n = f->of.modes, p = f->of.pairs;
    for (; m->sampled < m->count; m->sampled++) {
        const double at = larger(0.0, (m->instants[m->sampled] - m->now) / length);
        const long row = m->sampled;
        if (!last && at >= end) break;
        state_at(f, length, smaller(at, end), m->states + row * 2 * n);
        evaluate(p, f->answers, smaller(at, end), m->answers + row * p, f->value);
        memcpy(m->closed + row * p, closed, (size_t)p);
    }
}

/* Another piece of the track, in the last interval or in a new one. */
static void passed(flow_motion *m, int p, const signed char *closed, double length)
{
    if (m->passed && !memcmp(m->sets + (long)(m->passed - 1) * p, closed, (size_t)p)) {
        m->lengths[m->passed - 1] += length;
        return;
    }
    memcpy(m->sets + (long)m->passed * p, closed, (size_t)p);
    m->lengths[m->passed++] = length;
}

static double fastest(const flow *f, double omega)
{
    return larger(larger(f->of.fastest, f->of.harmonics * omega), 1e-300);
}

static int finite_state(int count, const double *state)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += 0.0 * state[i];
    return sum == 0.0;
}

int flow_advance(flow *f, flow_motion *m)
{
    const int p = f->of.pairs;
    const double length = REACH / fastest(f, m->omega);
    double sizes[TERMS];
    signed char *closed = (signed char *)(f->force + p);
    if (contact_at(f, m->omega, m->now, m->state, closed)) return FLOW_LOST;
    for (; m->now < m->end; m->pieces++) {
        const double left = (m->end - m->now) / length; /* pieces at least */
        if (m->pieces + left > m->most_pieces) return FLOW_PIECES;
        if (m->passed == m->most) return FLOW_INTERVALS;
        const known *a = find(f, closed);
        if (!a) return FLOW_MEMORY;
        wave(f, m->omega, m->now, length, 0);
        expand(f, a, f->of.force, f->of.gap, length, m->state);
        answer(f, a, f->of.gap);
        sizes_of(f->of.modes, f->series, sizes);
        double end = valid(sizes, smaller(1.0, left));
        sizes_of(p, f->gaps, sizes);
        end = valid(sizes, end);
        if (!(end > 0.0)) return FLOW_LOST;
        round_off(f, a, sizes, end);
        double when = end;
        const int pair = next_event(f, GRID / REACH, end, &when);
        const int last = pair < 0 && end == left;
        sample(f, m, closed, length, when, last);
        state_at(f, length, when, m->state);
        if (!finite_state(2 * f->of.modes, m->state)) return FLOW_LOST;
        passed(m, p, closed, when * length);
        m->now = last ? m->end : m->now + when * length;
        if (pair < 0) continue;
        closed[pair] = !closed[pair];
        m->events++;
    }
    return FLOW_DONE;
}

int flow_column(flow *f, const flow_track *track, const double *force, const double *gap,
                int by_time, double *state)
{
    const double length = REACH / fastest(f, track->omega);
    double now = track->start, sizes[TERMS];
    for (int k = 0; k < track->intervals; k++) {
        const known *a = find(f, track->sets + (long)k * f->of.pairs);
        if (!a) return FLOW_MEMORY;
        for (double left = track->lengths[k] / length; left > 0.0;) {
            wave(f, track->omega, now, length, by_time);
            expand(f, a, force, gap, length, state);
            sizes_of(f->of.modes, f->series, sizes);
            const double end = valid(sizes, smaller(1.0, left));
            if (!(end > 0.0)) return FLOW_LOST;
            state_at(f, length, end, state);
            left -= end;
            now += end * length;
        }
    }
    return FLOW_DONE;
}

int flow_by_omega(flow *f, const flow_track *track, double *state)
{
    /* d/d omega of c cos(k omega t) + s sin(k omega t) is t times k s cos - k c sin. */
    const int m = f->of.modes, p = f->of.pairs;
    double *force = f->turned, *gap = force + (1 + 2 * f->of.harmonics) * m;
    for (int k = 1; k <= f->of.harmonics; k++) {
        const int cosine = 2 * k - 1, sine = 2 * k;
        for (int j = 0; j < m; j++) {
            force[cosine * m + j] = k * f->of.force[sine * m + j];
            force[sine * m + j] = -k * f->of.force[cosine * m + j];
        }
        for (int i = 0; i < p; i++) {
            gap[cosine * p + i] = k * f->of.gap[sine * p + i];
            gap[sine * p + i] = -k * f->of.gap[cosine * p + i];
        }
    }
    memset(force, 0, bytes(m)), memset(gap, 0, bytes(p));
    memset(state, 0, bytes(2 * m));
    return flow_column(f, track, force, gap, 1, state);
}

int flow_rate(flow *f, double omega, double time, const double *state, double *rate)
{
    const int m = f->of.modes, width = 1 + 2 * f->of.harmonics;
    double *faster = rate + m;
    if (contact_at(f, omega, time, state, (signed char *)(f->force + f->of.pairs))) return 1;
    memcpy(rate, state + m, bytes(m));
    multiply(m, f->of.pairs, f->columns, f->force, faster);
    if (f->of.coupled) multiply(m, m, f->of.damping, rate, f->drag);
    else
        for (int j = 0; j < m; j++) f->drag[j] = f->of.damping[j] * rate[j];
    for (int j = 0; j < m; j++)
        faster[j] = -faster[j] - f->drag[j] - f->of.squares[j] * state[j];
    add_rows(width, m, f->of.force, f->weights, faster);
    return 0;
}

/* --- the tangent ------------------------------------------------------------------------------ */

/* Matrices (m, m) of an exponential: in units of a frequency w, exp = I + F with
 *
 *     F = [ D + b C   b ]        b'' + C b' + K b = 0,   b(0) = 0,   b'(0) = I,   D = b' - I,
 *         [ -b K      D ]
 *
 * because exp commutes with the flow's matrix; and doubled by F -> 2 F + F F. */
typedef struct {
    double *stiffness, *terms, *upper, *right, *change, *other, *product;
} exponential_room;

static void add_damped(const flow *f, double unit, const double *b, double *sum)
{
    const int m = f->of.modes;
    if (f->of.coupled) {
        multiply_matrices(m, m, m, b, f->of.damping, unit, sum);
        return;
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++)
            sum[i * m + j] = unit * sum[i * m + j] + b[i * m + j] * f->of.damping[j];
}

/* right = [b; D] of a short time in which what is fastest turns by an angle; all in units of the
 * frequency. */
WIDE static void short_series(const flow *f, double unit, double time, double turn,
                         exponential_room *r)
{
    const int m = f->of.modes;
    const long square = (long)m * m;
    double *before = r->terms, *now = before + square, *next = now + square;
    double *b = r->right, *d = b + square;
    for (long i = 0; i < square; i++) before[i] = d[i] = 0.0, now[i] = b[i] = 0.0;
    for (int i = 0; i < m; i++) now[(long)i * (m + 1)] = b[(long)i * (m + 1)] = time;
    double size = turn;
    for (int n = 0; size > LAST; n++, size *= turn / (n + 1)) {
        const double gain = -time * time / ((n + 1) * (n + 2)), loss = -time / (n + 2) / unit;
        if (n > 1) multiply_matrices(m, m, m, r->stiffness, before, 0.0, next);
        else /* of b_0 = 0 and b_1 = time I */
            for (long i = 0; i < square; i++) next[i] = n * time * r->stiffness[i];
        if (f->of.coupled) {
            multiply_matrices(m, m, m, f->of.damping, now, gain / loss, next);
            for (long i = 0; i < square; i++) next[i] *= loss;
        } else
            for (int i = 0; i < m; i++) {
                const double rate = loss * f->of.damping[i];
                for (int j = 0; j < m; j++)
                    next[(long)i * m + j] = gain * next[(long)i * m + j] + rate * now[(long)i * m + j];
            }
        for (long i = 0; i < square; i++) {
            b[i] += next[i];
            d[i] += (n + 2) / time * next[i];
        }
        double *last = before;
        before = now, now = next, next = last;
    }
}

/* upper = [D + b C; -b K] of right = [b; D]. */
WIDE static void complete(const flow *f, double unit, exponential_room *r)
{
    const int m = f->of.modes;
    const long square = (long)m * m;
    memcpy(r->upper, r->right + square, bytes(square));
    for (long i = 0; i < square; i++) r->upper[i] *= unit;
    add_damped(f, 1.0, r->right, r->upper);
    for (long i = 0; i < square; i++) r->upper[i] /= unit;
    multiply_matrices(m, m, m, r->right, r->stiffness, 0.0, r->upper + square);
    for (long i = square; i < 2 * square; i++) r->upper[i] = -r->upper[i];
}

/* change = F of an interval. */
static void exponential_of(const flow *f, const known *a, double unit, double length,
                           exponential_room *r)
{
    const int m = f->of.modes;
    const long square = (long)m * m;
    double *k = r->stiffness, largest = 0.0;
    multiply_matrices(m, a->size, m, a->pairs, a->pushed, 0.0, k);
    for (int i = 0; i < m; i++) {
        double sum = 0.0;
        k[(long)i * (m + 1)] += f->of.squares[i];
        for (int j = 0; j < m; j++) {
            k[(long)i * m + j] /= unit * unit;
            sum += fabs(k[(long)i * m + j]);
        }
        largest = larger(largest, sum);
    }
    double rate = 0.0;
    for (int i = 0; i < m; i++) {
        double sum = 0.0;
        for (int j = 0; j < (f->of.coupled ? m : 1); j++)
            sum += fabs(f->of.damping[f->of.coupled ? (long)i * m + j : i]);
        rate = larger(rate, sum / unit);
    }
    rate += smaller(1.0, sqrt(largest)); /* no set is faster than the fastest one */
    double time = unit * length;
    int halved = 0;
    for (; time * rate > SHORT; halved++) time *= 0.5;
    short_series(f, unit, time, time * rate, r);
    complete(f, unit, r);
    for (; halved; halved--) {
        double *right = r->right, *doubled = r->other;
        for (long i = 0; i < 2 * square; i++) doubled[i] = 2.0 * right[i];
        multiply_matrices(2 * m, m, m, r->upper, right, 1.0, doubled);
        multiply_matrices(2 * m, m, m, right, right + square, 1.0, doubled);
        r->right = doubled, r->other = right;
        complete(f, unit, r);
    }
    for (int i = 0; i < 2 * m; i++) {
        memcpy(r->change + (long)i * 2 * m, r->upper + (long)i * m, bytes(m));
        memcpy(r->change + (long)i * 2 * m + m, r->right + (long)i * m, bytes(m));
    }
}

/* product = exp product of an interval in which no pair is closed: each mode swings by itself,
 * b'' + c b' + k b = 0 with b(0) = 0, b'(0) = 1. */
static void swing(const flow *f, double unit, double length, double *product)
{
    const int m = f->of.modes;
    const double t = unit * length;
    for (int i = 0; i < m; i++) {
        const double c = f->of.damping[i] / unit, k = f->of.squares[i] / (unit * unit);
        const double square = k - 0.25 * c * c, w = sqrt(fabs(square));
        const double fall = exp((square > 0.0 ? -0.5 * c : w - 0.5 * c) * t);
        double b = fall * t, rate = fall;
        if (square > 0.0) b = fall * sin(w * t) / w, rate *= cos(w * t);
        else if (w > 0.0) {
            const double lost = expm1(-2.0 * w * t);
            b = -fall * lost / (2.0 * w), rate *= 1.0 + 0.5 * lost;
        }
        rate -= 0.5 * c * b;
        const double stay = rate + c * b;
        double *restrict q = product + (long)i * 2 * m, *restrict v = q + 2L * m * m;
        for (int j = 0; j < 2 * m; j++) {
            const double before = q[j];
            q[j] = stay * before + b * v[j];
            v[j] = rate * v[j] - b * k * before;
        }
    }
}

int flow_tangent(flow *f, const flow_track *track, double *product)
{
    const int m = f->of.modes;
    const long square = (long)m * m;
    const double unit = fastest(f, 0.0);
    if (!f->wide) f->wide = malloc(bytes(18 * square + 1));
    if (!f->wide) return FLOW_MEMORY;
    exponential_room r;
    r.stiffness = f->wide, r.terms = r.stiffness + square, r.upper = r.terms + 3 * square;
    r.right = r.upper + 2 * square, r.other = r.right + 2 * square;
    r.change = r.other + 2 * square, r.product = r.change + 4 * square;
    for (long i = 0; i < 2 * square; i++) product[i] *= unit;
    for (int k = 0; k < track->intervals; k++) {
        const known *a = find(f, track->sets + (long)k * f->of.pairs);
        if (!a) return FLOW_MEMORY;
        if (!a->size && !f->of.coupled) {
            swing(f, unit, track->lengths[k], product);
            continue;
        }
        exponential_of(f, a, unit, track->lengths[k], &r);
        memcpy(r.product, product, bytes(4 * square));
        multiply_matrices(2 * m, 2 * m, 2 * m, r.change, r.product, 1.0, product);
    }
    for (long i = 0; i < 2 * square; i++) product[i] /= unit;
    return finite_state((int)(4 * square), product) ? FLOW_DONE : FLOW_LOST;
}

int flow_wave(flow *f, flow_motion *m, int nodes, double period, const double *states,
              double *moved, double *tangents)
{
    const long size = 2L * f->of.modes;
    memcpy(moved, states, bytes(nodes * size));
    memset(tangents, 0, bytes(nodes * size * size));
    for (int i = 0; i < nodes; i++) {
        m->now = i * period / nodes, m->end = (i + 1) * period / nodes;
        m->state = moved + i * size;
        m->passed = 0;
        int outcome = flow_advance(f, m);
        if (outcome != FLOW_DONE) return outcome;
        const flow_track track = {m->omega, i * period / nodes, m->passed, m->sets, m->lengths};
        double *tangent = tangents + i * size * size;
        for (long j = 0; j < size; j++) tangent[j * (size + 1)] = 1.0;
        if ((outcome = flow_tangent(f, &track, tangent)) != FLOW_DONE) return outcome;
    }
    return FLOW_DONE;
}

/* --- made and freed --------------------------------------------------------------------------- */

static double *copied(double **place, const double *from, long count)
{
    double *found = *place;
    memcpy(found, from, bytes(count));
    *place += count;
    return found;
}

static double *taken(double **place, long count)
{
    double *found = *place;
    *place += count;
    return found;
}

flow *new_flow(const flow_parts *given)
{
    const long m = given->modes, p = given->pairs, width = 1 + 2 * given->harmonics;
    const long damping = given->coupled ? m * m : m;
    flow *f = calloc(1, sizeof(flow));
    if (!f) return NULL;
    f->of = *given;
    f->contact = new_sets((int)p, given->compliance, ANSWERS);
    f->room = malloc(bytes(m + damping + 2 * p * m + TERMS * (width + m + 2 * p) + 10 * p + m
                           + p * (p + m) + width * (m + p) + 1));
    if (!f->contact || !f->room) {
        free_flow(f);
        return NULL;
    }
    double *place = f->room;
    f->of.squares = copied(&place, given->squares, m);
    f->of.damping = copied(&place, given->damping, damping);
    f->of.rows = copied(&place, given->rows, p * m);
    f->columns = taken(&place, m * p);
    for (long i = 0; i < p; i++)
        for (long j = 0; j < m; j++) f->columns[j * p + i] = given->rows[i * m + j];
    f->weights = taken(&place, TERMS * width);
    f->series = taken(&place, TERMS * m);
    f->gaps = taken(&place, TERMS * p);
    f->answers = taken(&place, TERMS * p);
    f->allowed = taken(&place, p);
    f->value = taken(&place, 2 * p);
    f->slope = taken(&place, 2 * p);
    f->near = taken(&place, p);
    f->seen = taken(&place, p);
    f->drag = taken(&place, m);
    f->matrix = taken(&place, p * (p + m));
    f->turned = taken(&place, width * (m + p));
    f->force = taken(&place, 2 * p); /* and the set behind it */
    return f;
}

void free_flow(flow *f)
{
    forget(f);
    if (f->contact) free_sets(f->contact);
    free(f->room);
    free(f->wide);
    free(f);
}
