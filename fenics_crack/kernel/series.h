/* Taylor series of several functions of time: coefficients (TERMS, n), for times in units of a
 * length. */
#ifndef SERIES_H
#define SERIES_H

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx512f", "avx2", "default"))) /* sums keep their order */
#else
#define WIDE
#endif

/* ORDER: highest order of the polynomials. BLOCK: numbers that a processor works on together.
 * MAX_PIECE_ANGLE: largest angle by which the fastest mode turns in a piece of the flow.
 * STEPS_PER_RADIAN: steps of the search for events, for each radian of this angle. MAX_TIMES:
 * number of ends of all steps, in whole blocks. */
enum { ORDER = 38, TERMS = ORDER + 1, BLOCK = 8, MAX_PIECE_ANGLE = 10, STEPS_PER_RADIAN = 2 };
enum { MAX_TIMES = (STEPS_PER_RADIAN * MAX_PIECE_ANGLE + BLOCK) / BLOCK * BLOCK };

/* sum (n) += weights (count) times rows (count, n). */
void add_rows(int count, int n, const double *rows, const double *weights, double *sum);

/* Set values (n) and slopes (n) of polynomials at a time. */
void series_at(int n, int order, const double *terms, double time, double *value, double *slope);
/* Set values (count, n) at several times. */
void values_at(int n, int order, const double *terms, int count, const double *times,
               double *values);
/* Return the value of one function and set its slope; with `slopes`, return the slope and set the
 * slope of that. */
double column_at(int n, int order, const double *terms, int column, int slopes, double time,
                 double *slope);
/* Return the time between two times at which one function falls through zero or, with `slopes`, its
 * slope rises through zero. Newton's method, kept in a bracket by bisection. */
double column_zero(int n, int order, const double *terms, int column, int slopes, double low,
                   double high);

/* Return the largest term of all series at a time. */
double series_size(int n, int order, const double *terms, double time);
/* Return the time up to which the series hold, at most `max_time`. */
double series_reach(int n, int order, const double *terms, double max_time);

#endif
