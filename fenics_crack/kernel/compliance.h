/* A structure as its contact pairs see it, along a parameter p: g_lin(p) - R(p) b of forces b. */
#ifndef COMPLIANCE_H
#define COMPLIANCE_H

/*     R_k(p)   = R_k,  or  P^T h_k P + R_s   with h_kj = 1 / (s_j - (k w)^2 + i k w d c_j),
 *     g_lin(p) = linear + p linear_rate  +  P^T h_k l_k,
 *     w(p)     = omega + p omega_rate,           d(p) = damping + p damping_rate.
 *
 * Coefficients stand as in switching.h, n = (2H+1) pairs of them. A complex number is its real
 * part, then its imaginary part. All arrays belong to the caller, and must outlive this object. */
typedef struct {
    int harmonics, pairs, modes;        /* 0 modes where R is given */
    const double *linear, *linear_rate; /* (2H+1, pairs) */
    const double *compliance;           /* R: (H+1, pairs, pairs), complex */
    double omega, omega_rate, damping, damping_rate;
    const double *squares, *modal_damping; /* s, c: (modes) */
    const double *shapes;               /* P: (modes, pairs) */
    const double *load;                 /* l: (H+1, modes), complex */
    const double *static_compliance;    /* R_s: (pairs, pairs), or NULL */
} structure_at_pairs;

/* Relative distance |s - (k w)^2| / (s + (k w)^2) below which an undamped resonance has no
 * solution. A mode without load is moved off the resonance, by the root of rounding
 * (fenics_crack/model/modal.py, AllModes.modal_receptances). */
extern const double SINGULARITY_TOLERANCE;

typedef struct compliance compliance;

/* NULL without memory. */
compliance *new_compliance(const structure_at_pairs *given);
void free_compliance(compliance *self);
/* Go to a parameter. Returns 0, or 1 if the structure is singular. */
int set_parameter(compliance *self, double parameter);
/* Return R at the parameter, (H+1, pairs, pairs) complex. */
const double *get_compliance_matrices(compliance *self);
/* Set R b - g_lin of forces b (2H+1, pairs). Then: set its derivative by the parameter for this b.
 */
void evaluate_response(compliance *self, const double *force, double *gap_out);
void differentiate_response(compliance *self, double *gap_out);
/* Set R b at the parameter. */
void respond_at_parameter(compliance *self, const double *force, double *gap);
/* Return the largest row sum of |R_k| at a parameter; infinite if the structure is singular. */
double largest_row_sum(compliance *self, double parameter);

/* Set R b of coefficients b (2H+1, pairs), from R (H+1, pairs, pairs), complex. */
void respond(int harmonics, int pairs, const double *matrices, const double *force, double *gap);

#endif
