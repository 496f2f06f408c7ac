#include "intervals.h"

#include <math.h>
#include <string.h>

#include "lapack.h"

/* Degree of the Taylor polynomials: 0.2^9 / 9! is 1e-12. Points of a bracket's search. */
enum { DEGREE = 8, TERMS = DEGREE + 1, POINTS = 6 };
static const double TWO_PI = 6.283185307179586476925;

static double value_at(const double *c, int degree, double x)
{
    double sum = c[degree];
    for (int d = degree - 1; d >= 0; d--) sum = sum * x + c[d];
    return sum;
}

/* A root in [low, high], at whose end the polynomial is negative; `low` where it is negative there
 * already. Newton's method, kept in a bracket by bisection. */
static double root_of(const double *c, int degree, double low, double high)
{
    double slopes[DEGREE];
    for (int d = 1; d <= degree; d++) slopes[d - 1] = d * c[d];
    const double first = value_at(c, degree, low), last = value_at(c, degree, high);
    if (first <= 0.0) return low;
    double root = low + (high - low) * first / (first - last);
    for (int turn = 0; turn < 60; turn++) {
        const double now = value_at(c, degree, root);
        if (now > 0.0) low = root; else high = root;
        const double newton = root - now / value_at(slopes, degree - 1, root);
        const double moved = newton >= low && newton <= high ? newton : 0.5 * (low + high);
        const int done = fabs(moved - root) <= 1e-13;
        root = moved;
        if (done) break;
    }
    return root;
}

/* c / (x - root): behind its root the polynomial keeps its sign. Where it does not grow there, what
 * comes next is left to the set at the cell's end: 1. */
static void without_root(double *c, double root)
{
    double found[TERMS] = {0.0};
    for (int d = DEGREE; d > 0; d--) found[d - 1] = c[d] + root * (d < DEGREE ? found[d] : 0.0);
    if (value_at(found, DEGREE, root) <= 0.0) {
        memset(found, 0, sizeof found);
        found[0] = 1.0;
    }
    memcpy(c, found, sizeof found);
}

/* The end of a bracket in which a polynomial becomes negative between two places: the later one, or
 * a minimum between them; NAN where it does not. */
static double negative_in(const double *c, double low, double high)
{
    double slopes[DEGREE], rising[DEGREE];
    const double first = value_at(c, DEGREE, low), last = value_at(c, DEGREE, high);
    if (last < 0.0) return high;
    for (int d = 1; d <= DEGREE; d++) slopes[d - 1] = d * c[d];
    const double fall = (high - low) * value_at(slopes, DEGREE - 1, low);
    const double rise = (high - low) * value_at(slopes, DEGREE - 1, high);
    if (!(fall < 0.0 && rise > 0.0)) return NAN;
    /* Tangents at both ends meet below zero. */
    if (!((first * rise - fall * last + fall * rise) / (rise - fall) < 0.0)) return NAN;
    for (int d = 0; d < DEGREE; d++) rising[d] = -slopes[d];
    const double bottom = root_of(rising, DEGREE - 1, low, high);
    return value_at(c, DEGREE, bottom) < 0.0 ? bottom : NAN;
}

/* The pair whose event comes first behind `begun` in a cell, -1 if there is none, and where;
 * polynomials: (p, TERMS). */
static int first_event(int pairs, const double *polynomials, double begun, double *where)
{
    int pair = -1;
    for (int part = 0; part < POINTS && pair < 0; part++) {
        const double low = begun + (1.0 - begun) * part / POINTS;
        const double high = begun + (1.0 - begun) * (part + 1) / POINTS;
        for (int i = 0; i < pairs; i++) {
            const double *c = polynomials + i * TERMS;
            const double end = negative_in(c, low, high);
            if (isnan(end)) continue;
            const double root = root_of(c, DEGREE, low, end);
            if (pair >= 0 && root >= *where) continue;
            pair = i;
            *where = root;
        }
    }
    return pair;
}

/* Taylor coefficients (p, TERMS) in x = 2 (theta - middle) / width. */
static void expand(int pairs, int highest, const double *harmonics, double middle, double width,
                   double *taylor)
{
    memset(taylor, 0, (size_t)pairs * TERMS * sizeof(double));
    for (int k = 0; k <= highest; k++) {
        double real = cos(k * middle), imaginary = sin(k * middle);
        for (int d = 0; d <= DEGREE; d++) {
            const double *wave = harmonics + 2L * k * pairs;
            for (int i = 0; i < pairs; i++)
                taylor[i * TERMS + d] += real * wave[2 * i] - imaginary * wave[2 * i + 1];
            /* times (i k width / 2) / (d + 1) */
            const double rate = 0.5 * width * k / (d + 1), turned = -rate * imaginary;
            imaginary = rate * real;
            real = turned;
        }
    }
}

/* Forces and openings (p) of an instant's set, and their rates. */
static int margins(sets *contact, int pairs, const signed char *closed, const double *values,
                   const double *rates, double *margin, double *rate)
{
    const double *answer = answer_of(contact, closed);
    if (!answer) return 1;
    multiply(pairs, pairs, answer, values, margin);
    multiply(pairs, pairs, answer, rates, rate);
    return 0;
}

static int grazes(int pairs, const double *margin, const double *rate, const double *after,
                  const double *after_rate)
{
    for (int i = 0; i < pairs; i++) {
        const double fall = rate[i], rise = -after_rate[i];
        if (!(fall < 0.0 && rise < 0.0)) continue;
        if ((margin[i] * rise + after[i] * fall + fall * rise) / (fall + rise) < 0.0) return 1;
    }
    return 0;
}

long intervals_room(int pairs)
{
    return pairs * (2L * TERMS + 8L) + 8L;
}

int intervals(sets *contact, int pairs, int highest, int cells, const double *harmonics,
              const double *values, const double *rates, double allowed, int most, double *theta,
              signed char *closed, double *work)
{
    const double width = TWO_PI / cells;
    double *margin = work, *rate = margin + pairs, *after = rate + pairs,
           *after_rate = after + pairs, *force = after_rate + pairs, *taylor = force + pairs,
           *polynomials = taylor + (long)pairs * TERMS;
    signed char *here = (signed char *)(polynomials + (long)pairs * TERMS), *there = here + pairs,
                *at_first = there + pairs;
    for (int i = 0; i < pairs; i++) here[i] = values[i] > 0.0;
    if (forces_at(contact, values, allowed, NULL, here, force)) return -2;
    memcpy(at_first, here, pairs);
    int count = 1;
    theta[0] = 0.0;
    memcpy(closed, here, pairs);
    if (margins(contact, pairs, here, values, rates, margin, rate)) return -2;
    for (int cell = 0; cell < cells; cell++) {
        const int next = (cell + 1) % cells;
        memcpy(there, next ? here : at_first, pairs);
        if (next && forces_at(contact, values + (long)next * pairs, allowed, NULL, there, force))
            return -2;
        if (margins(contact, pairs, there, values + (long)next * pairs, rates + (long)next * pairs,
                    after, after_rate))
            return -2;
        if (memcmp(here, there, pairs) ||
            grazes(pairs, margin, rate, after, after_rate)) {
            const double middle = (cell + 0.5) * width;
            signed char *set = closed + (long)(count - 1) * pairs;
            double begun = -1.0;
            int last = -1;
            expand(pairs, highest, harmonics, middle, width, taylor);
            for (int turn = 0; turn < 4 * pairs + 8; turn++) {
                const double *answer = answer_of(contact, set);
                double place;
                if (!answer) return -2;
                multiply_matrices(pairs, pairs, TERMS, answer, taylor, 0.0, polynomials);
                if (last >= 0) without_root(polynomials + last * TERMS, begun);
                const int pair = first_event(pairs, polynomials, begun, &place);
                if (pair < 0) break;
                if (count == most) return -1;
                memcpy(set + pairs, set, pairs);
                set += pairs;
                set[pair] = !set[pair];
                theta[count] = fmax(theta[count - 1], middle + 0.5 * width * place);
                count++;
                begun = place;
                last = pair;
            }
            if (memcmp(set, there, pairs)) {
                if (count == most) return -1;
                memcpy(set + pairs, there, pairs);
                theta[count] = (cell + 1) * width;
                count++;
            }
        }
        memcpy(here, there, pairs);
        memcpy(margin, after, pairs * sizeof(double));
        memcpy(rate, after_rate, pairs * sizeof(double));
    }
    return count;
}
