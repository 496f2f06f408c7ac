#include "intervals.h"

#include <math.h>
#include <string.h>

#include "lapack.h"

/* Degree of the Taylor polynomials: 0.2^9 / 9! is 1e-12. Points of a bracket's search. Turns of all
 * wrong pairs together; after how many events rounding is looked for. */
enum { DEGREE = 8, TERMS = DEGREE + 1, POINTS = 6, TOGETHER = 30, OFTEN = 32 };
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

/* The polynomials (TERMS, p) whose sign in [-1, 1] may be wrong: of the pairs `some`, as (TERMS)
 * numbers that are positive while the set is right. Returns how many. */
static int candidates(const pivot_table *contact, const double *taylor, int *some, double *polynomials)
{
    const int pairs = contact->pairs;
    int count = 0;
    for (int i = 0; i < pairs; i++) {
        const double sign = contact->closed[i] ? 1.0 : -1.0;
        double others = 0.0;
        for (int d = 1; d <= DEGREE; d++) others += fabs(taylor[(long)d * pairs + i]);
        if (sign * taylor[i] > others) continue;
        for (int d = 0; d <= DEGREE; d++)
            polynomials[(long)count * TERMS + d] = sign * taylor[(long)d * pairs + i];
        some[count++] = i;
    }
    return count;
}

/* The first event behind `begun` in a cell: its place among `count` polynomials, -1 if there is
 * none, and where. */
static int first_event(int count, const double *polynomials, double begun, double *where)
{
    int first = -1;
    for (int part = 0; part < POINTS && first < 0; part++) {
        const double low = begun + (1.0 - begun) * part / POINTS;
        const double high = begun + (1.0 - begun) * (part + 1) / POINTS;
        for (int i = 0; i < count; i++) {
            const double *c = polynomials + (long)i * TERMS;
            const double end = negative_in(c, low, high);
            if (isnan(end)) continue;
            const double root = root_of(c, DEGREE, low, end);
            if (first >= 0 && root >= *where) continue;
            first = i;
            *where = root;
        }
    }
    return first;
}

/* Taylor coefficients (TERMS, 2H+1) of 1, cos(k theta), sin(k theta), in x = 2 (theta - middle) /
 * width. */
static void expand(int harmonics, double middle, double width, double *taylor)
{
    const long columns = 2L * harmonics + 1;
    for (long d = 0; d <= DEGREE; d++) taylor[d * columns] = d == 0;
    for (int k = 1; k <= harmonics; k++) {
        double real = cos(k * middle), imaginary = sin(k * middle);
        for (long d = 0; d <= DEGREE; d++) {
            taylor[d * columns + 2 * k - 1] = real;
            taylor[d * columns + 2 * k] = imaginary;
            /* exp(i k theta) times (i k width / 2) / (d + 1) */
            const double rate = 0.5 * width * k / (d + 1), turned = -rate * imaginary;
            imaginary = rate * real;
            real = turned;
        }
    }
}

/* What is known while a motion is followed. */
typedef struct {
    breathing *of;
    int count, since;                    /* events; changes since rounding was looked for */
    double *waves;                       /* (2, 2H+1) at a cell's end, and their change per cell */
    double *values, *rates;              /* (2, p) of the answer there */
    double *basis, *taylor, *candidates; /* (TERMS, 2H+1), (TERMS, p), (p, TERMS) */
    int *some;                           /* (p) */
    double *values_before, *rates_before;
} walk;

/* y (rows, p) = w (rows, c) X */
static void combine(const pivot_table *contact, int rows, const double *w, double *y)
{
    multiply_matrices(rows, contact->columns, contact->pairs, w, contact->answer, 0.0, y);
}

/* Values and rates, those per cell, at an end of a cell. */
static void look(walk *now, int instant)
{
    const breathing *m = now->of;
    const int columns = m->contact.columns;
    double *wave = now->waves, *slope = wave + columns;
    wave[0] = 1.0, slope[0] = 0.0;
    for (int k = 1; 2 * k < columns; k++) {
        const double *at = m->circle + 2 * ((long)k * instant % m->cells); /* k theta */
        wave[2 * k - 1] = at[0], wave[2 * k] = at[1];
        const double rate = TWO_PI / m->cells * k;
        slope[2 * k - 1] = -rate * wave[2 * k];
        slope[2 * k] = rate * wave[2 * k - 1];
    }
    combine(&m->contact, 2, wave, now->values);
}

/* Whether a pair is in its place: closed pairs press, others do not penetrate. */
static int right(const walk *now, int i)
{
    const breathing *m = now->of;
    return m->contact.closed[i] ? now->values[i] > 0.0 : !(now->values[i] > m->allowed);
}

static int all_right(const walk *now)
{
    for (int i = 0; i < now->of->contact.pairs; i++)
        if (!right(now, i)) return 0;
    return 1;
}

/* Whether two tangents at the ends of a cell meet on the wrong side of zero. */
static int grazes(const walk *now)
{
    const pivot_table *contact = &now->of->contact;
    for (int i = 0; i < contact->pairs; i++) {
        const double sign = contact->closed[i] ? 1.0 : -1.0;
        const double fall = sign * now->rates_before[i], rise = -sign * now->rates[i];
        if (!(fall < 0.0 && rise < 0.0)) continue;
        const double before = sign * now->values_before[i], after = sign * now->values[i];
        if ((before * rise + after * fall + fall * rise) / (fall + rise) < 0.0) return 1;
    }
    return 0;
}

/* A pair opens or closes at a phase, with `terms` answers to be carried along. Returns 1 where that
 * cannot be done, -1 where there is no room for it. */
static int record(walk *now, int pair, double theta, int terms)
{
    breathing *m = now->of;
    if (now->count == m->most) return -1;
    const long at = now->count;
    double *v = m->vectors + at * m->contact.pairs;
    if (turn_pair(&m->contact, pair, terms, now->taylor, v, m->gain + at)) return 1;
    m->theta[at] = at ? fmax(m->theta[at - 1], theta) : theta;
    m->pair[at] = pair;
    now->count++;
    now->since++;
    return 0;
}

/* Looks for rounding now and then. */
static void keep_sharp(walk *now)
{
    if (now->since < OFTEN) return;
    refresh(&now->of->contact);
    now->since = 0;
}

/* The set at an instant: pairs in the wrong place are turned, all of them, or where that goes round
 * the first alone (sets.h). Only behind phase zero is it recorded. Returns 0, -1 without room, or -2
 * where that does not end. */
static int settle(walk *now, int instant, int recorded)
{
    breathing *m = now->of;
    const long pairs = m->contact.pairs;
    for (long turn = 0; turn < TOGETHER + 20L * pairs * pairs; turn++) {
        int wrong = 0;
        keep_sharp(now);
        look(now, instant);
        for (int i = 0; i < pairs; i++) {
            if (right(now, i) || (wrong && turn >= TOGETHER)) continue;
            const int failed = recorded ? record(now, i, instant * (TWO_PI / m->cells), 0)
                                        : turn_pair(&m->contact, i, 0, NULL, NULL, NULL);
            if (failed < 0) return -1;
            wrong |= !failed;
            now->since += !recorded;
        }
        if (!wrong) return 0;
    }
    return -2;
}

/* All events in a cell, in order. Returns 0, or -1 without room. */
static int search(walk *now, int cell)
{
    breathing *m = now->of;
    const int pairs = m->contact.pairs;
    const double width = TWO_PI / m->cells, middle = (cell + 0.5) * width;
    double begun = -1.0, place;
    int last = -1;
    expand(m->contact.columns / 2, middle, width, now->basis);
    combine(&m->contact, TERMS, now->basis, now->taylor);
    for (int turn = 0; turn < 4 * pairs + 8; turn++) {
        const int count = candidates(&m->contact, now->taylor, now->some, now->candidates);
        for (int i = 0; i < count && last >= 0; i++)
            if (now->some[i] == last) without_root(now->candidates + (long)i * TERMS, begun);
        const int first = first_event(count, now->candidates, begun, &place);
        if (first < 0) break;
        const int failed = record(now, now->some[first], middle + 0.5 * width * place, TERMS);
        if (failed < 0) return -1;
        if (failed) break;
        begun = place;
        last = now->some[first];
    }
    return 0;
}

long intervals_room(int pairs, int harmonics)
{
    return pairs * (2L * TERMS + 5L) + (2L * harmonics + 1) * (TERMS + 2L);
}

int intervals(breathing *m)
{
    const long pairs = m->contact.pairs, columns = m->contact.columns;
    walk now = {m, 0, 0};
    now.values = m->work;
    now.rates = now.values + pairs;
    now.values_before = now.rates + pairs;
    now.rates_before = now.values_before + pairs;
    now.taylor = now.rates_before + pairs;
    now.candidates = now.taylor + pairs * TERMS;
    now.waves = now.candidates + pairs * TERMS;
    now.basis = now.waves + 2 * columns;
    now.some = (int *)(now.basis + columns * TERMS);
    open_all(&m->contact);
    if (settle(&now, 0, 0)) return -2;
    inverse_of(&m->contact, m->stiffness);
    memcpy(m->first, m->contact.closed, pairs);
    for (int cell = 0; cell < m->cells; cell++) {
        const int next = (cell + 1) % m->cells;
        memcpy(now.values_before, now.values, pairs * sizeof(double));
        memcpy(now.rates_before, now.rates, pairs * sizeof(double));
        look(&now, next);
        if (all_right(&now) && !grazes(&now)) continue;
        if (search(&now, cell)) return -1;
        keep_sharp(&now);
        if (!next) break;
        const int failed = settle(&now, next, 1);
        if (failed) return failed;
    }
    return now.count;
}
