/* Sets of closed pairs of an exact flow (flow.h), kept from motion to motion. The numbers of a set
 * depend on its pairs alone, not on the order of requests. */
#ifndef CLOSED_SETS_H
#define CLOSED_SETS_H

/* States of a pair. Without friction a closed pair is in the state STICK. The tangential gap grows
 * in SLIP_UP and falls in SLIP_DOWN. */
enum { OPEN, STICK, SLIP_UP, SLIP_DOWN };

/* A set A of `size` closed pairs, with S = (D_AA)^-1.
 *
 * With friction there are contact rows of the normals of all p pairs and behind them of their
 * tangents, and a set has a state of each pair. Its `size` rows are the normals of the closed pairs
 * and the tangents of those that stick. With x the forces on these rows, all are lambda = E x, where E
 * adds +-mu x of a slipping pair's normal to its tangent, and
 *
 *     r = s_rows - [0; h],     A = D_rows E,     lambda = E A^-1 r = L r,
 *
 * h the place where a pair sticks. A is not symmetric while a pair slips.
 */
typedef struct closed_set {
    struct closed_set *next;
    int size, n_normals; /* number of rows, and of normal rows among them */
    double *inverse;     /* the lower half of S row by row, or with friction (size, rows) L^T */
    double *mode_columns; /* (m, size) P_A; NULL with a stiffness and no friction */
    double *modal_push;   /* (size, m) S P_A^T, or L^T P^T */
    double *stiffness;   /* (m, m) P_A S P_A^T where the pairs are many, else NULL */
    double *answer_scale; /* (rows) what turns gaps into answers: S_jj, or 1 */
    int *rows;            /* (rows) the rows of A, then without friction the others, each in
                          * ascending order */
    signed char *closed; /* (p) */
} closed_set;

typedef struct closed_sets closed_sets;

/* Make an empty store for pairs with rows P^T (p, m), a positive definite compliance D (p, p) and
 * friction coefficients (p), or NULL. The arrays must outlive the store, which keeps at most
 * `max_numbers` numbers. Returns NULL without memory. */
closed_sets *new_closed_sets(int modes, int pairs, const double *rows, const double *d,
                             const double *friction, long max_numbers);
void free_closed_sets(closed_sets *s);
int count_pairs(const closed_sets *s);
const double *get_compliance_row(const closed_sets *s, int row);
/* Return a set, valid until the next request. NULL if D_AA is singular; with friction, if det A is
 * not positive, so that several answers exist; and without memory. */
const closed_set *get_closed_set(closed_sets *s, const signed char *closed);
/* Find the set whose answers (p) to gaps s (p) are not negative, from a guess. All pairs with a
 * negative answer change their state at once; if that cycles, only the first of them (sets.h). NULL
 * if this does not end. */
const closed_set *find_closed_set(closed_sets *s, const double *gap, signed char *closed,
                                  double *answers);
/* Set the answers (count, p) to gaps s (count, p), count at most TERMS: forces f = S s_A of the
 * closed pairs, openings D_.A f - s of the others. */
void make_answers(closed_sets *s, const closed_set *a, int count, const double *gaps,
                  double *answers);
/* With friction: set the forces lambda (count, r) of gaps s (count, r), and replace the gaps by s -
 * D lambda. Sticking pairs are held at places h (p). */
void solve_friction_forces(closed_sets *s, const closed_set *a, int count,
                           const double *stick_places, double *gaps, double *forces);
/* With friction: find the set of states for gaps s (r), from a guess, and its forces (r); replace
 * the gaps by s - D lambda. stick_places (p): where pairs stuck until now. A pair sticks while its
 * force is inside Coulomb's cone; else it slips. NULL as find_closed_set. */
const closed_set *find_states(closed_sets *s, const double *stick_places, signed char *closed,
                              double *gaps, double *forces);
/* Do the same for one instant after the other: stick_places becomes the places from here on.
 * Returns 0, or 1 if no set answers. */
int step_friction(closed_sets *s, double *stick_places, signed char *closed, double *gaps,
                  double *forces);

#endif
