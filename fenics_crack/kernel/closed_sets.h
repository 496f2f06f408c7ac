/* What an exact flow (flow.h) knows of sets of closed pairs, kept from motion to motion. */
#ifndef CLOSED_SETS_H
#define CLOSED_SETS_H

#include "sets.h"

/* A set A of `size` closed pairs, with S = (D_AA)^-1. */
typedef struct closed_set {
    struct closed_set *next;
    int size;
    double *answer;      /* (p, p) its answer (sets.h), transposed */
    double *pairs;       /* (m, size) P_A */
    double *pushed;      /* (size, m) S P_A^T */
    double *stiffness;   /* (m, m) P_A S P_A^T where the pairs are many, else NULL */
    double *scale;       /* (p) what turns gaps into answers: S_jj, or 1 */
    signed char *closed; /* (p) */
} closed_set;

typedef struct closed_sets closed_sets;

/* Of pairs with rows P^T (p, m), which must stay, and the answers to their compliance; at most
 * `most` numbers are kept. NULL without memory. */
closed_sets *new_closed_sets(int modes, int pairs, const double *rows, sets *contact, long most);
void free_closed_sets(closed_sets *s);
/* Valid until the next one is asked for; NULL where D_AA is singular, or without memory. */
const closed_set *closed_set_of(closed_sets *s, const signed char *closed);

#endif
