/* Exact flow of a piecewise linear structure from one switching instant to the next. */
#ifndef EVENTS_H
#define EVENTS_H

/* Motion with one set of closed pairs, in the real basis V of its damped modes:
 *
 *     z(t) = z_p(t) + V y(t),     z_p = mean + c cos(wt) + s sin(wt),
 *
 * where weights y of size 2 m + r come as m first and m second ones of modes that turn, and r that
 * do not:
 *
 *     first'  = a first + b second,     second' = a second - b first,     other' = a other.
 *
 * Gaps count as positive where a pair leaves its state: closed ones with the sign turned.
 */
typedef struct {
    int size, turning;       /* 2 m + r, m */
    const double *decay;     /* (2 m + r) a */
    const double *turn;      /* (m) b */
    const double *vectors;   /* (size, size) V */
    const double *inverse;   /* V^-1 */
    const double *load;      /* (2, size) weights of the load's cosine and sine */
    double *steady;          /* (3, size) mean, c, s */
    const double *free;      /* (3, p, size): gaps, their slopes and curvatures, from the weights */
    double *forced;          /* (p, 3): gaps of z_p: mean less clearance, cosine, sine */
    double step;             /* of the search: a twelfth of the fastest mode's period */
    double omega;            /* to which c and s belong; NAN: none */
    double **into;           /* (p) V_s^-1 V with s the set that differs in that pair; or NULL */
} regime;

typedef struct {
    int pairs, size;
    double omega;
    const double *rows;      /* (p, size / 2): gaps from the first half of z, but for the clearance */
    const double *clearance; /* (p) */
    regime **known;          /* (2^p) by the closed pairs' bits; NULL: not yet made */
    double *room;            /* 8 size + 6 p */
} exact_flow;

typedef struct {
    double now, end;
    double *state;           /* (size) z, here and at the end */
    int closed, switched;    /* bits of the closed pairs; the pair that has just changed, or -1 */
    int events;
    int most, passed;        /* intervals between events that are kept, and how many are */
    int *passed_sets;        /* (most) their closed pairs' bits */
    double *lengths;         /* (most) */
    int count, sampled;      /* instants at which weights are kept, and how many are done */
    const double *instants;  /* (count) ascending */
    double spacing;          /* between them; 0: not equal */
    double *weights;         /* (count, size) y */
    int *sets;               /* (count) bits of the closed pairs there */
} motion;

/* Bits of the pairs that are closed in a state, or about to be. */
int closed_at(const exact_flow *f, const double *state);
/* Take on the load's frequency, as do the regimes that are made: the steady response y = Re (Y
 * e^{iwt}) of the weights solves iw Y = L Y + (cosine - i sine). */
void set_frequency(exact_flow *f, double omega);
/* The same of one regime of it. */
void respond_to_load(const exact_flow *f, regime *r);
/* Follow a motion to its end, DONE; until a set of closed pairs is not yet made, UNKNOWN, or until
 * there is no room for another interval, FULL: to be called again then. FAST: the search would take
 * `longest` steps. */
enum { DONE, UNKNOWN, FULL, FAST };
int follow_exactly(const exact_flow *f, motion *m, double longest);
/* product = (derivative of the flow over these intervals) product, (size, size); work: size^2 + 2
 * size. */
void derivative_of(const exact_flow *f, int intervals, const int *sets, const double *lengths,
                   double *product, double *work);

#endif
