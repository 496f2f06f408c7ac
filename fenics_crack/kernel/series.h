/* Taylor series of several functions of the time: columns of coefficients (TERMS, n), for times in
 * parts of a length. */
#ifndef SERIES_H
#define SERIES_H

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx512f", "avx2", "default"))) /* sums keep their order */
#else
#define WIDE
#endif

/* ORDER: of the polynomials, at most. BLOCK: numbers that a processor works on together.
 * FLOW_REACH: how far what is fastest turns in a piece of the flow, at most; GRID: steps of a piece
 * while it turns by 1. TIMES: as many numbers as those at the ends of all steps, in whole blocks. */
enum { ORDER = 38, TERMS = ORDER + 1, BLOCK = 8, MAX_PIECE_ANGLE = 10, STEPS_PER_RADIAN = 2 };
enum { MAX_TIMES = (STEPS_PER_RADIAN * MAX_PIECE_ANGLE + BLOCK) / BLOCK * BLOCK };

/* sum (n) += weights (count) times rows (count, n). */
void add_rows(int count, int n, const double *rows, const double *weights, double *sum);

/* Of polynomials of an order, values (n) and slopes (n) at a time. */
void series_at(int n, int order, const double *terms, double time, double *value, double *slope);
/* Values (count, n) at so many times. */
void values_at(int n, int order, const double *terms, int count, const double *times,
               double *values);
/* Value of one function, or with `slopes` of its slope, and the slope of that. */
double column_at(int n, int order, const double *terms, int column, int slopes, double time,
                 double *slope);
/* Where one function falls through zero, or its slope rises through it, between two times: Newton's
 * method, kept between by bisection. */
double column_zero(int n, int order, const double *terms, int column, int slopes, double low,
                   double high);

/* The largest term of all at a time. */
double series_size(int n, int order, const double *terms, double time);
/* Up to which time series hold, at most `within`. */
double series_reach(int n, int order, const double *terms, double max_time);

#endif
