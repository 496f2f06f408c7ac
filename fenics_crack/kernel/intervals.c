#include "intervals.h"

#include <math.h>
#include <string.h>

#include "lapack.h"

/* Degree of the Taylor polynomials: 0.2^9 / 9! is 1e-12. Rows are answered as many at a time as a
 * polynomial has terms, those at the ends of as many cells as its degree. */
enum { DEGREE = 8, TERMS = DEGREE + 1 };

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
 * none, and where. Looked for in as many parts as a polynomial may have roots. */
static int first_event(int count, const double *polynomials, double begun, double *where)
{
    int first = -1;
    for (int part = 0; part < DEGREE && first < 0; part++) {
        const double low = begun + (1.0 - begun) * part / DEGREE;
        const double high = begun + (1.0 - begun) * (part + 1) / DEGREE;
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
    breathing_pairs *of;
    int count, since;         /* events; changes since rounding was looked for */
    int begin, end, next;     /* cells whose answers are known; none: end 0; how many come next */
    double *gaps, *answers;   /* s at the beginnings of all cells and at the last one's end, (cells +
                                 1, p), and X from `begin` on, (TERMS, p) */
    double *bends;            /* (p) and (p): bounds of s'' and X'', per cell squared */
    double *basis, *slopes;   /* (TERMS, 2H+1); (2, p) rates of X per cell at both ends of one */
    double *taylor, *candidates; /* (TERMS, p), (p, TERMS) */
    double *values, *room;    /* (TERMS, p) s; (TERMS, p) */
    double *answered;         /* (2H+1, p) X of the waves' gaps s_j where waves are fewer than pairs,
                                 behind `taylor`; else NULL */
    double *circle, *rows;    /* (cells) cosines and sines; (TERMS, 2H+1) waves */
    int *some;                /* (p) */
} interval_search;

/* X of all s_j, where they are carried along. */
static void answer_waves(interval_search *now)
{
    const breathing_pairs *m = now->of;
    if (now->answered) /* as many rows at a time as there is room for */
        for (int row = 0; row < m->n_waves; row += TERMS) {
            const int count = m->n_waves - row < TERMS ? m->n_waves - row : TERMS;
            const size_t first = (size_t)row * m->contact.pairs;
            transform_gaps(&m->contact, count, m->gaps + first, now->room, now->answered + first);
        }
}

/* Bounds of how much waves bend, per cell squared, from their coefficients (2H+1, p). */
static void bend(const breathing_pairs *m, const double *coefficients, double *bends)
{
    const int pairs = m->contact.pairs;
    memset(bends, 0, pairs * sizeof(double));
    for (int row = 1; row < m->n_waves; row++) {
        const double rate = TWO_PI / m->cells * ((row + 1) / 2);
        for (int i = 0; i < pairs; i++)
            bends[i] += rate * rate * fabs(coefficients[(long)row * pairs + i]);
    }
}

/* What answers where cells begin are found from: the answers to waves where these are fewer than
 * pairs; else all gaps there. */
static void begin(interval_search *now)
{
    const breathing_pairs *m = now->of;
    const int pairs = m->contact.pairs;
    answer_waves(now);
    if (now->answered) {
        for (int i = 0; i < m->cells; i++) {
            now->circle[2 * i] = cos(TWO_PI / m->cells * i);
            now->circle[2 * i + 1] = sin(TWO_PI / m->cells * i);
        }
        return;
    }
    waves_to_values(m->waves, pairs, m->gaps, now->gaps);
    memcpy(now->gaps + (size_t)m->cells * pairs, now->gaps, pairs * sizeof(double));
    bend(m, m->gaps, now->bends);
}

/* Answers (count, p) of combinations of the waves (count, 2H+1). */
static void answer(interval_search *now, int count, const double *waves, double *found)
{
    const breathing_pairs *m = now->of;
    const int pairs = m->contact.pairs;
    const double *coefficients = now->answered ? now->answered : m->gaps;
    double *combined = now->answered ? found : now->values;
    multiply_matrices(count, m->n_waves, pairs, waves, coefficients, 0.0, combined);
    if (!now->answered) transform_gaps(&m->contact, count, combined, now->room, found);
}

/* The waves where cells begin. */
static const double *waves_at(interval_search *now, int cell, int count)
{
    const breathing_pairs *m = now->of;
    for (int i = 0; i < count; i++) {
        double *row = now->rows + (long)i * m->n_waves;
        row[0] = 1.0;
        for (int k = 1; 2 * k < m->n_waves; k++) {
            const double *at = now->circle + 2 * ((long)k * (cell + i) % m->cells);
            row[2 * k - 1] = at[0], row[2 * k] = at[1];
        }
    }
    return now->rows;
}

/* The answers at both ends of a cell; those at its end stand behind the others. */
static const double *look(interval_search *now, int cell)
{
    const breathing_pairs *m = now->of;
    const int pairs = m->contact.pairs;
    if (cell < now->begin || cell >= now->end) {
        const int changed = !now->end;
        now->begin = cell;
        now->end = cell + now->next < m->cells ? cell + now->next : m->cells;
        if (2 * now->next <= DEGREE) now->next *= 2;
        const int count = now->end - cell + 1;
        if (now->answered) {
            if (changed) bend(m, now->answered, now->bends + pairs);
            answer(now, count, waves_at(now, cell, count), now->answers);
        } else {
            if (changed) bound_answers(&m->contact, now->bends, now->bends + pairs);
            transform_gaps(&m->contact, count, now->gaps + (size_t)cell * pairs, now->room,
                       now->answers);
        }
    }
    return now->answers + (size_t)(cell - now->begin) * pairs;
}

/* The set has changed. */
static void forget(interval_search *now) { now->end = 0, now->next = 1; }

/* Whether a pair with an answer is in its place: closed pairs press, others do not penetrate. */
static int right(const breathing_pairs *m, int i, double answer)
{
    return m->contact.closed[i] ? answer > 0.0 : !(answer > m->tolerance);
}

static int all_right(const breathing_pairs *m, const double *answers)
{
    for (int i = 0; i < m->contact.pairs; i++)
        if (!right(m, i, answers[i])) return 0;
    return 1;
}

/* Rates of the answers, per cell, at both ends of one. */
static void look_for_slopes(interval_search *now, int cell)
{
    const breathing_pairs *m = now->of;
    const int columns = m->n_waves;
    double *wave = now->basis;
    for (int end = 0; end < 2; end++, wave += columns) {
        wave[0] = 0.0;
        for (int k = 1; 2 * k < columns; k++) {
            const double rate = TWO_PI / m->cells * k, phase = rate * (cell + end);
            wave[2 * k - 1] = -rate * sin(phase), wave[2 * k] = rate * cos(phase);
        }
    }
    answer(now, 2, now->basis, now->slopes);
}

/* Whether two tangents at the ends of a cell meet on the wrong side of zero. An answer that keeps
 * its sign at both, and more distance from zero than it can bend, is not looked at. */
static int grazes(interval_search *now, int cell, const double *answers)
{
    const pivot_table *contact = &now->of->contact;
    const int pairs = contact->pairs;
    const double *slopes = now->slopes, *bends = now->bends + pairs;
    int known = 0;
    for (int i = 0; i < pairs; i++) {
        const double sign = contact->closed[i] ? 1.0 : -1.0;
        const double before = sign * answers[i], after = sign * answers[pairs + i];
        if (fmin(before, after) > 0.125 * bends[i]) continue;
        if (!known) look_for_slopes(now, cell);
        known = 1;
        const double fall = sign * slopes[i], rise = -sign * slopes[pairs + i];
        if (!(fall < 0.0 && rise < 0.0)) continue;
        if ((before * rise + after * fall + fall * rise) / (fall + rise) < 0.0) return 1;
    }
    return 0;
}

/* Opens or closes a pair; with it go `terms` rows of `taylor`, and what else is carried along. */
static int turn_and_carry(interval_search *now, int pair, int terms, double *v, double *gain)
{
    pivot_table *contact = &now->of->contact;
    double *first = now->taylor + (TERMS - terms) * contact->pairs;
    const int carried = now->answered ? now->of->n_waves : 0;
    const int failed = toggle_pair(contact, pair, terms + carried, first, v, gain);
    if (!failed) forget(now);
    return failed;
}

/* A pair opens or closes at a phase, with `terms` answers to be carried along. Returns 1 where that
 * cannot be done, -1 where there is no room for it. */
static int record(interval_search *now, int pair, double theta, int terms)
{
    breathing_pairs *m = now->of;
    if (now->count == m->max_events) return -1;
    const long at = now->count;
    double *v = m->vectors + at * m->contact.pairs;
    if (turn_and_carry(now, pair, terms, v, m->gains + at)) return 1;
    m->theta[at] = at ? fmax(m->theta[at - 1], theta) : theta;
    m->event_pairs[at] = pair;
    now->count++;
    now->since++;
    return 0;
}

/* Looks for rounding now and then. */
static void keep_sharp(interval_search *now)
{
    if (now->since < MAX_TRUSTED_PIVOTS) return;
    if (recompute_if_inaccurate(&now->of->contact)) answer_waves(now), forget(now);
    now->since = 0;
}

/* The set where a cell begins: pairs in the wrong place are turned, all of them, or where that goes
 * round the first alone (sets.h). Only behind phase zero is it recorded. Returns 0, -1 without room,
 * or -2 where that does not end. */
static int settle(interval_search *now, int cell, int recorded)
{
    breathing_pairs *m = now->of;
    const long pairs = m->contact.pairs;
    for (long turn = 0; turn < MAX_TRUSTED_PIVOTS + 20L * pairs * pairs; turn++) {
        int wrong = 0;
        keep_sharp(now);
        const double *answers = look(now, cell);
        for (int i = 0; i < pairs; i++) {
            if (right(m, i, answers[i]) || (wrong && turn >= MAX_TRUSTED_PIVOTS)) continue;
            const int failed = recorded ? record(now, i, cell * (TWO_PI / m->cells), 0)
                                        : turn_and_carry(now, i, 0, NULL, NULL);
            if (failed < 0) return -1;
            wrong |= !failed;
            now->since += !recorded;
        }
        if (!wrong) return 0;
    }
    return -2;
}

/* All events in a cell, in order. Returns 0, or -1 without room. */
static int search(interval_search *now, int cell)
{
    breathing_pairs *m = now->of;
    const int pairs = m->contact.pairs;
    const double width = TWO_PI / m->cells, middle = (cell + 0.5) * width;
    double begun = -1.0, place = 0.0;
    int last = -1;
    expand(m->n_waves / 2, middle, width, now->basis);
    answer(now, TERMS, now->basis, now->taylor);
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

int interval_cells(int harmonics, int pairs)
{
    const int waves = 16 * (harmonics + 1), least = 4 * pairs > waves ? 4 * pairs : waves;
    int cells = 16;
    while (cells < least) cells *= 2;
    return cells;
}

long interval_work_size(int pairs, int harmonics, int cells)
{
    const long columns = 2L * harmonics + 1;
    return pairs * (cells + 5L * TERMS + 6L + columns) + 2L * cells +
           columns * 2L * TERMS;
}

int find_intervals(breathing_pairs *m)
{
    const long pairs = m->contact.pairs;
    interval_search now = {.of = m, .next = 1, .gaps = m->work};
    now.answers = now.gaps + (m->cells + 1) * pairs;
    now.room = now.answers + TERMS * pairs;
    now.bends = now.room + TERMS * pairs;
    now.slopes = now.bends + 2 * pairs;
    now.taylor = now.slopes + 2 * pairs;
    now.answered = now.taylor + TERMS * pairs;
    now.values = now.answered + m->n_waves * pairs;
    now.candidates = now.values + TERMS * pairs;
    now.basis = now.candidates + TERMS * pairs;
    now.rows = now.basis + TERMS * m->n_waves;
    now.circle = now.rows + TERMS * m->n_waves;
    now.some = (int *)(now.circle + 2 * m->cells);
    if (m->n_waves >= pairs) now.answered = NULL;
    open_all_pairs(&m->contact);
    begin(&now);
    if (settle(&now, 0, 0)) return -2;
    get_inverse(&m->contact, m->stiffness);
    memcpy(m->first_set, m->contact.closed, pairs);
    for (int cell = 0; cell < m->cells; cell++) {
        const double *answers = look(&now, cell);
        if (all_right(m, answers + pairs) && !grazes(&now, cell, answers)) continue;
        if (search(&now, cell)) return -1;
        keep_sharp(&now);
        if (cell + 1 == m->cells) break;
        const int failed = settle(&now, cell + 1, 1);
        if (failed) return failed;
    }
    return now.count;
}
