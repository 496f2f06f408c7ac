/* What an exact flow (flow.h) knows of sets of closed pairs, kept from motion to motion. Each is found
 * from nothing but its pairs: no number depends on what has been asked for before. */
#ifndef CLOSED_SETS_H
#define CLOSED_SETS_H

/* Of a pair; without friction a closed one is in the first state behind OPEN. Of SLIP_UP the
 * tangential gap grows. */
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
    int size, n_normals; /* rows, and those of normals among them */
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

/* Of pairs with rows P^T (p, m) and a positive definite compliance D (p, p), which must stay, with
 * coefficients of friction (p), or NULL; at most `max_numbers` numbers are kept. NULL without memory. */
closed_sets *new_closed_sets(int modes, int pairs, const double *rows, const double *d,
                             const double *friction, long max_numbers);
void free_closed_sets(closed_sets *s);
int count_pairs(const closed_sets *s);
const double *get_compliance_row(const closed_sets *s, int row);
/* Valid until the next one is asked for; NULL where D_AA is singular, with friction where det A is not
 * positive and the answer not the only one, or without memory. */
const closed_set *get_closed_set(closed_sets *s, const signed char *closed);
/* The set that answers gaps s (p), from a guess of it, and the answers (p): pairs whose answer is
 * negative are turned, all at once or, where that goes round, the first of them alone (sets.h). NULL
 * where that does not end, too. */
const closed_set *find_closed_set(closed_sets *s, const double *gap, signed char *closed,
                                  double *answers);
/* Answers (count, p) to gaps s (count, p), count at most TERMS: forces f = S s_A of the closed pairs,
 * openings D_.A f - s of the others. */
void make_answers(closed_sets *s, const closed_set *a, int count, const double *gaps,
                  double *answers);
/* With friction: of a series of gaps s (count, rows), whose stuck pairs are held in places h (p), the
 * forces lambda (count, rows), and in place of the gaps s - D lambda. */
void solve_friction_forces(closed_sets *s, const closed_set *a, int count,
                           const double *stick_places, double *gaps, double *forces);
/* With friction: the set that answers gaps s (r) of pairs that stuck in places h (p) until now, from a
 * guess of it, the forces (r), and in place of the gaps s - D lambda. A pair sticks while its forces
 * stay in Coulomb's cone, and slips away from its place else. NULL as set_at. */
const closed_set *find_states(closed_sets *s, const double *stick_places, signed char *closed,
                              double *gaps, double *forces);
/* The same of one instant after the other: h becomes where pairs are held from here on. 0, or 1 where
 * no set answers. */
int step_friction(closed_sets *s, double *stick_places, signed char *closed, double *gaps,
                  double *forces);

#endif
