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

/* Return a root in [low, high], at whose end the polynomial is negative; `low` if it is negative
 * there already. Newton's method, kept in a bracket by bisection. */
static double polynomial_root(const double *c, int degree, double low, double high)
{
    double slopes[DEGREE];
    for (int d = 1; d <= degree; d++) slopes[d - 1] = d * c[d];
    const double first = value_at(c, degree, low), last = value_at(c, degree, high);
    if (first <= 0.0) return low;
    double root = low + (high - low) * first / (first - last);
    for (int iteration = 0; iteration < 60; iteration++) {
        const double search = value_at(c, degree, root);
        if (search > 0.0) low = root;
        else high = root;
        const double newton = root - search / value_at(slopes, degree - 1, root);
        const double updated = newton >= low && newton <= high ? newton : 0.5 * (low + high);
        const int has_converged = fabs(updated - root) <= 1e-13;
        root = updated;
        if (has_converged) break;
    }
    return root;
}

/* Divide by (x - root): after its root the polynomial keeps its sign. If the quotient is not
 * positive at the root, set it to 1; the set at the cell's end shows what comes next. */
static void divide_by_root(double *c, double root)
{
    double quotient[TERMS] = {0.0};
    for (int d = DEGREE; d > 0; d--)
        quotient[d - 1] = c[d] + root * (d < DEGREE ? quotient[d] : 0.0);
    if (value_at(quotient, DEGREE, root) <= 0.0) {
        memset(quotient, 0, sizeof quotient);
        quotient[0] = 1.0;
    }
    memcpy(c, quotient, sizeof quotient);
}

/* Return the end of a bracket in which a polynomial becomes negative: the later point, or a minimum
 * between the two; NAN if it does not become negative. */
static double negative_end(const double *c, double low, double high)
{
    double slopes[DEGREE], negative_slopes[DEGREE];
    const double first = value_at(c, DEGREE, low), last = value_at(c, DEGREE, high);
    if (last < 0.0) return high;
    for (int d = 1; d <= DEGREE; d++) slopes[d - 1] = d * c[d];
    const double first_rate = (high - low) * value_at(slopes, DEGREE - 1, low);
    const double last_rate = (high - low) * value_at(slopes, DEGREE - 1, high);
    if (!(first_rate < 0.0 && last_rate > 0.0)) return NAN;
    /* Tangents at both ends meet below zero. */
    if (!((first * last_rate - first_rate * last + first_rate * last_rate) /
              (last_rate - first_rate) <
          0.0))
        return NAN;
    for (int d = 0; d < DEGREE; d++) negative_slopes[d] = -slopes[d];
    const double bottom = polynomial_root(negative_slopes, DEGREE - 1, low, high);
    return value_at(c, DEGREE, bottom) < 0.0 ? bottom : NAN;
}

/* Select the polynomials (TERMS, p) that may change sign in [-1, 1]. candidate_pairs: their pairs;
 * polynomials: their terms, positive while the set is right. Returns their number. */
static int find_candidates(const pivot_table *contact, const double *taylor, int *candidate_pairs,
                           double *polynomials)
{
    const int pairs = contact->pairs;
    int count = 0;
    for (int i = 0; i < pairs; i++) {
        const double sign = contact->closed[i] ? 1.0 : -1.0;
        double bound = 0.0;
        for (int d = 1; d <= DEGREE; d++) bound += fabs(taylor[(long)d * pairs + i]);
        if (sign * taylor[i] > bound) continue;
        for (int d = 0; d <= DEGREE; d++)
            polynomials[(long)count * TERMS + d] = sign * taylor[(long)d * pairs + i];
        candidate_pairs[count++] = i;
    }
    return count;
}

/* Return the index of the polynomial that falls first after `start` in a cell, and set the
 * position; -1 if there is none. The search has as many parts as a polynomial may have roots. */
static int find_first_event(int count, const double *polynomials, double start,
                            double *position_out)
{
    int first = -1;
    for (int part = 0; part < DEGREE && first < 0; part++) {
        const double low = start + (1.0 - start) * part / DEGREE;
        const double high = start + (1.0 - start) * (part + 1) / DEGREE;
        for (int i = 0; i < count; i++) {
            const double *c = polynomials + (long)i * TERMS;
            const double end = negative_end(c, low, high);
            if (isnan(end)) continue;
            const double root = polynomial_root(c, DEGREE, low, end);
            if (first >= 0 && root >= *position_out) continue;
            first = i;
            *position_out = root;
        }
    }
    return first;
}

/* Taylor coefficients (TERMS, 2H+1) of 1, cos(k theta), sin(k theta), in x = 2 (theta - middle) /
 * width. */
static void expand_waves(int harmonics, double middle, double width, double *taylor)
{
    const long columns = 2L * harmonics + 1;
    for (long d = 0; d <= DEGREE; d++) taylor[d * columns] = d == 0;
    for (int k = 1; k <= harmonics; k++) {
        double real = cos(k * middle), imaginary = sin(k * middle);
        for (long d = 0; d <= DEGREE; d++) {
            taylor[d * columns + 2 * k - 1] = real;
            taylor[d * columns + 2 * k] = imaginary;
            /* exp(i k theta) times (i k width / 2) / (d + 1) */
            const double rate = 0.5 * width * k / (d + 1), next_real = -rate * imaginary;
            imaginary = rate * real;
            real = next_real;
        }
    }
}

/* State of a search. */
typedef struct {
    breathing_pairs *problem;
    int n_events, n_changes; /* events; changes of sets since the last check of rounding */
    int first_cell, end_cell,
        n_next_cells;       /* cells with answers (end_cell 0: none), and how many come next */
    double *gaps, *answers; /* s at the beginnings of all cells and at the last one's end, (cells +
                                 1, p), and X from `first_cell` on, (TERMS, p) */
    double *curvature_bounds; /* (p) and (p): bounds of s'' and X'', per cell squared */
    double *basis, *slopes;   /* (TERMS, 2H+1); (2, p) rates of X per cell at both ends of one */
    double *taylor, *candidate_terms; /* (TERMS, p), (p, TERMS) */
    double *gap_values, *work;        /* (TERMS, p) s; (TERMS, p) */
    double *wave_answers; /* (2H+1, p) X of the waves' gaps s_j where waves are fewer than pairs,
                                 behind `taylor`; else NULL */
    double *cell_waves, *wave_rows; /* (cells) cosines and sines; (TERMS, 2H+1) waves */
    int *candidate_pairs;           /* (p) */
} interval_search;

/* Update X of all s_j, if they are carried along. */
static void update_wave_answers(interval_search *search)
{
    const breathing_pairs *m = search->problem;
    if (search->wave_answers) /* as many rows at a time as there is room for */
        for (int row = 0; row < m->n_waves; row += TERMS) {
            const int count = m->n_waves - row < TERMS ? m->n_waves - row : TERMS;
            const size_t first = (size_t)row * m->contact.pairs;
            transform_gaps(&m->contact, count, m->gaps + first, search->work,
                           search->wave_answers + first);
        }
}

/* Bound the second derivative of waves, per cell squared, from their coefficients (2H+1, p). */
static void bound_curvature(const breathing_pairs *m, const double *coefficients, double *bends)
{
    const int pairs = m->contact.pairs;
    memset(bends, 0, pairs * sizeof(double));
    for (int row = 1; row < m->n_waves; row++) {
        const double rate = TWO_PI / m->cells * ((row + 1) / 2);
        for (int i = 0; i < pairs; i++)
            bends[i] += rate * rate * fabs(coefficients[(long)row * pairs + i]);
    }
}

/* Prepare the answers at the starts of cells: answers to the waves if these are fewer than the
 * pairs, else all gaps. */
static void prepare_search(interval_search *search)
{
    const breathing_pairs *m = search->problem;
    const int pairs = m->contact.pairs;
    update_wave_answers(search);
    if (search->wave_answers) {
        for (int i = 0; i < m->cells; i++) {
            search->cell_waves[2 * i] = cos(TWO_PI / m->cells * i);
            search->cell_waves[2 * i + 1] = sin(TWO_PI / m->cells * i);
        }
        return;
    }
    waves_to_values(m->waves, pairs, m->gaps, search->gaps);
    memcpy(search->gaps + (size_t)m->cells * pairs, search->gaps, pairs * sizeof(double));
    bound_curvature(m, m->gaps, search->curvature_bounds);
}

/* Set the answers (count, p) to combinations of the waves (count, 2H+1). */
static void evaluate_answers(interval_search *search, int count, const double *waves,
                             double *answers_out)
{
    const breathing_pairs *m = search->problem;
    const int pairs = m->contact.pairs;
    const double *coefficients = search->wave_answers ? search->wave_answers : m->gaps;
    double *combined = search->wave_answers ? answers_out : search->gap_values;
    multiply_matrices(count, m->n_waves, pairs, waves, coefficients, 0.0, combined);
    if (!search->wave_answers)
        transform_gaps(&m->contact, count, combined, search->work, answers_out);
}

/* Return the waves at the starts of cells. */
static const double *get_cell_waves(interval_search *search, int cell, int count)
{
    const breathing_pairs *m = search->problem;
    for (int i = 0; i < count; i++) {
        double *row = search->wave_rows + (long)i * m->n_waves;
        row[0] = 1.0;
        for (int k = 1; 2 * k < m->n_waves; k++) {
            const double *cosine_and_sine =
                search->cell_waves + 2 * ((long)k * (cell + i) % m->cells);
            row[2 * k - 1] = cosine_and_sine[0], row[2 * k] = cosine_and_sine[1];
        }
    }
    return search->wave_rows;
}

/* Return the answers at both ends of a cell, first those at its start. */
static const double *get_cell_answers(interval_search *search, int cell)
{
    const breathing_pairs *m = search->problem;
    const int pairs = m->contact.pairs;
    if (cell < search->first_cell || cell >= search->end_cell) {
        const int has_new_set = !search->end_cell;
        search->first_cell = cell;
        search->end_cell =
            cell + search->n_next_cells < m->cells ? cell + search->n_next_cells : m->cells;
        if (2 * search->n_next_cells <= DEGREE) search->n_next_cells *= 2;
        const int count = search->end_cell - cell + 1;
        if (search->wave_answers) {
            if (has_new_set)
                bound_curvature(m, search->wave_answers, search->curvature_bounds + pairs);
            evaluate_answers(search, count, get_cell_waves(search, cell, count), search->answers);
        } else {
            if (has_new_set)
                bound_answers(&m->contact, search->curvature_bounds,
                              search->curvature_bounds + pairs);
            transform_gaps(&m->contact, count, search->gaps + (size_t)cell * pairs, search->work,
                           search->answers);
        }
    }
    return search->answers + (size_t)(cell - search->first_cell) * pairs;
}

/* Discard answers of an earlier set. */
static void discard_answers(interval_search *search)
{
    search->end_cell = 0, search->n_next_cells = 1;
}

/* Return whether a pair is in the right state: closed pairs press, open pairs do not penetrate. */
static int is_right(const breathing_pairs *m, int i, double answer)
{
    return m->contact.closed[i] ? answer > 0.0 : !(answer > m->tolerance);
}

static int are_all_right(const breathing_pairs *m, const double *answers)
{
    for (int i = 0; i < m->contact.pairs; i++)
        if (!is_right(m, i, answers[i])) return 0;
    return 1;
}

/* Set the rates of the answers, per cell, at both ends of a cell. */
static void evaluate_slopes(interval_search *search, int cell)
{
    const breathing_pairs *m = search->problem;
    const int columns = m->n_waves;
    double *wave = search->basis;
    for (int end = 0; end < 2; end++, wave += columns) {
        wave[0] = 0.0;
        for (int k = 1; 2 * k < columns; k++) {
            const double rate = TWO_PI / m->cells * k, phase = rate * (cell + end);
            wave[2 * k - 1] = -rate * sin(phase), wave[2 * k] = rate * cos(phase);
        }
    }
    evaluate_answers(search, 2, search->basis, search->slopes);
}

/* Return whether two tangents at the ends of a cell meet on the wrong side of zero. Answers with
 * the right sign at both ends, further from zero than they can bend, are skipped. */
static int tangents_cross_zero(interval_search *search, int cell, const double *answers)
{
    const pivot_table *contact = &search->problem->contact;
    const int pairs = contact->pairs;
    const double *slopes = search->slopes, *curvature_bounds = search->curvature_bounds + pairs;
    int has_slopes = 0;
    for (int i = 0; i < pairs; i++) {
        const double sign = contact->closed[i] ? 1.0 : -1.0;
        const double first_answer = sign * answers[i], last_answer = sign * answers[pairs + i];
        if (fmin(first_answer, last_answer) > 0.125 * curvature_bounds[i]) continue;
        if (!has_slopes) evaluate_slopes(search, cell);
        has_slopes = 1;
        const double first_rate = sign * slopes[i], last_rate = -sign * slopes[pairs + i];
        if (!(first_rate < 0.0 && last_rate < 0.0)) continue;
        if ((first_answer * last_rate + last_answer * first_rate + first_rate * last_rate) /
                (first_rate + last_rate) <
            0.0)
            return 1;
    }
    return 0;
}

/* Open or close a pair, and update `n_terms` rows of `taylor` and the answers to waves. */
static int toggle_and_update(interval_search *search, int pair, int n_terms, double *v,
                             double *gain)
{
    pivot_table *contact = &search->problem->contact;
    double *first_terms = search->taylor + (TERMS - n_terms) * contact->pairs;
    const int n_wave_rows = search->wave_answers ? search->problem->n_waves : 0;
    const int failed = toggle_pair(contact, pair, n_terms + n_wave_rows, first_terms, v, gain);
    if (!failed) discard_answers(search);
    return failed;
}

/* Record that a pair opens or closes at a phase, and update `terms` rows of answers. Returns 1 if
 * this is impossible, -1 without space for the event. */
static int record_event(interval_search *search, int pair, double theta, int terms)
{
    breathing_pairs *m = search->problem;
    if (search->n_events == m->max_events) return -1;
    const long event_index = search->n_events;
    double *v = m->vectors + event_index * m->contact.pairs;
    if (toggle_and_update(search, pair, terms, v, m->gains + event_index)) return 1;
    m->theta[event_index] = event_index ? fmax(m->theta[event_index - 1], theta) : theta;
    m->event_pairs[event_index] = pair;
    search->n_events++;
    search->n_changes++;
    return 0;
}

/* Check for rounding after a number of changes. */
static void check_rounding(interval_search *search)
{
    if (search->n_changes < MAX_TRUSTED_PIVOTS) return;
    if (recompute_if_inaccurate(&search->problem->contact))
        update_wave_answers(search), discard_answers(search);
    search->n_changes = 0;
}

/* Correct the set at the start of a cell: all pairs in the wrong state change it, or, if that
 * cycles, the first of them alone (sets.h). The changes are recorded, except at phase zero. Returns
 * 0, -1 without space for events, or -2 if this does not end. */
static int correct_set(interval_search *search, int cell, int is_recorded)
{
    breathing_pairs *m = search->problem;
    const long pairs = m->contact.pairs;
    for (long iteration = 0; iteration < MAX_TRUSTED_PIVOTS + 20L * pairs * pairs; iteration++) {
        int is_wrong = 0;
        check_rounding(search);
        const double *answers = get_cell_answers(search, cell);
        for (int i = 0; i < pairs; i++) {
            if (is_right(m, i, answers[i]) || (is_wrong && iteration >= MAX_TRUSTED_PIVOTS))
                continue;
            const int failed = is_recorded ? record_event(search, i, cell * (TWO_PI / m->cells), 0)
                                           : toggle_and_update(search, i, 0, NULL, NULL);
            if (failed < 0) return -1;
            is_wrong |= !failed;
            search->n_changes += !is_recorded;
        }
        if (!is_wrong) return 0;
    }
    return -2;
}

/* Find all events in a cell, in order. Returns 0, or -1 without space. */
static int search_cell(interval_search *search, int cell)
{
    breathing_pairs *m = search->problem;
    const int pairs = m->contact.pairs;
    const double width = TWO_PI / m->cells, middle = (cell + 0.5) * width;
    double start = -1.0, position = 0.0;
    int last_pair = -1;
    expand_waves(m->n_waves / 2, middle, width, search->basis);
    evaluate_answers(search, TERMS, search->basis, search->taylor);
    for (int iteration = 0; iteration < 4 * pairs + 8; iteration++) {
        const int count = find_candidates(&m->contact, search->taylor, search->candidate_pairs,
                                          search->candidate_terms);
        for (int i = 0; i < count && last_pair >= 0; i++)
            if (search->candidate_pairs[i] == last_pair)
                divide_by_root(search->candidate_terms + (long)i * TERMS, start);
        const int candidate_index =
            find_first_event(count, search->candidate_terms, start, &position);
        if (candidate_index < 0) break;
        const int failed = record_event(search, search->candidate_pairs[candidate_index],
                                        middle + 0.5 * width * position, TERMS);
        if (failed < 0) return -1;
        if (failed) break;
        start = position;
        last_pair = search->candidate_pairs[candidate_index];
    }
    return 0;
}

int interval_cells(int harmonics, int pairs)
{
    const int waves = 16 * (harmonics + 1), min_cells = 4 * pairs > waves ? 4 * pairs : waves;
    int cells = 16;
    while (cells < min_cells) cells *= 2;
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
    interval_search search = {.problem = m, .n_next_cells = 1, .gaps = m->work};
    search.answers = search.gaps + (m->cells + 1) * pairs;
    search.work = search.answers + TERMS * pairs;
    search.curvature_bounds = search.work + TERMS * pairs;
    search.slopes = search.curvature_bounds + 2 * pairs;
    search.taylor = search.slopes + 2 * pairs;
    search.wave_answers = search.taylor + TERMS * pairs;
    search.gap_values = search.wave_answers + m->n_waves * pairs;
    search.candidate_terms = search.gap_values + TERMS * pairs;
    search.basis = search.candidate_terms + TERMS * pairs;
    search.wave_rows = search.basis + TERMS * m->n_waves;
    search.cell_waves = search.wave_rows + TERMS * m->n_waves;
    search.candidate_pairs = (int *)(search.cell_waves + 2 * m->cells);
    if (m->n_waves >= pairs) search.wave_answers = NULL;
    open_all_pairs(&m->contact);
    prepare_search(&search);
    if (correct_set(&search, 0, 0)) return -2;
    get_inverse(&m->contact, m->stiffness);
    memcpy(m->first_set, m->contact.closed, pairs);
    for (int cell = 0; cell < m->cells; cell++) {
        const double *answers = get_cell_answers(&search, cell);
        if (are_all_right(m, answers + pairs) && !tangents_cross_zero(&search, cell, answers))
            continue;
        if (search_cell(&search, cell)) return -1;
        check_rounding(&search);
        if (cell + 1 == m->cells) break;
        const int failed = correct_set(&search, cell + 1, 1);
        if (failed) return failed;
    }
    return search.n_events;
}
