#include "exponential.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "series.h"

/* All in units of the frequency. exp = I + F with
 *
 *     F = [ D + b C   b ]        b'' + C b' + K b = 0,   b(0) = 0,   b'(0) = I,   D = b' - I,
 *         [ -b K      D ]
 *
 * because exp commutes with the flow's matrix; and doubled by F -> 2 F + F F.
 *
 * Of a set that soon goes over into the next one, with few pairs, it is kicks of its forces, v -= t / 2
 * P S P^T q with S - (2 - sqrt 3) / 12 t^2 S P^T P S for S, at Gauss's two instants of a step t, between
 * which modes swing: of fourth order (Chin, Physics Letters A 226 (1997) 344, algorithm B). With E the
 * swing and X the product a kick at the time s adds E(-s) [0; P] times rows of E(s) X, -t / 2 S P^T of
 * its displacements; kicks that follow each other are added together. */
struct exponentials {
    int modes, coupled;
    double unit, rate; /* rate: of the damping, at most */
    double *squares;   /* (m) */
    double *damping;   /* (m) or (m, m) C */
    const closed_set *set;
    double *stiffness; /* (m, m) K */
    double *through; /* (m, m) what passes the pairs of a set with few; H */
    double *terms;     /* (3, m, m) of b's series */
    double *upper;     /* (2, m, m) D + b C and -b K */
    double *right;     /* (2, m, m) b and D */
    double *other;     /* (2, m, m) these of twice the time */
    double *change;    /* (2 m, 2 m) F */
    double *product;   /* (2 m, 2 m) */
    int kicks;         /* that are still to be added, to a product that swings for */
    double since;      /* this time */
    double *kicked, *pulled; /* (kicks, 2 m) E(-s) [0; P], transposed, and the rows of E(s) */
};

/* Turn of what is fastest in a step by kicks, whose error is then 1e-14. */
#define MAX_KICK_ANGLE 0.01

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

exponentials *new_exponentials(int modes, int coupled, const double *squares,
                               const double *damping, double unit)
{
    const long m = modes, square = m * m, damped = coupled ? square : m;
    exponentials *e = calloc(1, sizeof(exponentials));
    if (!e) return NULL;
    e->squares = malloc(bytes(m + damped + 23 * square + 1));
    if (!e->squares) {
        free(e);
        return NULL;
    }
    e->modes = modes;
    e->coupled = coupled;
    e->unit = unit;
    e->damping = e->squares + m;
    e->stiffness = e->damping + damped;
    e->through = e->stiffness + square;
    e->terms = e->through + square;
    e->upper = e->terms + 3 * square;
    e->right = e->upper + 2 * square;
    e->other = e->right + 2 * square;
    e->change = e->other + 2 * square;
    e->product = e->change + 4 * square;
    e->kicked = e->product + 4 * square;
    e->pulled = e->kicked + 2 * square;
    for (long i = 0; i < m; i++) e->squares[i] = squares[i] / (unit * unit);
    for (long i = 0; i < damped; i++) e->damping[i] = damping[i] / unit;
    for (long i = 0; i < m; i++) {
        double sum = 0.0;
        for (long j = 0; j < damped / m; j++) sum += fabs(e->damping[i * (damped / m) + j]);
        e->rate = fmax(e->rate, sum);
    }
    return e;
}

void free_exponentials(exponentials *e)
{
    free(e->squares);
    free(e);
}

/* sum += b C. */
static void add_damped(const exponentials *e, const double *b, double *sum)
{
    const int m = e->modes;
    if (e->coupled) {
        multiply_matrices(m, m, m, b, e->damping, 1.0, sum);
        return;
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) sum[i * m + j] += b[i * m + j] * e->damping[j];
}

/* Whether K is a diagonal and the products of few rows and columns. */
static int has_few_pairs(const exponentials *e) { return !e->set->stiffness; }

/* found = K x. */
static void stiffness_times(const exponentials *e, const double *x, double *found)
{
    const int m = e->modes, a = e->set->size;
    if (!has_few_pairs(e)) {
        multiply_matrices(m, m, m, e->stiffness, x, 0.0, found);
        return;
    }
    multiply_matrices(a, m, m, e->set->pushed, x, 0.0, e->through);
    multiply_matrices(m, a, m, e->set->pairs, e->through, 0.0, found);
    const double unit = 1.0 / (e->unit * e->unit);
    for (int i = 0; i < m; i++)
        for (long j = (long)i * m; j < (long)(i + 1) * m; j++)
            found[j] = unit * found[j] + e->squares[i] * x[j];
}

/* The term behind the n-th: next = -(K before t / (n + 1) + C now) t / (n + 2). */
WIDE static void next_term(const exponentials *e, int n, double time, const double *before,
                           const double *now, double *next)
{
    const int m = e->modes;
    const long square = (long)m * m;
    const double gain = -time * time / ((n + 1) * (n + 2)), loss = -time / (n + 2);
    if (n > 1) stiffness_times(e, before, next);
    else /* of b_0 = 0 and b_1 = time I */
        for (long i = 0; i < square; i++) next[i] = n * time * e->stiffness[i];
    if (e->coupled) {
        multiply_matrices(m, m, m, e->damping, now, gain / loss, next);
        for (long i = 0; i < square; i++) next[i] *= loss;
        return;
    }
    for (int i = 0; i < m; i++) {
        const double rate = loss * e->damping[i];
        for (long j = (long)i * m; j < (long)(i + 1) * m; j++)
            next[j] = gain * next[j] + rate * now[j];
    }
}

/* right = [b; D] of a short time in which what is fastest turns by an angle. */
WIDE static void short_series(exponentials *e, double time, double turn)
{
    const int m = e->modes;
    const long square = (long)m * m;
    double *before = e->terms, *now = before + square, *next = now + square;
    double *b = e->right, *d = b + square, size = turn;
    memset(before, 0, bytes(2 * square));
    memset(b, 0, bytes(2 * square));
    for (int i = 0; i < m; i++) now[(long)i * (m + 1)] = b[(long)i * (m + 1)] = time;
    for (int n = 0; size > DBL_EPSILON; n++, size *= turn / (n + 1)) {
        double *last = before;
        next_term(e, n, time, before, now, next);
        for (long i = 0; i < square; i++) {
            b[i] += next[i];
            d[i] += (n + 2) / time * next[i];
        }
        before = now;
        now = next;
        next = last;
    }
}

/* found = b, transposed, of coupled modes: only a symmetric C makes b symmetric, too. */
static const double *transposed(const exponentials *e, const double *b, double *found)
{
    const long m = e->modes;
    if (!e->coupled) return b;
    for (long i = 0; i < m; i++)
        for (long j = 0; j < m; j++) found[j * m + i] = b[i * m + j];
    return found;
}

/* upper = [D + b C; -b K] of right = [b; D]: b K is K b^T, transposed, as b'' + b' C + b K = 0, too. */
WIDE static void complete(exponentials *e)
{
    const int m = e->modes;
    const long square = (long)m * m;
    memcpy(e->upper, e->right + square, bytes(square));
    add_damped(e, e->right, e->upper);
    stiffness_times(e, transposed(e, e->right, e->other + square), e->other);
    for (long i = 0; i < m; i++)
        for (long j = 0; j < m; j++) e->upper[square + i * m + j] = -e->other[j * m + i];
}

/* K of a set; its largest sum of a row. */
static double stiffness_of(exponentials *e, const closed_set *a)
{
    const int m = e->modes;
    double *k = e->stiffness, largest = 0.0;
    e->set = a;
    if (a->stiffness) memcpy(k, a->stiffness, bytes((long)m * m));
    else multiply_matrices(m, a->size, m, a->pairs, a->pushed, 0.0, k);
    for (int i = 0; i < m; i++) {
        double sum = 0.0;
        for (int j = 0; j < m; j++) k[(long)i * m + j] /= e->unit * e->unit;
        k[(long)i * (m + 1)] += e->squares[i];
        for (int j = 0; j < m; j++) sum += fabs(k[(long)i * m + j]);
        largest = fmax(largest, sum);
    }
    return largest;
}

/* doubled = [b; D] of twice the time, of right = [b; D]. Where each mode is damped by itself b and D
 * are symmetric, so that (D + b C) b + b D is H b and its transpose, H = D + b C / 2. */
WIDE static void double_series(exponentials *e, const double *right, double *doubled)
{
    const int m = e->modes;
    const long square = (long)m * m;
    const double *d = right + square;
    for (long i = 0; i < 2 * square; i++) doubled[i] = 2.0 * right[i];
    if (e->coupled) {
        multiply_matrices(m, m, m, e->upper, right, 1.0, doubled);
        multiply_matrices(m, m, m, right, d, 1.0, doubled);
    } else {
        for (long i = 0; i < square; i++) e->through[i] = 0.5 * (d[i] + e->upper[i]);
        multiply_matrices(m, m, m, e->through, right, 0.0, e->product);
        for (long i = 0; i < m; i++)
            for (long j = 0; j < m; j++)
                doubled[i * m + j] += e->product[i * m + j] + e->product[j * m + i];
    }
    multiply_matrices(m, m, m, e->upper + square, right, 1.0, doubled + square);
    multiply_matrices(m, m, m, d, d, 1.0, doubled + square);
}

/* change = F of an interval. */
static void exponential_of(exponentials *e, const closed_set *a, double length)
{
    const int m = e->modes;
    /* No set is faster than the unit. */
    const double rate = e->rate + fmin(1.0, sqrt(stiffness_of(e, a)));
    double time = e->unit * length;
    int halved = 0;
    for (; time * rate > 3.0; halved++) time *= 0.5; /* in that of a series it turns by 3 at most */
    short_series(e, time, time * rate);
    complete(e);
    for (; halved; halved--) {
        double *right = e->right, *doubled = e->other;
        double_series(e, right, doubled);
        e->right = doubled;
        e->other = right;
        complete(e);
    }
    for (long i = 0; i < 2L * m; i++) {
        memcpy(e->change + i * 2 * m, e->upper + i * m, bytes(m));
        memcpy(e->change + i * 2 * m + m, e->right + i * m, bytes(m));
    }
}

/* Of a mode that swings by itself, b'' + c b' + k b = 0 with b(0) = 0, b'(0) = 1: b, its rate, and the
 * displacement from 1 at rest. */
typedef struct {
    double b, rate, stay;
} swinging;

static swinging swing_of(const exponentials *e, int mode, double time)
{
    const double c = e->damping[mode], k = e->squares[mode];
    const double square = k - 0.25 * c * c, w = sqrt(fabs(square));
    const double fall = exp((square > 0.0 ? -0.5 * c : w - 0.5 * c) * time);
    swinging found = {fall * time, fall, 0.0};
    if (square > 0.0) {
        found.b = fall * sin(w * time) / w;
        found.rate *= cos(w * time);
    } else if (w > 0.0) {
        const double lost = expm1(-2.0 * w * time);
        found.b = -fall * lost / (2.0 * w);
        found.rate *= 1.0 + 0.5 * lost;
    }
    found.rate -= 0.5 * c * found.b;
    found.stay = found.rate + c * found.b;
    return found;
}

/* The same while no pair is closed. */
WIDE static void swing(const exponentials *e, double time, double *product)
{
    const int m = e->modes;
    for (int i = 0; i < m; i++) {
        const swinging of = swing_of(e, i, time);
        const double back = -of.b * e->squares[i];
        double *restrict q = product + (long)i * 2 * m, *restrict v = q + 2L * m * m;
        for (int j = 0; j < 2 * m; j++) {
            const double before = q[j];
            q[j] = of.stay * before + of.b * v[j];
            v[j] = of.rate * v[j] + back * before;
        }
    }
}

/* Kicks of a set, by so many steps. */
static void kick(exponentials *e, const closed_set *a, double time, int steps)
{
    const int m = e->modes, size = a->size;
    const double unit = 1.0 / (e->unit * e->unit), t = time / steps, gauss = 0.5 / sqrt(3.0);
    double *across = e->through, *force = e->terms;
    multiply_matrices(size, m, size, a->pushed, a->pairs, 0.0, across);
    for (int i = 0; i < size * size; i++) across[i] *= -(2.0 - sqrt(3.0)) / 12.0 * t * t * unit;
    for (int i = 0; i < size; i++) across[i * (size + 1)] += 1.0;
    multiply_matrices(size, size, m, across, a->pushed, 0.0, force);
    for (int k = 0; k < 2 * steps; k++, e->kicks += size)
        for (int j = 0; j < m; j++) {
            const double instant = 0.5 + (k % 2 ? gauss : -gauss);
            const swinging of = swing_of(e, j, e->since + t * (k / 2 + instant));
            const double back = 1.0 / (of.stay * of.rate + of.b * of.b * e->squares[j]);
            for (int i = 0; i < size; i++) {
                const long at = (long)(e->kicks + i) * 2 * m + j;
                const double own = a->pairs[j * size + i], pull = -0.5 * t * unit * force[i * m + j];
                e->kicked[at] = -back * of.b * own, e->kicked[at + m] = back * of.stay * own;
                e->pulled[at] = pull * of.stay, e->pulled[at + m] = pull * of.b;
            }
        }
    e->since += time;
}

void add_kicks(exponentials *e, double *product)
{
    const int size = 2 * e->modes, kicks = e->kicks;
    double *across = e->terms, *added = e->product, *columns = e->change;
    if (!kicks) return;
    multiply_matrices(kicks, size, size, e->pulled, product, 0.0, added);
    multiply_transposed(kicks, size, kicks, e->pulled, e->kicked, across);
    for (int i = 0; i < kicks; i++) {
        add_rows(i, size, added, across + (long)i * kicks, added + (long)i * size);
        for (int j = 0; j < size; j++) columns[j * kicks + i] = e->kicked[(long)i * size + j];
    }
    multiply_matrices(size, kicks, size, columns, added, 1.0, product);
    swing(e, e->since, product);
    e->kicks = 0, e->since = 0.0;
}

/* product = (I + change) product, of a product in which modes are still apart: of each row and column
 * of its blocks only the diagonal's number is not zero. */
static void multiply_apart(const exponentials *e, double *product)
{
    const long m = e->modes, size = 2 * m;
    double *q = e->product, *v = q + m, *by_rate = v + m, *rate = by_rate + m;
    for (long j = 0; j < m; j++) {
        q[j] = product[j * (size + 1)];
        by_rate[j] = product[j * (size + 1) + m];
        v[j] = product[(m + j) * (size + 1) - m];
        rate[j] = product[(m + j) * (size + 1)];
    }
    for (long i = 0; i < size; i++) {
        const double *restrict f = e->change + i * size;
        double *restrict row = product + i * size;
        for (long j = 0; j < m; j++) {
            row[j] += f[j] * q[j] + f[m + j] * v[j];
            row[m + j] += f[j] * by_rate[j] + f[m + j] * rate[j];
        }
    }
}

int multiply_exponential(exponentials *e, const closed_set *a, double length, int apart,
                         double *product)
{
    const int size = 2 * e->modes;
    const double time = e->unit * length, steps = ceil(time * (1.0 + e->rate) / MAX_KICK_ANGLE);
    const double kicks = 2.0 * steps * a->size;
    const int few = a->size && !e->coupled && kicks < e->modes;
    if (!few || e->kicks + kicks > e->modes) add_kicks(e, product);
    if (few) {
        kick(e, a, time, (int)steps);
        return 0;
    }
    if (!a->size && !e->coupled) {
        swing(e, time, product);
        return apart;
    }
    exponential_of(e, a, length);
    if (apart) {
        multiply_apart(e, product);
        return 0;
    }
    memcpy(e->product, product, bytes((long)size * size));
    multiply_matrices(size, size, size, e->change, e->product, 1.0, product);
    return 0;
}
