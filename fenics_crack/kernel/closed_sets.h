/* What an exact flow (flow.h) knows of sets of closed pairs, kept from motion to motion. Each is found
 * from nothing but its pairs: no number depends on what has been asked for before. */
#ifndef CLOSED_SETS_H
#define CLOSED_SETS_H

/* A set A of `size` closed pairs, with S = (D_AA)^-1. */
typedef struct closed_set {
    struct closed_set *next;
    int size;
    double *inverse;     /* (size, size) S */
    double *pairs;       /* (m, size) P_A */
    double *pushed;      /* (size, m) S P_A^T */
    double *stiffness;   /* (m, m) P_A S P_A^T where the pairs are many, else NULL */
    double *scale;       /* (p) what turns gaps into answers: S_jj, or 1 */
    int *members;        /* (p) the pairs of A, then the others, each in ascending order */
    signed char *closed; /* (p) */
} closed_set;

typedef struct closed_sets closed_sets;

/* Of pairs with rows P^T (p, m) and a positive definite compliance D (p, p), which must stay; at most
 * `most` numbers are kept. NULL without memory. */
closed_sets *new_closed_sets(int modes, int pairs, const double *rows, const double *d, long most);
void free_closed_sets(closed_sets *s);
/* Valid until the next one is asked for; NULL where D_AA is singular, or without memory. */
const closed_set *closed_set_of(closed_sets *s, const signed char *closed);
/* The set that answers gaps s (p), from a guess of it, and the answers (p): pairs whose answer is
 * negative are turned, all at once or, where that goes round, the first of them alone (sets.h). NULL
 * where that does not end, too. */
const closed_set *set_at(closed_sets *s, const double *gap, signed char *closed, double *answers);
/* Answers (count, p) to gaps s (count, p), count at most TERMS: forces f = S s_A of the closed pairs,
 * openings D_.A f - s of the others. */
void answer_gaps(closed_sets *s, const closed_set *a, int count, const double *gaps,
                 double *answers);

#endif
