/* Equations F(x, p) = 0 at a point, of any kind, for Newton's method and path following. */
#ifndef EQUATIONS_H
#define EQUATIONS_H

/* Outcomes of an evaluation, or of Newton's method. */
enum { FOUND, NOT_FOUND, SINGULAR_STRUCTURE, NO_MEMORY, FAILED };

/* Number of unknowns above which factors of J are expensive. Then solutions take products with J,
 * and it is faster to begin with fewer harmonics than with full steps from the linear solution. */
enum { MANY_UNKNOWNS = 100 };

/* Table of functions, the first member of a point of any kind; `system` is such a point. */
typedef struct equations {
    int unknowns;
    int means; /* number of leading unknowns that are means over time */
    /* Evaluate the equations at a point, for the functions below; FOUND or a reason of failure. */
    int (*evaluate)(struct equations *system, const double *x, double p);
    /* Set F. */
    void (*residual)(const struct equations *system, double *residual_out);
    /* Set x = J^-1 x, by products with J up to a relative residual of solve_tolerance. */
    void (*solve)(struct equations *system, double *x);
    double solve_tolerance;
    int uses_products; /* whether solutions take products with J; then the sign is expensive */
    /* Set dF/dp. */
    void (*by_parameter)(struct equations *system, double *derivative_out);
    /* Return the sign of det J, or NAN if unknown; then angles between tangents replace it. */
    double (*sign)(struct equations *system);
    const double *angle_weights; /* (n) of the unknowns in these angles; NULL: the norm */
    void *context;               /* state of equations in Python (numerics/equations.py) */
    /* Set J x, for solutions by products. */
    void (*apply)(struct equations *system, const double *x, double *product_out);
    int n_record_entries; /* how many numbers a path may keep of each point */
    /* Set these numbers of a point, once its tangent is known. */
    void (*record)(struct equations *system, double *record_out);
} equations;

#endif
