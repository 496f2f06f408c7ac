/* Equations F(x, p) = 0 at a point, of whatever kind: what paths are followed with. */
#ifndef EQUATIONS_H
#define EQUATIONS_H

/* What comes of an evaluation, or of a correction by Newton's method. */
enum { FOUND, NOT_FOUND, SINGULAR_STRUCTURE, NO_MEMORY, FAILED };

/* Unknowns from which on factors of J are dear: solutions with it take products, and full steps from
 * the linear solution more time than beginning with fewer harmonics. */
enum { MANY_UNKNOWNS = 100 };

/* The points of each kind begin with it; `system` is such a point. */
typedef struct equations {
    int unknowns;
    int means; /* of these the first, which are means over time */
    int (*evaluate)(struct equations *system, const double *x, double p); /* FOUND, or why not */
    void (*residual)(const struct equations *system, double *vector_out); /* F there */
    void (*solve)(struct equations *system, double *x);                   /* x = J^-1 x there, */
    double solve_tolerance; /* to this relative residual where it takes products: */
    int uses_products;      /* whether it does; the sign is dear then */
    void (*by_parameter)(struct equations *system, double *vector_out); /* dF/dp there */
    double (*sign)(
        struct equations *system); /* of det J there; NAN where it is not known: then turns */
    const double *angle_weights;   /* are judged with unknowns that count so much (n) */
    void *context; /* what equations in Python are made of (numerics/equations.py) */
    void (*apply)(struct equations *system, const double *x,
                  double *vector_out); /* J x, for products */
    int records; /* numbers that paths may keep of each point: */
    void (*record)(struct equations *system,
                   double *vector_out); /* those of a point with its tangent */
} equations;

#endif
