/* Exact flow of a structure with contact pairs: Taylor series from event to event. */
#ifndef FLOW_H
#define FLOW_H

/* In m modal coordinates, with p pairs seen through a compliance D = R_inf + diag 1/kappa that is
 * positive definite,
 *
 *     q'' + C q' + Lambda q + P lambda = f(t),      s = P^T q + l(t),
 *     0 <= lambda,   D lambda - s >= 0,   complementary.
 *
 * While the set A of closed pairs stays, lambda_A = S s_A, S = (D_AA)^-1, and the answers i = N_A s
 * (sets.h: forces of closed pairs, openings of the others) stay positive. An event is where one of
 * them does not.
 *
 * With friction there are two rows of contact a pair, r = 2 p: the normals of all pairs, then their
 * tangents. Of each set (closed_sets.h) the answers, two a pair, are
 *
 *     open:   -g_n, 1;    stick:   mu l_n - l_t, mu l_n + l_t;    slip:   l_n, +-g_t',
 *
 * with g = s - D lambda. A pair that begins to stick is held where it is, at h = g_t, its only memory:
 * h is part of the state, which has n = 2 m + p numbers, without friction n = 2 m; of a pair that does
 * not stick it is g_t.
 *
 * Loads f and l have rows of their mean and of the cosines and sines of k omega, k = 1 .. K, of which
 * nothing else depends.
 */
typedef struct {
    int modes, pairs;
    int coupled;              /* whether the damping couples the modes */
    const double *squares;    /* (m) Lambda */
    const double *damping;    /* (m) or (m, m) C */
    const double *rows;       /* (r, m) P^T */
    const double *compliance; /* (r, r) D */
    const double *friction;   /* (p) mu > 0; NULL: none, and r = p */
    int harmonics;            /* K > 0 */
    const double *force;      /* (2 K + 1, m) f */
    const double *gap;        /* (2 K + 1, r) l */
    double max_rate;          /* of the squares of all sets' frequencies the largest one's root, */
    double max_open_rate;     /* and of those where all pairs are open */
    long max_set_numbers;     /* numbers of sets of closed pairs that are kept */
} flow_parts;

typedef struct flow flow;

/* Make a flow. All but the load is copied; the load must outlive the flow. NULL without memory. */
flow *new_flow(const flow_parts *parts);
void free_flow(flow *f);

/* Set another damping. No set may then turn or decay faster than the bound given to the flow. */
void flow_set_damping(flow *f, const double *damping);

/* Outcomes of a motion: it has reached its end; it takes more pieces, or more intervals, than
 * allowed; it is not finite, or no set of closed pairs answers it; there is no memory. */
enum { FLOW_DONE, FLOW_TOO_MANY_PIECES, FLOW_TOO_MANY_INTERVALS, FLOW_FAILED, FLOW_NO_MEMORY };

typedef struct {
    double omega, time, end;
    double *state;           /* (n) q, q', here and at the end, and with friction (p) h */
    int max_pieces, n_pieces;       /* of the series, allowed and made */
    int max_intervals, n_intervals; /* intervals between events, allowed and passed */
    signed char *sets;       /* (max_intervals, p) their closed pairs */
    double *lengths;         /* (max_intervals) */
    int *causes;             /* (max_intervals) the answer that ended each one, or -1; with
                              * friction only, as the next two */
    signed char *is_first;   /* (max_intervals) whether it fell before others at that instant */
    double *ratios;          /* (max_intervals) g_t' of the pair over the slope of the first one */
    int n_events;
    int n_instants, n_samples; /* instants at which the motion is kept, and how many are done */
    const double *instants;  /* (count) ascending, from now to end */
    double *states;          /* (count, 2 m) */
    double *answers;         /* (count, p) i, or with friction (count, 2 r) lambda and g */
    signed char *closed;     /* (count, p) */
} flow_motion;

int flow_advance(flow *f, flow_motion *m);

/* Part of a motion that has been followed. */
typedef struct {
    double omega, start;
    int n_intervals;
    const signed char *sets;
    const double *lengths;
    const int *causes; /* friction only */
    const signed char *is_first;
    const double *ratios;
} flow_track;

/* Set the derivative of the flow over a track, (n, n). Forces are continuous, so it is the product
 * of the sets' exponentials. Returns FLOW_DONE, FLOW_FAILED or FLOW_NO_MEMORY. With friction a pair
 * begins to stick, as an answer phi falls, at
 *
 *     dh = dg_t - g_t' / phi' dphi;
 *
 * a pair that sticks all the time keeps its place, whatever this is: its row is 0. */
int flow_tangent(flow *f, const flow_track *track, double *tangent);
/* Carry the derivative of the state (n) by a parameter of the load from the start of a track to its
 * end. force, gap: derivatives of the load, in the load's form; with `by_time` divided by the time.
 */
int flow_by_load(flow *f, const flow_track *track, const double *force, const double *gap,
                 int by_time, double *state);
/* Set the derivative of the state (n) by omega at the end; it is 0 at the start. */
int flow_by_omega(flow *f, const flow_track *track, double *state);
/* Set the derivative of the state by a parameter of the structure, for a motion from the state
 * `start`. damping: derivative of the flow's damping; compliance (p): derivative of the
 * compliance's diagonal; NULL: no change. */
int flow_by_structure(flow *f, const flow_track *track, const double *start, const double *damping,
                      const double *compliance, double *state);
/* Set the state's derivative by the time (n), with friction for pairs in the states `closed`.
 * Returns 0, or 1 if no set of closed pairs answers the state. */
int flow_rate(flow *f, double omega, double time, const signed char *closed, const double *state,
              double *rate);
/* Follow the motion over each of `n_parts` equal parts of a period, from states (n_parts, n) at
 * their starts. end_states (n_parts, n): states at their ends; interval_counts (n_parts): intervals
 * passed up to there. Limits and tracks are those of m. */
int flow_advance_parts(flow *f, flow_motion *m, int n_parts, double period, const double *states,
                       double *end_states, int *interval_counts);
/* Carry changes (n_parts + 1, n) from the first one on: each next one is the present one, carried
 * by the derivative of the flow over that part of a track, plus excess (n_parts, n). */
int flow_carry_changes(flow *f, const flow_track *track, int n_parts, const int *interval_counts,
                       const double *excess, double *changes);

#endif
