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
    double unit, max_damping_rate; /* max_damping_rate: bound of the damping's row sums */
    double *squares;   /* (m) */
    double *damping;   /* (m) or (m, m) C */
    const closed_set *set;
    double *stiffness; /* (m, m) K */
    double *pair_product;   /* (m, m) product with the few pairs of a set; H */
    double *series_terms;   /* (3, m, m) of b's series */
    double *upper_blocks;   /* (2, m, m) D + b C and -b K */
    double *right_blocks;   /* (2, m, m) b and D */
    double *doubled_blocks; /* (2, m, m) right_blocks at twice the time */
    double *change;    /* (2 m, 2 m) F */
    double *product;   /* (2 m, 2 m) */
    int n_kicks;       /* kicks that wait, for a product that must swing for */
    double swing_time; /* swing_time */
    double *kick_columns,
        *kick_rows; /* (kicks, 2 m) E(-s) [0; P], transposed, and the rows of E(s) */
};

/* Largest angle of the fastest mode in a step by kicks; the error is then 1e-14. */
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
    e->pair_product = e->stiffness + square;
    e->series_terms = e->pair_product + square;
    e->upper_blocks = e->series_terms + 3 * square;
    e->right_blocks = e->upper_blocks + 2 * square;
    e->doubled_blocks = e->right_blocks + 2 * square;
    e->change = e->doubled_blocks + 2 * square;
    e->product = e->change + 4 * square;
    e->kick_columns = e->product + 4 * square;
    e->kick_rows = e->kick_columns + 2 * square;
    for (long i = 0; i < m; i++) e->squares[i] = squares[i] / (unit * unit);
    for (long i = 0; i < damped; i++) e->damping[i] = damping[i] / unit;
    for (long i = 0; i < m; i++) {
        double sum = 0.0;
        for (long j = 0; j < damped / m; j++) sum += fabs(e->damping[i * (damped / m) + j]);
        e->max_damping_rate = fmax(e->max_damping_rate, sum);
    }
    return e;
}

void free_exponentials(exponentials *e)
{
    free(e->squares);
    free(e);
}

/* sum += b C. */
static void add_damping_product(const exponentials *e, const double *b, double *sum)
{
    const int m = e->modes;
    if (e->coupled) {
        multiply_matrices(m, m, m, b, e->damping, 1.0, sum);
        return;
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) sum[i * m + j] += b[i * m + j] * e->damping[j];
}

/* Return whether K is a diagonal and products of few rows and columns. */
static int has_few_pairs(const exponentials *e) { return !e->set->stiffness; }

/* Set K x. */
static void multiply_stiffness(const exponentials *e, const double *x, double *product_out)
{
    const int m = e->modes, n_closed = e->set->size;
    if (!has_few_pairs(e)) {
        multiply_matrices(m, m, m, e->stiffness, x, 0.0, product_out);
        return;
    }
    multiply_matrices(n_closed, m, m, e->set->modal_push, x, 0.0, e->pair_product);
    multiply_matrices(m, n_closed, m, e->set->mode_columns, e->pair_product, 0.0, product_out);
    const double unit = 1.0 / (e->unit * e->unit);
    for (int i = 0; i < m; i++)
        for (long j = (long)i * m; j < (long)(i + 1) * m; j++)
            product_out[j] = unit * product_out[j] + e->squares[i] * x[j];
}

/* Set the term after the next: new = -(K term t / (n + 1) + C next) t / (n + 2). */
WIDE static void set_next_term(const exponentials *e, int n, double time, const double *term,
                               const double *next_term, double *new_term)
{
    const int m = e->modes;
    const long square = (long)m * m;
    const double gain = -time * time / ((n + 1) * (n + 2)), loss = -time / (n + 2);
    if (n > 1) multiply_stiffness(e, term, new_term);
    else /* of b_0 = 0 and b_1 = time I */
        for (long i = 0; i < square; i++) new_term[i] = n * time * e->stiffness[i];
    if (e->coupled) {
        multiply_matrices(m, m, m, e->damping, next_term, gain / loss, new_term);
        for (long i = 0; i < square; i++) new_term[i] *= loss;
        return;
    }
    for (int i = 0; i < m; i++) {
        const double rate = loss * e->damping[i];
        for (long j = (long)i * m; j < (long)(i + 1) * m; j++)
            new_term[j] = gain * new_term[j] + rate * next_term[j];
    }
}

/* Set right_blocks = [b; D] of a short time, in which the fastest mode turns by an angle. */
WIDE static void expand_short_time(exponentials *e, double time, double angle)
{
    const int m = e->modes;
    const long square = (long)m * m;
    double *term = e->series_terms, *next_term = term + square, *new_term = next_term + square;
    double *b = e->right_blocks, *d = b + square, term_size = angle;
    memset(term, 0, bytes(2 * square));
    memset(b, 0, bytes(2 * square));
    for (int i = 0; i < m; i++) next_term[(long)i * (m + 1)] = b[(long)i * (m + 1)] = time;
    for (int n = 0; term_size > DBL_EPSILON; n++, term_size *= angle / (n + 1)) {
        double *old_term = term;
        set_next_term(e, n, time, term, next_term, new_term);
        for (long i = 0; i < square; i++) {
            b[i] += new_term[i];
            d[i] += (n + 2) / time * new_term[i];
        }
        term = next_term;
        next_term = new_term;
        new_term = old_term;
    }
}

/* Return b, transposed if the modes are coupled: only a symmetric C makes b symmetric. */
static const double *transpose_if_coupled(const exponentials *e, const double *b,
                                          double *transpose_out)
{
    const long m = e->modes;
    if (!e->coupled) return b;
    for (long i = 0; i < m; i++)
        for (long j = 0; j < m; j++) transpose_out[j * m + i] = b[i * m + j];
    return transpose_out;
}

/* Set upper_blocks = [D + b C; -b K] from right_blocks = [b; D]. b K is K b^T, transposed, because
 * b'' + b' C + b K = 0 as well. */
WIDE static void complete_blocks(exponentials *e)
{
    const int m = e->modes;
    const long square = (long)m * m;
    memcpy(e->upper_blocks, e->right_blocks + square, bytes(square));
    add_damping_product(e, e->right_blocks, e->upper_blocks);
    multiply_stiffness(e, transpose_if_coupled(e, e->right_blocks, e->doubled_blocks + square),
                       e->doubled_blocks);
    for (long i = 0; i < m; i++)
        for (long j = 0; j < m; j++)
            e->upper_blocks[square + i * m + j] = -e->doubled_blocks[j * m + i];
}

/* Set K of a set. Return its largest row sum. */
static double set_stiffness(exponentials *e, const closed_set *a)
{
    const int m = e->modes;
    double *k = e->stiffness, largest = 0.0;
    e->set = a;
    if (a->stiffness) memcpy(k, a->stiffness, bytes((long)m * m));
    else multiply_matrices(m, a->size, m, a->mode_columns, a->modal_push, 0.0, k);
    for (int i = 0; i < m; i++) {
        double sum = 0.0;
        for (int j = 0; j < m; j++) k[(long)i * m + j] /= e->unit * e->unit;
        k[(long)i * (m + 1)] += e->squares[i];
        for (int j = 0; j < m; j++) sum += fabs(k[(long)i * m + j]);
        largest = fmax(largest, sum);
    }
    return largest;
}

/* Set [b; D] of twice the time from [b; D]. If damping does not couple the modes, b and D are
 * symmetric; then (D + b C) b + b D is H b and its transpose, with H = D + b C / 2. */
WIDE static void double_time(exponentials *e, const double *right, double *doubled)
{
    const int m = e->modes;
    const long square = (long)m * m;
    const double *d = right + square;
    for (long i = 0; i < 2 * square; i++) doubled[i] = 2.0 * right[i];
    if (e->coupled) {
        multiply_matrices(m, m, m, e->upper_blocks, right, 1.0, doubled);
        multiply_matrices(m, m, m, right, d, 1.0, doubled);
    } else {
        for (long i = 0; i < square; i++) e->pair_product[i] = 0.5 * (d[i] + e->upper_blocks[i]);
        multiply_matrices(m, m, m, e->pair_product, right, 0.0, e->product);
        for (long i = 0; i < m; i++)
            for (long j = 0; j < m; j++)
                doubled[i * m + j] += e->product[i * m + j] + e->product[j * m + i];
    }
    multiply_matrices(m, m, m, e->upper_blocks + square, right, 1.0, doubled + square);
    multiply_matrices(m, m, m, d, d, 1.0, doubled + square);
}

/* Set change = F of an interval. */
static void set_exponential(exponentials *e, const closed_set *a, double length)
{
    const int m = e->modes;
    /* No set is faster than the unit. */
    const double rate = e->max_damping_rate + fmin(1.0, sqrt(set_stiffness(e, a)));
    double time = e->unit * length;
    int n_halvings = 0;
    for (; time * rate > 3.0; n_halvings++)
        time *= 0.5; /* within the series it turns by 3 at most */
    expand_short_time(e, time, time * rate);
    complete_blocks(e);
    for (; n_halvings; n_halvings--) {
        double *right = e->right_blocks, *doubled = e->doubled_blocks;
        double_time(e, right, doubled);
        e->right_blocks = doubled;
        e->doubled_blocks = right;
        complete_blocks(e);
    }
    for (long i = 0; i < 2L * m; i++) {
        memcpy(e->change + i * 2 * m, e->upper_blocks + i * m, bytes(m));
        memcpy(e->change + i * 2 * m + m, e->right_blocks + i * m, bytes(m));
    }
}

/* Free swing of one mode, b'' + c b' + k b = 0 with b(0) = 0, b'(0) = 1: b, its rate, and the
 * displacement after a start from 1 at rest. */
typedef struct {
    double b, rate, displacement;
} swing_motion;

static swing_motion mode_swing(const exponentials *e, int mode, double time)
{
    const double c = e->damping[mode], k = e->squares[mode];
    const double square = k - 0.25 * c * c, w = sqrt(fabs(square));
    const double decay = exp((square > 0.0 ? -0.5 * c : w - 0.5 * c) * time);
    swing_motion swing = {decay * time, decay, 0.0};
    if (square > 0.0) {
        swing.b = decay * sin(w * time) / w;
        swing.rate *= cos(w * time);
    } else if (w > 0.0) {
        const double decay_change = expm1(-2.0 * w * time);
        swing.b = -decay * decay_change / (2.0 * w);
        swing.rate *= 1.0 + 0.5 * decay_change;
    }
    swing.rate -= 0.5 * c * swing.b;
    swing.displacement = swing.rate + c * swing.b;
    return swing;
}

/* Multiply by the exponential of the set without closed pairs. */
WIDE static void apply_swing(const exponentials *e, double time, double *product)
{
    const int m = e->modes;
    for (int i = 0; i < m; i++) {
        const swing_motion swing = mode_swing(e, i, time);
        const double velocity_factor = -swing.b * e->squares[i];
        double *restrict q = product + (long)i * 2 * m, *restrict v = q + 2L * m * m;
        for (int j = 0; j < 2 * m; j++) {
            const double displacement = q[j];
            q[j] = swing.displacement * displacement + swing.b * v[j];
            v[j] = swing.rate * v[j] + velocity_factor * displacement;
        }
    }
}

/* Append the kicks of a set in a number of steps. */
static void append_kicks(exponentials *e, const closed_set *a, double time, int steps)
{
    const int m = e->modes, size = a->size;
    const double unit = 1.0 / (e->unit * e->unit), t = time / steps, gauss = 0.5 / sqrt(3.0);
    double *set_matrix = e->pair_product, *force = e->series_terms;
    multiply_matrices(size, m, size, a->modal_push, a->mode_columns, 0.0, set_matrix);
    for (int i = 0; i < size * size; i++) set_matrix[i] *= -(2.0 - sqrt(3.0)) / 12.0 * t * t * unit;
    for (int i = 0; i < size; i++) set_matrix[i * (size + 1)] += 1.0;
    multiply_matrices(size, size, m, set_matrix, a->modal_push, 0.0, force);
    for (int k = 0; k < 2 * steps; k++, e->n_kicks += size)
        for (int j = 0; j < m; j++) {
            const double fraction = 0.5 + (k % 2 ? gauss : -gauss);
            const swing_motion swing = mode_swing(e, j, e->swing_time + t * (k / 2 + fraction));
            const double inverse_determinant =
                1.0 / (swing.displacement * swing.rate + swing.b * swing.b * e->squares[j]);
            for (int i = 0; i < size; i++) {
                const long index = (long)(e->n_kicks + i) * 2 * m + j;
                const double mode_column = a->mode_columns[j * size + i],
                             pull = -0.5 * t * unit * force[i * m + j];
                e->kick_columns[index] = -inverse_determinant * swing.b * mode_column,
                e->kick_columns[index + m] = inverse_determinant * swing.displacement * mode_column;
                e->kick_rows[index] = pull * swing.displacement,
                e->kick_rows[index + m] = pull * swing.b;
            }
        }
    e->swing_time += time;
}

void add_kicks(exponentials *e, double *product)
{
    const int size = 2 * e->modes, kicks = e->n_kicks;
    double *kick_product = e->series_terms, *kick_changes = e->product, *columns = e->change;
    if (!kicks) return;
    multiply_matrices(kicks, size, size, e->kick_rows, product, 0.0, kick_changes);
    multiply_transposed(kicks, size, kicks, e->kick_rows, e->kick_columns, kick_product);
    for (int i = 0; i < kicks; i++) {
        add_rows(i, size, kick_changes, kick_product + (long)i * kicks,
                 kick_changes + (long)i * size);
        for (int j = 0; j < size; j++) columns[j * kicks + i] = e->kick_columns[(long)i * size + j];
    }
    multiply_matrices(size, kicks, size, columns, kick_changes, 1.0, product);
    apply_swing(e, e->swing_time, product);
    e->n_kicks = 0, e->swing_time = 0.0;
}

/* Set product = (I + change) product. The modes in the product are still apart: its blocks are
 * diagonal. */
static void multiply_diagonal_blocks(const exponentials *e, double *product)
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

int multiply_exponential(exponentials *e, const closed_set *a, double length, int are_modes_apart,
                         double *product)
{
    const int size = 2 * e->modes;
    const double time = e->unit * length,
                 steps = ceil(time * (1.0 + e->max_damping_rate) / MAX_KICK_ANGLE);
    const double n_new_kicks = 2.0 * steps * a->size;
    const int uses_kicks = a->size && !e->coupled && n_new_kicks < e->modes;
    if (!uses_kicks || e->n_kicks + n_new_kicks > e->modes) add_kicks(e, product);
    if (uses_kicks) {
        append_kicks(e, a, time, (int)steps);
        return 0;
    }
    if (!a->size && !e->coupled) {
        apply_swing(e, time, product);
        return are_modes_apart;
    }
    set_exponential(e, a, length);
    if (are_modes_apart) {
        multiply_diagonal_blocks(e, product);
        return 0;
    }
    memcpy(e->product, product, bytes((long)size * size));
    multiply_matrices(size, size, size, e->change, e->product, 1.0, product);
    return 0;
}
